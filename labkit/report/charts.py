"""Charts of all fits: Zernike modes at best focus, and residuals against the normal law."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy import special

from labkit.figure_style import (
    FAINT,
    HALF_IN,
    INK,
    SOFT_INK,
    THIRD_IN,
    Ink,
    channel_inks,
    chart,
    scaling,
)
from labkit.optics.zernike import mode_name
from labkit.report.best_focus import ChannelFocus
from labkit.report.quantities import millimetres
from labkit.results import Residuals, Results
from labkit.types import Floats


def zernike_chart(
    focused: Sequence[ChannelFocus], reference_nm: float, inks: dict[str, Ink]
) -> Figure | None:
    """Bars of each mode at best focus, a bar for each channel, with standard errors; waves below, nanometres above."""
    modes = sorted({j for best in focused for j in best.fitted.noll})
    if not modes:
        return None
    rows = len(modes)
    figure, axes = chart(HALF_IN, 0.95 + 0.27 * rows, left=1.75, top=0.48)
    height = 0.78 / len(focused)
    for k, best in enumerate(focused):
        w = best.fitted
        shown = [(modes.index(j), n) for n, j in enumerate(w.noll)]
        at = np.array([row for row, _ in shown]) + (k - (len(focused) - 1) / 2) * height
        index = [n for _, n in shown]
        axes.barh(
            at,
            w.waves[index],
            0.9 * height,
            color=inks[best.channel].colour,
            label=best.channel,
        )
        if best.photographed.sign_open:
            twin = best.photographed.twin.best.fitted.waves[index]
            axes.barh(at, twin, 0.9 * height, color=inks[best.channel].colour, alpha=0.35)
        error = np.nan_to_num(np.sqrt(np.diag(w.covariance))[index])
        axes.errorbar(
            w.waves[index],
            at,
            xerr=error,
            fmt="none",
            ecolor=INK,
            elinewidth=0.8,
            capsize=1.2,
        )
    axes.axvline(0, color=SOFT_INK, lw=0.7)
    axes.set_yticks(
        range(rows), [f"{mode_name(j)}  {j}" if j <= 15 else str(j) for j in modes]
    )
    axes.set(ylim=(rows - 0.4, -0.6), xlabel=f"waves RMS at {reference_nm:g} nm")
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.secondary_xaxis("top", functions=scaling(reference_nm)).set_xlabel("nm RMS")
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="upper left",
        handlelength=1,
        ncols=3,
        columnspacing=1,
    )
    return figure


def quantile_chart(results: Results, range_mm: float | None) -> Figure:
    """Quantiles of the normalised residuals against the normal law's, and the band that 99 % of points keep to."""
    inks = channel_inks(results.channels)
    figure, axes = chart(THIRD_IN, 2.9)
    axes.set_title(millimetres(range_mm))
    axes.axline((0, 0), slope=1, color=SOFT_INK, lw=0.8)
    drawn = [
        (w, w.residuals) for w in results.at_range(range_mm) if w.residuals is not None
    ]
    for k, (fit, residuals) in enumerate(drawn):
        normal, low, high, observed = residual_quantiles(residuals)
        if k == 0:
            axes.fill_between(normal, low, high, color=FAINT, lw=0)
        ink = inks[fit.channel]
        axes.plot(
            normal,
            observed,
            ink.marker,
            ms=2.6,
            mew=0,
            color=ink.colour,
            alpha=0.85,
            label=fit.channel,
        )
    axes.set(xlabel="normal quantile, σ", ylabel="quantile of the residuals, σ")
    axes.legend(loc="upper left", handletextpad=0.2)
    return figure


def residual_quantiles(residuals: Residuals) -> tuple[Floats, Floats, Floats, Floats]:
    """A hundred quantiles, dense in the tails: of the normal law, the 99 % band around them, and of the residuals."""
    values = residuals.normalised
    values = np.sort(values[np.isfinite(values)])
    tail = np.unique(np.geomspace(1, max((values.size + 1) // 2, 1), 50).astype(int))
    rank = np.unique(np.concatenate([tail, values.size + 1 - tail]))
    rank = rank[(rank >= 1) & (rank <= values.size)]
    after = values.size + 1 - rank
    normal = special.ndtri(
        (rank - 0.375) / (values.size + 0.25)
    )  # Blom's plotting positions
    low, high = (
        np.asarray(special.ndtri(special.betaincinv(rank, after, p)), float)
        for p in (0.005, 0.995)
    )
    return normal, low, high, values[rank - 1]
