"""Tables of the fits: results of each range, methods, and the camera's fitted and tested parts."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from labkit.imaging.parts import ESTIMATED, OPTIONAL_PARTS
from labkit.optics.metrics import psf_difference
from labkit.optics.strehl import strehl
from labkit.report.curves import ChannelFocus
from labkit.report.table import (
    CHANNEL_COLUMN,
    RANGE_COLUMN,
    UNKNOWN,
    Column,
    Row,
    Table,
    by_range,
    estimated,
    fixed,
    listed,
    plus_minus,
)
from labkit.results import OptimumTest, Results, Wavefront
from labkit.results.tables import NOT_FITTED
from labkit.results.verdicts import confirmed, model_word, optimum_word, stated
from labkit.uncertain import Uncertain

TEST = "what a test of the fit found: it has a distribution, not an error"
NUISANCE = "fitted along with the wavefront; its error is not kept"
NOT_KEPT = "these results do not keep their errors: fit again"


def fit_table(results: Results) -> Table:
    """Return defocus and blur of each fit, and the verdicts on optimum and model."""

    def shown(w: Wavefront, number: Uncertain | None, least: int) -> str:
        known = confirmed(w, results.wavefronts)
        return estimated(number and stated(number, known=known), least=least)

    def defocus(w: Wavefront) -> str:
        return shown(w, w.defocus, 4) if w.defocus else NOT_FITTED

    blur = Column("blur", "µm", cell=lambda w: shown(w, w.blur, 2))
    return listed(
        by_range(results),
        RANGE_COLUMN,
        CHANNEL_COLUMN,
        Column("defocus", "waves RMS", cell=defocus),
        *([blur] if results.lens else []),
        Column("χ²/pixel", why=TEST, cell=lambda w: fixed(w.chi2_per_pixel, 3)),
        Column("optimum", text=True, cell=lambda w: optimum_word(w.test)),
        Column("model", text=True, cell=lambda w: model_word(w.test)),
        channels=1,
    )


def method_table(results: Results) -> Table:
    """Return gain, read noise, time and test of each fit, and its photographs."""
    return listed(
        by_range(results),
        RANGE_COLUMN,
        CHANNEL_COLUMN,
        Column("gain", "counts/e⁻", why=NUISANCE, cell=lambda w: fixed(w.gain, 4)),
        Column("read noise", "counts", why=NUISANCE, cell=lambda w: fixed(w.read_noise, 2)),
        Column("time", "s", exact=True, cell=lambda w: fixed(w.seconds, 1)),
        Column("test of the optimum", text=True, why=TEST, cell=lambda w: _test(w.test)),
        Column(
            "photographs",
            text=True,
            exact=True,
            cell=lambda w: ", ".join(w.frames) or UNKNOWN,
        ),
        channels=1,
    )


def residual_table(results: Results) -> Table | None:
    """Return the table of each channel's defocus residuals in the focus fit; None without a focus fit."""
    focus = results.focus
    if focus is None:
        return None
    columns = (
        Column("channel", text=True),
        Column("best focus", "mm"),
        Column(
            "defocus residual, by range",
            "milliwaves",
            text=True,
            why="" if focus.residual_std_waves else NOT_KEPT,
        ),
    )
    rows = [
        Row(
            (
                channel,
                plus_minus(best.value, best.std),
                _residuals(focus.residuals(channel)),
            )
        )
        for channel, best in focus.best_focus_mm.items()
    ]
    return Table(columns, tuple(rows), channels=0)


def _residuals(waves: Sequence[Uncertain]) -> str:
    words = (
        estimated(each, 1e3, least=1) if isfinite(each.std) else fixed(1e3 * each.value, 2)
        for each in waves
    )
    return ", ".join(words) or UNKNOWN


def _test(verdict: OptimumTest | None) -> str:
    if verdict is None:
        return "none"
    words = [verdict.name or "unnamed"]
    words += [f"p = {verdict.p_value:.2g}"] if np.isfinite(verdict.p_value) else []
    words += (
        [f"{verdict.starts} start{'' if verdict.starts == 1 else 's'}"]
        if verdict.starts is not None
        else []
    )
    if np.isfinite(verdict.next_below):
        words += [f"next optimum {verdict.next_below:.0f} lower in log-likelihood"]
    return ", ".join(words)


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
