"""Tables of the fits: what each photographed range gave, and how it was fitted."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from labkit.report.table import (
    UNKNOWN,
    Column,
    Row,
    Table,
    bare,
    estimated,
    fixed,
    plus_minus,
)
from labkit.results import OptimumTest, Results, Wavefront
from labkit.results.verdicts import confirmed, model_word, optimum_word, stated
from labkit.uncertain import Uncertain

TEST = "what a test of the fit found: it has a distribution, not an error"
NUISANCE = "fitted along with the wavefront; its error is not kept"
NOT_KEPT = "these results do not keep their errors: fit again"


def fit_table(results: Results) -> Table:
    """Defocus and blur of each fit, and whether model and optimum stand."""
    columns = [
        Column("range", "mm", exact=True),
        Column("channel", text=True),
        Column("defocus", "waves RMS"),
        *([Column("blur", "µm")] if results.lens else []),
        Column("χ²/pixel", why=TEST),
        Column("optimum", text=True),
        Column("model", text=True),
    ]
    rows = [Row(_fit_cells(w, results), first=first) for first, w in _in_order(results)]
    return Table(tuple(columns), tuple(rows), channels=1)


def _fit_cells(w: Wavefront, results: Results) -> tuple[str, ...]:
    known = confirmed(w, results.wavefronts)

    def shown(number: Uncertain | None, least: int) -> str:
        return (
            UNKNOWN
            if number is None
            else estimated(stated(number, known=known), least=least)
        )

    between = [shown(w.blur, 2)] if results.lens else []
    defocus = "not fitted" if w.defocus is None else shown(w.defocus, 4)
    verdicts = optimum_word(w.test), model_word(w.test)
    return (
        bare(w.range_mm),
        w.channel,
        defocus,
        *between,
        fixed(w.chi2_per_pixel, 3),
        *verdicts,
    )


def method_table(results: Results) -> Table:
    """Gain, read noise, time and test of each fit, and its photographs."""
    columns = (
        Column("range", "mm", exact=True),
        Column("channel", text=True),
        Column("gain", "counts/e⁻", why=NUISANCE),
        Column("read noise", "counts", why=NUISANCE),
        Column("time", "s", exact=True),
        Column("test of the optimum", text=True, why=TEST),
        Column("photographs", text=True, exact=True),
    )
    rows = [Row(_method_cells(w), first=first) for first, w in _in_order(results)]
    return Table(columns, tuple(rows), channels=1)


def _method_cells(w: Wavefront) -> tuple[str, ...]:
    frames = ", ".join(w.frames) or UNKNOWN
    return (
        bare(w.range_mm),
        w.channel,
        fixed(w.gain, 4),
        fixed(w.read_noise, 2),
        fixed(w.seconds, 1),
        _test(w.test),
        frames,
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


def _in_order(results: Results) -> list[tuple[bool, Wavefront]]:
    return [
        (k == 0, w)
        for range_mm in results.ranges_mm
        for k, w in enumerate(results.at_range(range_mm))
    ]


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
