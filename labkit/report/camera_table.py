"""Tables of the camera's fitted parts, and of all tested parts."""

from __future__ import annotations

from collections.abc import Sequence

from labkit.imaging.parts import ESTIMATED, OPTIONAL_PARTS
from labkit.optics.metrics import psf_difference
from labkit.optics.strehl import strehl
from labkit.report.curves import ChannelFocus
from labkit.report.table import UNKNOWN, Column, Row, Table, estimated, fixed
from labkit.results import Results

COLOUR = "at that distance from the mean wavelength, if the colours' foci lie on a parabola"
BOUND = "a bound: no more, with 95 % confidence"


def part_table(results: Results) -> Table | None:
    """Return the numbers of the fitted parts; None without fitted parts."""
    rows, before = list[Row](), ""
    for key, number in results.model_parts.items():
        part, *channel, what = key.split(".")
        meanings = ESTIMATED[part].meanings if part in ESTIMATED else {}
        of = ", ".join([meanings.get(what, what), *channel])
        name = _title(part) if part != before else ""
        rows.append(Row((name, of, number.unit, estimated(number)), first=bool(name)))
        before = part
    columns = (
        Column("part", text=True),
        Column("", text=True),
        Column("", text=True),
        Column("fitted"),
    )
    return Table(columns, tuple(rows), strong=3) if rows else None


def light_table(results: Results, focused: Sequence[ChannelFocus]) -> Table | None:
    """Return the largest possible width of each channel's light and the effect on PSFs; None if the plan states all light."""
    rows, slopes = [], results.focus_slopes()
    for best in focused:
        nm = results.widest_light_nm.get(best.channel)
        if nm is None:
            continue
        named = results.named_lights.get(best.channel)
        light, width = (
            (UNKNOWN, UNKNOWN)
            if named is None
            else (f"{named.light}, {named.filters}", estimated(named.width))
        )
        photographed = [w.fitted for w in results.of_channel(best.channel)]
        most = max(psf_difference(fitted, fitted.in_light(nm)) for fitted in photographed)
        broad = best.fitted.in_light(nm)
        apart = [
            fixed(100 * difference, 1)
            for difference in (psf_difference(best.fitted, broad), most)
        ]
        slope = slopes.get(best.channel)
        away = UNKNOWN if slope is None else fixed(abs(slope) * nm, 3)
        strehl_then = estimated(strehl(broad), least=3)
        rows.append(
            Row((best.channel, light, width, fixed(nm, 0), strehl_then, *apart, away))
        )
    columns = (
        Column("channel", text=True),
        Column("light and filters", text=True),
        Column("standard deviation by the tables", "nm"),
        Column("at most", "nm", why=BOUND),
        Column("Strehl ratio then"),
        Column("PSF at best focus", "%, L1", why=BOUND),
        Column("as photographed", "%, L1", why=BOUND),
        Column("defocus", "waves", why=COLOUR),
    )
    return Table(columns, tuple(rows), channels=0) if rows else None


def missing_words(results: Results) -> str:
    """Return the names of detected parts that the model lacks; empty without any."""
    return ", ".join(
        _title(name) for name in dict.fromkeys(name for w in results for name in w.missing)
    )


def tried_table(results: Results) -> Table:
    """Return all tested parts with their gains in log-likelihood, and whether the fit includes them."""
    rows = [
        Row((_title(p.name), fixed(p.gain, 1), "taken in" if p.adopted else ""))
        for p in results.parts_tried
    ]
    columns = (
        Column("part", text=True),
        Column("gain", why="a log-likelihood, a test's statistic"),
        Column("", text=True),
    )
    return Table(columns, tuple(rows))


def _title(name: str) -> str:
    """Return a part's title; the name of a part unknown to this version of labkit."""
    return OPTIONAL_PARTS[name].title if name in OPTIONAL_PARTS else name
