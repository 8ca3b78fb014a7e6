"""The lens beside what the plan states of it, and where the errors of both come from: rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, sqrt

from labkit.optics.rim import Rim
from labkit.report.quantities import UNKNOWN, estimated, fixed
from labkit.report.table import Column, Row, Table
from labkit.results import Results
from labkit.uncertain import Uncertain, decimals

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
    """What was measured beside what the plan stated, channels in groups; None where the lens was not estimated."""
    lens, focus, plan = results.lens, results.focus, results.plan
    if lens is None:
        return None
    stated, zero = plan.lens, Uncertain(0.0, plan.fit.range_zero_std_mm)
    cones = {channel: working_f_number(results, channel) for channel in results.channels}
    rows = (
        _row("Focal length", "mm", lens.focal_length, stated.stated_focal_length),
        _row("f-number at infinity", "", lens.f_number, stated.stated_f_number),
        *_full_pupil(results.wavefronts[0].rim, lens.f_number),
        _row("Pupil magnification", "", lens.pupil_magnification),
        _row("True ranges less stated", "mm", lens.range_zero, zero),
        *_rows_by_channel("Best focus, mm", focus.best_focus_mm if focus else {}),
        *_rows_by_channel("f-number at the sensor", cones),
    )
    columns = (
        Column("quantity", text=True),
        Column("", text=True),
        Column("measured"),
        Column("stated"),
    )
    return Table(columns, rows, strong=2, channels=1)


def _full_pupil(rim: Rim, f_number: Uncertain) -> list[Row]:
    """The f-number of the circle around a pupil that is no clear disc."""
    if rim.is_round:
        return []
    outer = Uncertain(f_number.value / rim.outer, f_number.std / rim.outer)
    row = _row("of the full pupil", "", outer)
    return [Row(row.cells, beside=True)]


def working_f_number(results: Results, channel: str) -> Uncertain:
    """Of the cone that reaches the sensor: one for all ranges of a channel, from the wavefront that knows it best."""
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
    """A standard error; below the last digit that it is, unless it is none."""
    least = 10.0**-digits
    return fixed(std, digits) if std == 0 or std >= least / 2 else f"< {least:.{digits}f}"


def budget_name(key: str) -> tuple[str, str]:
    """What a budget's number is called, its channel named, and its unit."""
    quantity, _, channel = key.partition(".")
    name, unit = LENS_NAMES.get(quantity, (quantity.replace("_", " "), ""))
    return (f"{name}, {channel}" if channel else name), unit


def whole_std(shares: dict[str, float]) -> float:
    """The standard error that the sources make together."""
    return sqrt(sum(share**2 for share in shares.values()))


def _rows_by_channel(name: str, measured: Mapping[str, Uncertain]) -> list[Row]:
    """One row for each channel; only the first has the name."""
    rows = [
        _row("" if k else name, channel, number)
        for k, (channel, number) in enumerate(measured.items())
    ]
    return [Row(row.cells, first=k == 0) for k, row in enumerate(rows)]


def _row(name: str, unit: str, measured: Uncertain, stated: Uncertain | None = None) -> Row:
    return Row(
        (name, unit, estimated(measured), UNKNOWN if stated is None else estimated(stated))
    )
