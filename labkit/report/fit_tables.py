"""Tables of the fits: results of each range, and methods."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

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
