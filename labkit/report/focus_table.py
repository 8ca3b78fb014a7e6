"""What the optics do at best focus and about it: a row for each number, a column for each channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite

from labkit.optics.metrics import Directed
from labkit.optics.through_focus import DEPTH, sensor_shift_um
from labkit.report.best_focus import ChannelFocus
from labkit.report.curves import Curves
from labkit.report.quantities import estimated, fixed, millimetres
from labkit.report.table import Column, Row, Table, channel_columns
from labkit.results import Results
from labkit.results.best_focus import SHARE
from labkit.results.tables import NOT_FITTED
from labkit.uncertain import Uncertain

PERFECT = "diffraction limit of this pupil"
NO_LIMIT = "beyond any range"  # of a lens focused so far away that infinity is still sharp
PITCH_NOTE = "by the pixel pitch, which the plan states without an error"

Cell = Callable[[ChannelFocus], str]


def focus_table(focused: Sequence[ChannelFocus], reference_nm: float) -> Table:
    """Strehl ratio, wavefront, MTF and energy of each channel without its defocus."""
    within = f"EE{100 * SHARE:.0f}, encircled energy"
    at = "at the reference wavelength"

    def row(name: str, unit: str, cell: Cell, **kind: object) -> Row:
        holds = name == PERFECT or kind.get("exact") or kind.get("why")
        cells = tuple(cell(b) if b.fitted.noll or holds else NOT_FITTED for b in focused)
        return Row((name, unit, *cells), **kind)  # type: ignore[arg-type]

    rows = (
        row(
            "From the photographs at",
            "",
            lambda b: millimetres(b.photographed.range_mm),
            exact=True,
            beside=True,
        ),
        row("Strehl ratio", "", lambda b: estimated(b.best.strehl, least=3), first=True),
        row("RMS", "nm", lambda b: estimated(b.best.rms_nm), first=True),
        row("in its own light", "waves", _own_waves, beside=True),
        row(at, "waves", lambda b: estimated(b.best.rms, least=4), beside=True),
        row("P–V", "nm", lambda b: estimated(b.best.peak_to_valley, reference_nm)),
        row(at, "waves", lambda b: estimated(b.best.peak_to_valley, least=3), beside=True),
        row(
            "Astigmatism", "waves RMS", lambda b: _magnitude(b.best.astigmatism), first=True
        ),
        row("at", "degrees", lambda b: _angle(b.best.astigmatism), beside=True),
        row("Coma", "waves RMS", lambda b: _magnitude(b.best.coma)),
        row("at", "degrees", lambda b: _angle(b.best.coma), beside=True),
        row("Trefoil", "waves RMS", lambda b: _magnitude(b.best.trefoil)),
        row("at", "degrees", lambda b: _angle(b.best.trefoil), beside=True),
        *_mtf_rows(row),
        row(within, "µm radius", lambda b: estimated(b.best.energy_radius()), first=True),
        row(
            PERFECT,
            "µm radius",
            lambda b: _ideal(b.best.ideal.energy_radius()),
            beside=True,
        ),
    )
    return Table((*FOCUS_COLUMNS, *channel_columns([b.channel for b in focused])), rows)


def _mtf_rows(row: Callable[..., Row]) -> tuple[Row, ...]:
    """Return MTF50 and the MTF at Nyquist's frequency, of the optics and with the pixel."""
    return (
        row(
            "MTF50 of the optics along x",
            "cycles/mm",
            lambda b: estimated(b.mtf50("x")),
            first=True,
        ),
        row("along y", "cycles/mm", lambda b: estimated(b.mtf50("y"))),
        row(
            PERFECT,
            "cycles/mm",
            lambda b: _ideal(b.best.ideal.mtf50("x")),
            beside=True,
        ),
        row(
            "MTF50 with the pixel along x",
            "cycles/mm",
            lambda b: estimated(b.camera_mtf50("x")),
        ),
        row("along y", "cycles/mm", lambda b: estimated(b.camera_mtf50("y"))),
        row(
            "Nyquist of its own pixels",
            "cycles/mm",
            lambda b: fixed(b.nyquist_per_mm, 1),
            why=PITCH_NOTE,
            first=True,
        ),
        row(
            "MTF there, optics along x", "", lambda b: estimated(b.at_nyquist("x"), least=3)
        ),
        row("along y", "", lambda b: estimated(b.at_nyquist("y"), least=3)),
        row(
            PERFECT,
            "",
            lambda b: _ideal(b.best.ideal.mtf_at(b.nyquist_per_mm, "x")),
            beside=True,
        ),
        row(
            "MTF there, with the pixel along x",
            "",
            lambda b: estimated(b.camera_at_nyquist("x"), least=3),
        ),
        row("along y", "", lambda b: estimated(b.camera_at_nyquist("y"), least=3)),
    )


FOCUS_COLUMNS = (Column("at best focus", text=True), Column("", text=True))


def depth_table(curves: Sequence[Curves], results: Results) -> Table:
    """Where the Strehl ratio keeps to 0.8 of its highest, of each channel."""
    errors = results.focus.best_focus_mm if results.focus else {}
    unit = "mm" if all(c.in_ranges for c in curves) else "µm"

    def row(name: str, unit: str, cell: Callable[[Curves], str], **kind: object) -> Row:
        return Row((name, unit, *(cell(c) for c in curves)), **kind)  # type: ignore[arg-type]

    def at(curve: Curves, which: str) -> str:
        if curve.depth is None:
            return NO_LIMIT
        focus_std = errors[curve.channel].std if curve.in_ranges else 0.0
        return _place(curve.placed(getattr(curve.depth, which), focus_std))

    rows = (
        row("Best focus: least RMS", unit, lambda c: _best(c, errors)),
        row("Highest Strehl ratio at", unit, lambda c: at(c, "highest"), beside=True),
        row("Depth of focus from", unit, lambda c: at(c, "near"), first=True),
        row("to", unit, lambda c: at(c, "far")),
        row("on the sensor", "µm", _on_sensor),
    )
    return Table(
        (
            Column(f"Strehl ratio ≥ {DEPTH:g} of its highest", text=True),
            Column("", text=True),
            *_channels(curves),
        ),
        rows,
    )


def _channels(curves: Sequence[Curves]) -> list[Column]:
    return list(channel_columns([c.channel for c in curves]))


def _best(curve: Curves, errors: dict[str, Uncertain]) -> str:
    return estimated(errors[curve.channel]) if curve.in_ranges else "origin"


def _place(place: Uncertain) -> str:
    return estimated(place) if isfinite(place.value) else NO_LIMIT


def _on_sensor(curve: Curves) -> str:
    """The depth as a way of the sensor, 8 N^2 times a path: twice the relative error of the cone."""
    if curve.depth is None:
        return NO_LIMIT
    fitted, span = curve.focus.fitted, curve.depth.span
    factor = sensor_shift_um(fitted, 1.0)
    cone = 2 * fitted.f_number_relative_std * span.value
    return estimated(Uncertain(span.value, (span.std**2 + cone**2) ** 0.5), factor)


def _own_waves(of: ChannelFocus) -> str:
    return estimated(of.best.rms_own_waves, least=4)


def _ideal(number: Uncertain) -> str:
    """A perfect lens of this cone: its number is as sure as the f-number."""
    return estimated(number, least=3 if number.value < 1 else 1)


def _magnitude(pair: Directed | None) -> str:
    return NOT_FITTED if pair is None else estimated(pair.magnitude, least=4)


def _angle(pair: Directed | None) -> str:
    return NOT_FITTED if pair is None else estimated(pair.angle_deg, least=1)
