"""The table of what the optics do at best focus: a row for each number, a column for each channel."""

from collections.abc import Callable, Sequence

from labkit.optics.encircled_energy import radius_of_energy
from labkit.optics.metrics import Directed
from labkit.optics.mtf import mtf50
from labkit.report.best_focus import SHARE, BestFocus
from labkit.report.quantities import UNKNOWN, estimated, fixed, plus_minus

Row = dict[str, object]
Cell = Callable[[BestFocus], str]


def focus_table(focused: Sequence[BestFocus], reference_nm: float) -> list[Row]:
    """Rows of name, unit, cells; `beside` marks what stands beside the number above it, `first` the first of a group."""
    within = f"{100 * SHARE:.0f} % of the energy within"

    def row(name: str, unit: str, cell: Cell, *, first: bool = False, beside: bool = False) -> Row:
        cells = [cell(best) for best in focused]
        return {"name": name, "unit": unit, "cells": cells, "first": first, "beside": beside}

    return [
        row("Strehl ratio at best focus", "", lambda b: estimated(b.strehl, least=3)),
        row("as photographed", "", _as_photographed, beside=True),
        row("RMS without defocus", "waves", lambda b: estimated(b.rms, least=4), first=True),
        row("", "nm", lambda b: estimated(b.rms, reference_nm), beside=True),
        row("P–V without defocus", "waves", lambda b: estimated(b.peak_to_valley, least=3)),
        row("", "nm", lambda b: estimated(b.peak_to_valley, reference_nm), beside=True),
        row("MTF50 along x", "cycles/mm", lambda b: estimated(b.mtf50["x"]), first=True),
        row("along y", "cycles/mm", lambda b: estimated(b.mtf50["y"])),
        row("of a perfect lens", "cycles/mm", lambda b: fixed(mtf50(b.perfect, "x").value, 1), beside=True),
        row(within, "µm radius", lambda b: estimated(b.energy_radius_um), first=True),
        row("of a perfect lens", "µm radius", _perfect_radius, beside=True),
        row("Astigmatism", "waves RMS", lambda b: _magnitude(b.astigmatism), first=True),
        row("at", "degrees", lambda b: _angle(b.astigmatism), beside=True),
        row("Coma", "waves RMS", lambda b: _magnitude(b.coma)),
        row("at", "degrees", lambda b: _angle(b.coma), beside=True),
        row("Trefoil", "waves RMS", lambda b: _magnitude(b.trefoil)),
        row("at", "degrees", lambda b: _angle(b.trefoil), beside=True),
    ]


def _as_photographed(best: BestFocus) -> str:
    return estimated(best.photographed.strehl, least=3)


def _perfect_radius(best: BestFocus) -> str:
    return fixed(radius_of_energy(best.perfect, SHARE).value, 2)


def _magnitude(pair: Directed | None) -> str:
    return UNKNOWN if pair is None else estimated(pair.magnitude, least=4)


def _angle(pair: Directed | None) -> str:
    return UNKNOWN if pair is None else plus_minus(pair.angle_deg.value, pair.angle_deg.std, 1)
