"""Tables of the wavefronts: RMS and peak to valley at each range, the modes, and how they differ from range to range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.optics import metrics
from labkit.optics.orders import noll_to_fringe, noll_to_osa
from labkit.optics.wavefront import DEFOCUS
from labkit.optics.zernike import mode_name
from labkit.report.best_focus import ChannelFocus
from labkit.report.quantities import MINUS, estimated
from labkit.report.table import Column, Row, Table, channel_columns
from labkit.results import Results, Wavefront
from labkit.results.verdicts import confirmed, stated
from labkit.uncertain import Uncertain

ALIKE = 1e-6
"""Waves: modes nearer than this are one estimate for all ranges, written twice."""


def path_table(results: Results, without: tuple[int, ...] = ()) -> Table:
    """RMS and P-V of each range and channel, in waves and nanometres. without: Noll modes to leave out."""
    columns = (
        Column("range", "mm", exact=True),
        Column("channel", text=True),
        Column("RMS", "waves"),
        Column("", "nm"),
        Column("P–V", "waves"),
        Column("", "nm"),
    )
    rows = [
        Row(_path_cells(w, without, known=confirmed(w, results.wavefronts)), first=k == 0)
        for range_mm in results.ranges_mm
        for k, w in enumerate(results.at_range(range_mm))
    ]
    return Table(columns, tuple(rows), channels=1)


def _path_cells(w: Wavefront, without: tuple[int, ...], *, known: bool) -> tuple[str, ...]:
    cells = ["none" if w.range_mm is None else f"{w.range_mm:g}", w.channel]
    for measure, least in ((metrics.rms, 4), (metrics.peak_to_valley, 3)):
        number = stated(measure(w.fitted, without), known=known)
        cells += [
            estimated(number, least=least),
            estimated(number, w.reference_wavelength_nm),
        ]
    return tuple(cells)


def mode_table(focused: Sequence[ChannelFocus], unit: str, factor: float = 1.0) -> Table:
    """Each mode at best focus, of each channel, with its OSA and Fringe index. factor: of the unit to waves."""
    columns = [
        Column("Noll", exact=True),
        Column("OSA", exact=True),
        Column("Fringe", exact=True),
        Column("mode", text=True, exact=True),
    ]
    columns += channel_columns([best.channel for best in focused], unit)
    modes = sorted({j for best in focused for j in best.fitted.noll})
    rows = []
    for j in modes:
        cells = [str(j), str(noll_to_osa(j)), str(noll_to_fringe(j)), mode_name(j)]
        numbers = [_coefficient(best, j) for best in focused]
        cells += [
            estimated(number, factor, least=4 if factor == 1 else 1) for number in numbers
        ]
        rows.append(Row(tuple(cells)))
    return Table(tuple(columns), tuple(rows))


def difference_table(results: Results, focused: Sequence[ChannelFocus]) -> Table | None:
    """Of each range, by how much each mode but defocus differs from that at best focus; None where none does.

    Estimates of two ranges are independent; a session's estimate has one set of modes for all.
    """
    rows = []
    for best in focused:
        here = best.photographed
        for w in results.of_channel(here.channel):
            if w is not here:
                rows += _differences(here, w)
    if not rows:
        return None
    columns = (
        Column("channel", text=True),
        Column("range", "mm", exact=True),
        Column("mode", text=True, exact=True),
        Column("difference", "waves RMS"),
        Column("in standard errors", exact=True),
    )
    return Table(columns, tuple(rows), channels=0)


def _differences(here: Wavefront, other: Wavefront) -> list[Row]:
    rows = list[Row]()
    for j in here.noll:
        if j == DEFOCUS or j not in other.noll:
            continue
        one, two = here[j], other[j]
        if one.sign_open or two.sign_open:
            continue
        if abs(two.value - one.value) < ALIKE:
            continue
        difference = Uncertain(two.value - one.value, float(np.hypot(one.std, two.std)))
        where = "none" if other.range_mm is None else f"{other.range_mm:g}"
        ratio = difference.value / difference.std if difference.std > 0 else float("nan")
        cells = (
            here.channel,
            where,
            f"{j}, {mode_name(j)}",
            estimated(difference, least=4),
            f"{ratio:+.1f}".replace("-", MINUS),
        )
        rows.append(Row(cells, first=not rows))
    return rows


def _coefficient(focus: ChannelFocus, j: int) -> Uncertain | None:
    w = focus.photographed
    return stated(w[j], known=focus.unsure is None) if j in w.noll else None
