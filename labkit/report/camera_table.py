"""What was found of the camera, and which of its parts the photographs were tested for."""

from __future__ import annotations

from collections.abc import Sequence

from labkit.optics.metrics import psf_difference
from labkit.optics.strehl import strehl
from labkit.report.best_focus import BestFocus
from labkit.report.quantities import estimated, fixed
from labkit.report.table import Column, Row, Table
from labkit.results import Results

NAMES = {
    "low_pass_filter": "low-pass filter",
    "low_pass_filter_turned": "low-pass filter, turned by 45°",
    "diffusion": "charge diffusion",
    "smear": "smear",
    "veil": "veil of stray light",
    "spectrum": "spectrum",
    "panel_pixels": "the panel's pixels",
}
"""Parts of the camera, as results name them, in words."""

NUMBERS = {
    "spread_px": "distance of its spots",
    "rows_px": "along rows",
    "columns_px": "along columns",
    "sigma_px": "standard deviation",
    "width_nm": "standard deviation",
    "share": "of all light",
    "scale_px": "distance over which it falls to 1/e",
    "lit_across": "share of its third that a stripe is lit over",
    "lit_down": "share of the pitch along it",
}


BOUND = "a bound: no more, with 95 % confidence"


def part_table(results: Results) -> Table | None:
    """Each number of the parts that were fitted; None where none was."""
    rows, before = list[Row](), ""
    for key, number in results.model_parts.items():
        part, *channel, what = key.split(".")
        of = ", ".join([NUMBERS.get(what, what), *channel])
        name = NAMES.get(part, part) if part != before else ""
        rows.append(Row((name, of, number.unit, estimated(number)), first=bool(name)))
        before = part
    columns = (Column("part", text=True), Column("", text=True), Column("", text=True), Column("fitted"))
    return Table(columns, tuple(rows), strong=3) if rows else None


def light_table(results: Results, focused: Sequence[BestFocus]) -> Table | None:
    """How broad the light of each channel may be, and what that would do to its PSFs; None where the plan states all light."""
    rows = []
    for best in focused:
        nm = results.widest_light_nm.get(best.channel)
        if nm is None:
            continue
        photographed = [w.fitted for w in results.of_channel(best.channel)]
        most = max(psf_difference(fitted, fitted.in_light(nm)) for fitted in photographed)
        broad = best.fitted.in_light(nm)
        apart = [fixed(100 * difference, 1) for difference in (psf_difference(best.fitted, broad), most)]
        rows.append(Row((best.channel, fixed(nm, 0), estimated(strehl(broad), least=3), *apart)))
    columns = (
        Column("channel", text=True),
        Column("standard deviation", "nm", why=BOUND),
        Column("Strehl ratio then"),
        Column("PSF at best focus", "%, L1", why=BOUND),
        Column("as photographed", "%, L1", why=BOUND),
    )
    return Table(columns, tuple(rows), channels=0) if rows else None


def missing_words(results: Results) -> str:
    """What the data call for that the model lacks, in words; nothing where it lacks nothing."""
    return ", ".join(NAMES.get(name, name) for name in dict.fromkeys(name for w in results for name in w.missing))


def tried_table(results: Results) -> Table:
    """Parts that the photographs were tested for: what each would gain, and whether it was taken in."""
    rows = [
        Row((NAMES.get(p.name, p.name), fixed(p.gain, 1), "taken in" if p.adopted else "")) for p in results.parts_tried
    ]
    columns = (
        Column("part", text=True),
        Column("gain", why="a log-likelihood, a test's statistic"),
        Column("", text=True),
    )
    return Table(columns, tuple(rows))
