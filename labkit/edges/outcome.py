"""What is measured of edges: ranges, responses by the fit and by ISO 12233, what was rejected; as JSON and as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labkit.edges.esfr import Esfr
from labkit.edges.found_edges import Box
from labkit.edges.response import FittedResponse
from labkit.plan import leading_channel
from labkit.types import Floats
from labkit.uncertain import Uncertain

CURVE_POINTS = 40
DIGITS = 6
FAR = 4.0
"""Standard errors of a difference, beyond which two methods disagree."""

METHOD_SHARE = 0.12
"""Of MTF50: what the window of ISO 12233 adds to a strongly blurred edge's in a box of 36 pixels."""


@dataclass(frozen=True)
class ChannelEdge:
    """An edge in one colour. defocus: waves RMS at the reference; other_defocus: on the other side of best focus, where the
    picture alone does not exclude it. iso: by ISO 12233; iso_problem: why it or its MTF50 is lacking."""

    channel: str
    defocus: Uncertain
    other_defocus: Uncertain | None
    angle_deg: Uncertain
    near: Uncertain
    far: Uncertain
    chi2_per_pixel: float
    pixels: int
    fitted: FittedResponse
    iso: Esfr | None
    iso_problem: str = ""

    @property
    def disagreement(self) -> str:
        """How far MTF50 by ISO 12233 is from that of the fit, in words; empty where their errors allow it."""
        fit = self.fitted.mtf50
        iso = None if self.iso is None else self.iso.mtf50
        if iso is None or not math.isfinite(iso.value - fit.value):
            return ""
        allowed = FAR * math.hypot(fit.std, iso.std) + METHOD_SHARE * fit.value
        if abs(iso.value - fit.value) <= allowed:
            return ""
        return (
            f"channel {self.channel}: MTF50 is {fit} by the fit and {iso} by ISO 12233, more apart than their errors allow: "
            "see whether the box holds one straight edge between even sides"
        )

    def as_json(self) -> dict[str, Any]:
        """One entry of "channels"."""
        frequency = np.linspace(0, self.fitted.frequency_per_mm[-1], CURVE_POINTS)
        curve = {
            "per_mm": _rounded(frequency),
            "fit": _rounded(
                np.interp(frequency, self.fitted.frequency_per_mm, self.fitted.value)
            ),
            "fit_std": _rounded(
                np.interp(frequency, self.fitted.frequency_per_mm, self.fitted.std)
            ),
        }
        if self.iso is not None:
            for name, values in (("esfr", self.iso.value), ("esfr_std", self.iso.std)):
                curve[name] = _rounded(
                    np.interp(frequency, self.iso.frequency_per_mm, values)
                )
        return {
            "channel": self.channel,
            "defocus_waves": self.defocus.as_json(),
            "other_defocus_waves": None
            if self.other_defocus is None
            else self.other_defocus.as_json(),
            "near_counts": self.near.as_json(),
            "far_counts": self.far.as_json(),
            "mtf50_per_mm": self.fitted.mtf50.as_json(),
            "mtf10_per_mm": self.fitted.mtf10.as_json(),
            "esfr_mtf50_per_mm": None if self.iso is None else self.iso.mtf50.as_json(),
            "esfr_mtf10_per_mm": None if self.iso is None else self.iso.mtf10.as_json(),
            "esfr_problem": self.iso_problem or None,
            "chi2_per_pixel": _finite(self.chi2_per_pixel),
            "pixels": self.pixels,
            "curve": curve,
        }


@dataclass(frozen=True)
class MeasuredEdge:
    """An edge in all its colours. range_mm: nan where nothing says what the lens is focused at; other: on the other side
    of best focus, where the data do not exclude it. line: (2, 2) its ends, (row, column) in the raw."""

    box: Box
    line: Floats
    range_mm: Uncertain
    other: Uncertain | None
    channels: tuple[ChannelEdge, ...]

    @property
    def main(self) -> ChannelEdge:
        """Green, or the first: what stands for the edge in a table."""
        names = [c.channel for c in self.channels]
        return self.channels[names.index(leading_channel(names))]

    @property
    def chi2_per_pixel(self) -> float:
        """Over all colours."""
        return sum(c.chi2_per_pixel * c.pixels for c in self.channels) / sum(
            c.pixels for c in self.channels
        )

    def as_json(self) -> dict[str, Any]:
        """One entry of "edges", by the contract; what it does not name stands behind."""
        main = self.main
        return {
            "box": list(self.box),
            "angle_deg": round(main.angle_deg.value, DIGITS),
            "range_mm": self.range_mm.as_json(),
            "other_sign_mm": None if self.other is None else self.other.as_json(),
            "mtf50_per_mm": main.fitted.mtf50.as_json(),
            "esfr_mtf50_per_mm": None
            if main.iso is None
            else _finite(main.iso.mtf50.value),
            "chi2_per_pixel": _finite(self.chi2_per_pixel),
            "angle_std_deg": _finite(main.angle_deg.std),
            "line_px": _nested(self.line),
            "channels": [channel.as_json() for channel in self.channels],
        }


@dataclass(frozen=True)
class RejectedEdge:
    """A box that gave no fit, and why, in one line. responses: by ISO 12233 in each channel, where it holds an edge that the
    model does not explain."""

    box: Box
    why: str
    responses: Mapping[str, Esfr] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """One entry of "rejected"."""
        channels = [
            {
                "channel": name,
                "esfr_mtf50_per_mm": iso.mtf50.as_json(),
                "esfr_mtf10_per_mm": iso.mtf10.as_json(),
                "curve": {
                    "per_mm": _rounded(iso.frequency_per_mm),
                    "esfr": _rounded(iso.value),
                    "esfr_std": _rounded(iso.std),
                },
            }
            for name, iso in self.responses.items()
        ]
        return {"box": list(self.box), "why": self.why, "channels": channels}

    def rows(self) -> list[list[str]]:
        """Of the table, one for each channel with a response."""
        return [
            [
                *(box_words(self.box) if k == 0 else "", "", "", "", name, "not fitted"),
                *("", _shown(iso.mtf50, False), "", _shown(iso.mtf10, False), ""),
            ]
            for k, (name, iso) in enumerate(self.responses.items())
        ]


@dataclass(frozen=True)
class EdgesOutcome:
    """All of a scene. wavefront: modes but defocus, waves RMS at the reference, where they were fitted along."""

    edges: tuple[MeasuredEdge, ...]
    rejected: tuple[RejectedEdge, ...]
    warnings: tuple[str, ...] = ()
    wavefront: dict[int, Uncertain] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """By the contract, schema 1."""
        return {
            "schema": 1,
            "edges": [edge.as_json() for edge in self.edges],
            "rejected": [of.as_json() for of in self.rejected],
            "wavefront": {str(j): value.as_json() for j, value in self.wavefront.items()}
            or None,
            "warnings": list(self.warnings),
        }

    def rows(self) -> list[list[str]]:
        """A heading, a row for each edge and colour, and one for each of what ISO 12233's method alone could measure."""
        heading = [
            *("box", "angle", "range", "or", "channel", "defocus, waves"),
            *(
                "MTF50 of the fit, cycles/mm",
                "by ISO 12233",
                "MTF10, cycles/mm",
                "by ISO 12233",
                "chi2/pixel",
            ),
        ]
        rows = [heading]
        for edge in self.edges:
            for k, c in enumerate(edge.channels):
                first = k == 0
                rows.append(
                    [
                        ",".join(map(str, edge.box)) if first else "",
                        f"{edge.main.angle_deg.value:.2f}°" if first else "",
                        _shown(edge.range_mm) if first else "",
                        _shown(edge.other) if first and edge.other is not None else "",
                        c.channel,
                        _shown(c.defocus)
                        + (" or the reverse" if c.other_defocus is not None else ""),
                        _shown(c.fitted.mtf50, False),
                        "" if c.iso is None else _shown(c.iso.mtf50, False),
                        _shown(c.fitted.mtf10, False),
                        "" if c.iso is None else _shown(c.iso.mtf10, False),
                        f"{c.chi2_per_pixel:.2f}",
                    ]
                )
        return rows + [row for of in self.rejected for row in of.rows()]


def _shown(value: Uncertain | None, unit: bool = True) -> str:
    if value is None or not math.isfinite(value.value):
        return "-"
    return str(value if unit else Uncertain(value.value, value.std))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _rounded(values: Floats) -> list[float | None]:
    return [round(float(v), DIGITS) if math.isfinite(v) else None for v in values]


def _nested(values: Floats) -> list[list[float]]:
    return [[round(float(v), 2) for v in row] for row in values]


def box_words(box: Sequence[int]) -> str:
    """As the command line takes it."""
    return ",".join(map(str, box))
