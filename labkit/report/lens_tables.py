"""Tables of the lens: at best focus, through focus, its modes, its numbers and the sources of their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite, sqrt
from operator import attrgetter

import numpy as np

from labkit.optics import metrics
from labkit.optics.mtf import Direction
from labkit.optics.orders import noll_to_fringe, noll_to_osa
from labkit.optics.rim import Rim
from labkit.optics.through_focus import DEPTH, sensor_shift_um
from labkit.optics.wavefront import DEFOCUS, FittedWavefront
from labkit.optics.zernike import mode_name
from labkit.report.curves import ChannelFocus, Curves
from labkit.report.table import (
    CHANNEL_COLUMN,
    MINUS,
    RANGE_COLUMN,
    UNKNOWN,
    Column,
    Quantity,
    Row,
    Table,
    bare,
    by_range,
    channel_columns,
    compared,
    estimated,
    fixed,
    listed,
    millimetres,
)
from labkit.results import Results, Wavefront
from labkit.results.best_focus import SHARE
from labkit.results.tables import NOT_FITTED
from labkit.results.verdicts import confirmed, stated
from labkit.uncertain import Uncertain, decimals

PERFECT = "diffraction limit of this pupil"
NO_LIMIT = "beyond any range"  # of a lens focused so far away that infinity is still sharp
AT_REFERENCE = "at the reference wavelength"
CYCLES_PER_MM = "cycles/mm"
PITCH_NOTE = "by the pixel pitch, which the plan states without an error"

Measure = Callable[[FittedWavefront, tuple[int, ...]], Uncertain]
Directional = Callable[[ChannelFocus, Direction], Uncertain]


def focus_table(focused: Sequence[ChannelFocus]) -> Table:
    """Strehl ratio, wavefront, MTF and energy of each channel without its defocus."""
    return compared(focused, map(_if_fitted, FOCUS_QUANTITIES), "at best focus")


def _if_fitted(quantity: Quantity) -> Quantity:
    """Return a quantity that is not there for channels whose defocus alone was fitted, unless no fit is needed for it."""
    if quantity.name == PERFECT or quantity.exact or quantity.why:
        return quantity
    return replace(
        quantity, number=lambda b: quantity.number(b) if b.fitted.noll else NOT_FITTED
    )


def _directed(name: str, *, first: bool = False) -> tuple[Quantity, Quantity]:
    """Return the magnitude and the angle of a pair of modes."""
    pair = attrgetter(f"best.{name}")

    def magnitude(b: ChannelFocus) -> Uncertain | str:
        return pair(b).magnitude if pair(b) else NOT_FITTED

    def angle(b: ChannelFocus) -> Uncertain | str:
        return pair(b).angle_deg if pair(b) else NOT_FITTED

    return (
        Quantity(name.capitalize(), "waves RMS", magnitude, 4, first=first),
        Quantity("at", "degrees", angle, 1, beside=True),
    )


def _along(
    name: str, unit: str, number: Directional, least: int = 0, *, first: bool = False
) -> tuple[Quantity, Quantity]:
    """Return a quantity along x and along y."""
    return (
        Quantity(f"{name} along x", unit, lambda b: number(b, "x"), least, first=first),
        Quantity("along y", unit, lambda b: number(b, "y"), least),
    )


def _ideal(unit: str, number: Callable[[ChannelFocus], Uncertain]) -> Quantity:
    """Return the number of a perfect lens of this cone, which is as sure as the f-number."""

    def words(b: ChannelFocus) -> str:
        ideal = number(b)
        return estimated(ideal, least=3 if ideal.value < 1 else 1)

    return Quantity(PERFECT, unit, words, beside=True)


FOCUS_QUANTITIES = (
    Quantity(
        "From the photographs at",
        "",
        lambda b: millimetres(b.photographed.range_mm),
        exact=True,
        beside=True,
    ),
    Quantity("Strehl ratio", "", lambda b: b.best.strehl, 3, first=True),
    Quantity("RMS", "nm", lambda b: b.best.rms_nm, first=True),
    Quantity("in its own light", "waves", lambda b: b.best.rms_own_waves, 4, beside=True),
    Quantity(AT_REFERENCE, "waves", lambda b: b.best.rms, 4, beside=True),
    Quantity("P–V", "nm", lambda b: estimated(b.best.peak_to_valley, b.reference_nm)),
    Quantity(AT_REFERENCE, "waves", lambda b: b.best.peak_to_valley, 3, beside=True),
    *_directed("astigmatism", first=True),
    *_directed("coma"),
    *_directed("trefoil"),
    *_along("MTF50 of the optics", CYCLES_PER_MM, ChannelFocus.mtf50, first=True),
    _ideal(CYCLES_PER_MM, lambda b: b.best.ideal.mtf50("x")),
    *_along("MTF50 with the pixel", CYCLES_PER_MM, ChannelFocus.camera_mtf50),
    Quantity(
        "Nyquist of its own pixels",
        CYCLES_PER_MM,
        lambda b: fixed(b.nyquist_per_mm, 1),
        why=PITCH_NOTE,
        first=True,
    ),
    *_along("MTF there, optics", "", ChannelFocus.at_nyquist, 3),
    _ideal("", lambda b: b.best.ideal.mtf_at(b.nyquist_per_mm, "x")),
    *_along("MTF there, with the pixel", "", ChannelFocus.camera_at_nyquist, 3),
    Quantity(
        f"EE{100 * SHARE:.0f}, encircled energy",
        "µm radius",
        lambda b: b.best.energy_radius(),
        first=True,
    ),
    _ideal("µm radius", lambda b: b.best.ideal.energy_radius()),
)


def depth_table(curves: Sequence[Curves], results: Results) -> Table:
    """Return each channel's range of distances with a Strehl ratio of at least 0.8 of its highest."""
    errors = results.focus.best_focus_mm if results.focus else {}
    unit = "mm" if all(c.in_ranges for c in curves) else "µm"

    def best(curve: Curves) -> Uncertain | str:
        return errors[curve.channel] if curve.in_ranges else "origin"

    def at(which: str) -> Callable[[Curves], Uncertain | str]:
        def place(curve: Curves) -> Uncertain | str:
            if curve.depth is None:
                return NO_LIMIT
            focus_std = errors[curve.channel].std if curve.in_ranges else 0.0
            found = curve.placed(getattr(curve.depth, which), focus_std)
            return found if isfinite(found.value) else NO_LIMIT

        return place

    quantities = (
        Quantity("Best focus: no defocus", unit, best),
        Quantity("Highest Strehl ratio at", unit, at("highest"), beside=True),
        Quantity("Depth of focus from", unit, at("near"), first=True),
        Quantity("to", unit, at("far")),
        Quantity("on the sensor", "µm", _on_sensor),
    )
    return compared(curves, quantities, f"Strehl ratio ≥ {DEPTH:g} of its highest")


def _on_sensor(curve: Curves) -> str:
    """The depth as a way of the sensor, 8 N^2 times a path: twice the relative error of the cone."""
    if curve.depth is None:
        return NO_LIMIT
    fitted = curve.focus.fitted
    span = curve.depth.span
    factor = sensor_shift_um(fitted, 1.0)
    cone = 2 * fitted.f_number_relative_std * span.value
    return estimated(Uncertain(span.value, (span.std**2 + cone**2) ** 0.5), factor)


SOURCES = {
    "photons": "light and read noise of the photographs",
    "calibration": "light and read noise of the flats",
    "geometry": "engravings, tape, rail, and sizes of target and picture",
    "model": "wavelengths, and how far a real lens departs from the laws",
}
"""Of errors, in the order they are drawn, and what each holds."""

LENS_NAMES = {
    "best_focus_mm": ("best focus", "mm"),
    "focal_length_mm": ("focal length", "mm"),
    "f_number": ("f-number at infinity", ""),
    "pupil_magnification": ("pupil magnification", ""),
    "range_zero_mm": ("true ranges less stated", "mm"),
}
"""Keys of a budget, what they are called, and their units."""


def lens_table(results: Results) -> Table | None:
    """Return measured values beside the plan's, channels in groups; None if the lens was not estimated."""
    lens = results.lens
    focus = results.focus
    plan = results.plan
    if lens is None:
        return None
    stated = plan.lens
    zero = Uncertain(0.0, plan.fit.range_zero_std_mm)
    light = {one.name: one.stated_wavelength for one in plan.channel}
    cones = {channel: working_f_number(results, channel) for channel in results.channels}
    rows = (
        _row("Focal length", "mm", lens.focal_length, stated.stated_focal_length),
        _row("f-number at infinity", "", lens.f_number, stated.stated_f_number),
        *_full_pupil(results.wavefronts[0].rim, lens.f_number),
        _row("Pupil magnification", "", lens.pupil_magnification),
        _row("True ranges less stated", "mm", lens.range_zero, zero),
        *_rows_by_channel("Best focus, mm", focus.best_focus_mm if focus else {}),
        *_rows_by_channel("f-number at the sensor", cones),
        *_rows_by_channel("Wavelength, nm", lens.wavelengths_nm, light),
    )
    columns = (
        Column("quantity", text=True),
        Column("", text=True),
        Column("measured"),
        Column("stated"),
    )
    return Table(columns, rows, strong=2, channels=1)


def _full_pupil(rim: Rim, f_number: Uncertain) -> list[Row]:
    """Return the f-number of the circle around a pupil other than a clear disc."""
    if rim.is_round:
        return []
    outer = Uncertain(f_number.value / rim.outer, f_number.std / rim.outer)
    row = _row("of the full pupil", "", outer)
    return [Row(row.cells, beside=True)]


def working_f_number(results: Results, channel: str) -> Uncertain:
    """Return the working f-number of a channel, for all ranges, from the wavefront with the least error."""
    cones = [w.working_f_number for w in results.of_channel(channel)]
    return min(cones, key=lambda cone: cone.std if isfinite(cone.std) else float("inf"))


def budget_table(results: Results) -> Table | None:
    """Standard error by source in the order of `SOURCES`, and the whole; a row for each number. None without a budget."""
    if not results.budget:
        return None
    rows = []
    for key, shares in results.budget.items():
        name, unit = budget_name(key)
        whole = whole_std(shares)
        # one digit more than the whole has: what is a tenth of it is seen to be
        digits = decimals(whole) + 1
        cells = [_share(shares.get(source, 0.0), digits) for source in SOURCES]
        rows.append(Row((name, unit, *cells, fixed(whole, digits))))
    errors = [Column(source, exact=True) for source in (*SOURCES, "all")]
    columns = (Column("standard error of", text=True), Column("", text=True), *errors)
    return Table(columns, tuple(rows), strong=len(columns) - 1)


def _share(std: float, digits: int) -> str:
    """Return a standard error; an upper limit if below the last digit."""
    least = 10.0**-digits
    return fixed(std, digits) if std == 0 or std >= least / 2 else f"< {least:.{digits}f}"


def budget_name(key: str) -> tuple[str, str]:
    """Return the name and the unit of a number of the budget, with its channel."""
    quantity, _, channel = key.partition(".")
    name, unit = LENS_NAMES.get(quantity, (quantity.replace("_", " "), ""))
    return (f"{name}, {channel}" if channel else name), unit


def whole_std(shares: dict[str, float]) -> float:
    """Return the standard error by all sources together."""
    return sqrt(sum(share**2 for share in shares.values()))


def _rows_by_channel(
    name: str, measured: Mapping[str, Uncertain], known: Mapping[str, Uncertain] = {}
) -> list[Row]:
    """Return a row for each channel, the first with the name. known: as stated."""
    rows = [
        _row("" if k else name, channel, number, known.get(channel))
        for k, (channel, number) in enumerate(measured.items())
    ]
    return [Row(row.cells, first=k == 0) for k, row in enumerate(rows)]


def _row(name: str, unit: str, measured: Uncertain, stated: Uncertain | None = None) -> Row:
    return Row(
        (name, unit, estimated(measured), UNKNOWN if stated is None else estimated(stated))
    )


ALIKE = 1e-6
"""Waves: modes nearer than this are one estimate for all ranges, written twice."""


def path_table(results: Results, without: tuple[int, ...] = ()) -> Table:
    """Return RMS and P-V of each fit, in waves and nanometres. without: Noll modes to omit."""

    def column(label: str, unit: str, measure: Measure, least: int = 0) -> Column:
        def cell(w: Wavefront) -> str:
            known = confirmed(w, results.wavefronts)
            number = stated(measure(w.fitted, without), known=known)
            factor = w.reference_wavelength_nm if unit == "nm" else 1.0
            return estimated(number, factor, least=least)

        return Column(label, unit, cell=cell)

    return listed(
        by_range(results),
        RANGE_COLUMN,
        CHANNEL_COLUMN,
        column("RMS", "waves", metrics.rms, 4),
        column("", "nm", metrics.rms),
        column("P–V", "waves", metrics.peak_to_valley, 3),
        column("", "nm", metrics.peak_to_valley),
        channels=1,
    )


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
    """Return the differences of all modes but defocus from those at best focus, for each range; None if there
    are none.

    Estimates of two ranges are independent; a session's estimate has one set of modes for
    all.
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
        one = here[j]
        two = other[j]
        if one.sign_open or two.sign_open:
            continue
        if abs(two.value - one.value) < ALIKE:
            continue
        difference = Uncertain(two.value - one.value, float(np.hypot(one.std, two.std)))
        where = bare(other.range_mm)
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
