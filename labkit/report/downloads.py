"""The numbers behind the report, as files that the page itself holds: results.json, and tables for other programs."""

from __future__ import annotations

import csv
import io
import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from labkit.optics.through_focus import ThroughFocus
from labkit.optics.zernike import mode_name
from labkit.report.curves import Curves
from labkit.results import Results

Cell = str | int | float | None
LINE = "\r\n"  # as RFC 4180 has it


@dataclass(frozen=True, slots=True)
class Download:
    """A file in the page: its name, its bytes, and what it holds."""

    name: str
    media_type: str
    content: bytes
    what: str

    @property
    def uri(self) -> str:
        """As a link."""
        return f"data:{self.media_type};base64,{b64encode(self.content).decode()}"


def downloads_of(results: Results, curves: Sequence[Curves]) -> list[Download]:
    """All that the charts show, at full precision, with standard errors."""
    raw = json.dumps(results.as_json(), indent=1, allow_nan=False).encode()
    return [
        Download(
            "results.json",
            "application/json",
            raw,
            "everything, as labkit keeps it, with covariances",
        ),
        _table("zernike.csv", _zernike(results), "coefficients of all ranges and channels"),
        _table("mtf.csv", _mtf(curves), "MTF at best focus"),
        _table("through_focus.csv", _through(curves), "Strehl ratio and MTF through focus"),
        _table("encircled_energy.csv", _energy(curves), "encircled energy at best focus"),
    ]


def _table(name: str, rows: Iterable[Sequence[Cell]], what: str) -> Download:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator=LINE)
    writer.writerows([_written(cell) for cell in row] for row in rows)
    return Download(name, "text/csv", text.getvalue().encode(), what)


def _written(cell: Cell) -> Cell:
    """Numbers to nine digits, nothing for what is not finite; text as text, never as a program's formula."""
    if isinstance(cell, str):
        return f"'{cell}" if cell[:1] in "=+-@\t" else cell
    if isinstance(cell, float | np.floating):
        return f"{cell:.9g}" if isfinite(cell) else None
    return cell


def _zernike(results: Results) -> Iterable[Sequence[Cell]]:
    yield (
        "range_mm",
        "channel",
        "wavelength_nm",
        "noll",
        "mode",
        "waves_rms",
        "std_waves_rms",
        "nm_rms",
        "std_nm_rms",
        "sign_open",
        "twin_waves_rms",
    )
    nm = results.reference_wavelength_nm
    for w in results:
        for j, value, std, twin in zip(
            w.noll, w.waves.tolist(), w.std.tolist(), w.twin.waves.tolist(), strict=True
        ):
            yield (
                w.range_mm,
                w.channel,
                w.wavelength_nm,
                j,
                mode_name(j),
                value,
                std,
                value * nm,
                std * nm,
                str(w[j].sign_open).lower(),
                twin if w.sign_open else None,
            )


def _mtf(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    yield (
        "channel",
        "direction",
        "cycles_per_mm",
        "mtf",
        "std",
        "diffraction_limit",
        "pixel",
        "mtf_with_pixel",
    )
    for c in curves:
        for direction, curve in c.mtf.items():
            columns = (
                curve.frequency_per_mm,
                curve.value,
                curve.std,
                c.perfect,
                c.pixel,
                curve.value * c.pixel,
            )
            for row in np.column_stack(columns).tolist():
                yield c.channel, direction, *row


def _through(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    where = "range_mm" if curves and curves[0].in_ranges else "sensor_shift_um"
    yield "channel", "defocus_waves_rms", where, "quantity", "cycles_per_mm", "value", "std"
    for c in curves:
        each: list[tuple[str, float | None, ThroughFocus]] = [("strehl", None, c.strehl)]
        each += [(f"mtf_{d}", c.through_per_mm, curve) for d, curve in c.modulation.items()]
        for name, per_mm, curve in each:
            columns = (curve.defocus_waves, c.places, curve.value, curve.std)
            for defocus, place, value, std in np.column_stack(columns).tolist():
                yield c.channel, defocus, place, name, per_mm, value, std


def _energy(curves: Sequence[Curves]) -> Iterable[Sequence[Cell]]:
    yield "channel", "radius_um", "share", "std", "diffraction_limit"
    for c in curves:
        columns = (c.energy.radius_um, c.energy.value, c.energy.std, c.perfect_energy)
        for row in np.column_stack(columns).tolist():
            yield c.channel, *row
