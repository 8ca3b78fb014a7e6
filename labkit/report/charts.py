"""Charts of results: defocus against range, Zernike modes, residuals against the normal law."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import special

from labkit.optics.zernike import mode_name
from labkit.report.quantities import millimetres, plus_minus
from labkit.report.style import FAINT, INK, SOFT, WIDTH_IN, Ink, channel_inks, columns_for, panels, scaling
from labkit.results import Focus, Residuals, Results, Wavefront
from labkit.types import Floats

Curve = Callable[[str, Floats], Floats]  # channel, ranges in mm -> waves RMS


def focus_chart(results: Results, focus: Focus | None, curve: Curve, shortest_mm: float) -> Figure:
    """Defocus against range with the fitted curves and best focus; below it what they leave, in thousandths of a wave.

    curve: the fitted defocus of a channel at ranges; shortest_mm: where it may be drawn from.
    """
    inks = channel_inks(results.channels)
    figure = Figure(figsize=(WIDTH_IN, 5.0 if focus else 3.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1)) if focus else (figure.subplots(), None)
    bounds = _range_bounds(results, focus, shortest_mm)
    above.axhline(0, color=SOFT, lw=0.7)
    for k, channel in enumerate(results.channels):
        fits = [w for w in results.of_channel(channel) if w.defocus and w.measured_range_mm is not None]
        x = np.array([w.measured_range_mm for w in fits], float)
        y = np.array([w.defocus.value for w in fits if w.defocus])
        error = np.nan_to_num(np.array([w.defocus.std for w in fits if w.defocus]))
        ink = inks[channel]
        label = channel
        if focus and channel in focus.best_focus_mm:
            best = focus.best_focus_mm[channel]
            label += f"   best focus {plus_minus(best.value, best.std)} mm"
            grid = np.linspace(*bounds, 300)
            above.plot(grid, curve(channel, grid), color=ink.colour, lw=1.2)
            _mark_focus(above, best.value, best.std, ink)
        _points(above, x, y, error, ink, label)
        rest = np.array(focus.residual_waves.get(channel, ()) if focus else ())
        if below is not None and rest.size == x.size:
            dodge = (k - (len(results.channels) - 1) / 2) * 0.008 * (bounds[1] - bounds[0])
            # errors of a session's estimate are those of the points above, not of what one fit measured alone
            _points(below, x + dodge, 1e3 * rest, 0 * error if results.lens else 1e3 * error, ink, None)
    above.set(xlim=bounds, ylabel=f"defocus, waves RMS at {results.reference_wavelength_nm:g} nm")
    above.legend(loc="lower right")
    _blur_axis(above, results)
    (above if below is None else below).set_xlabel("range of the target, mm")
    if below is not None:
        below.axhline(0, color=SOFT, lw=0.7)
        below.set_ylabel("residual, milliwaves")
        below.margins(y=0.25)
    return figure


def _blur_axis(axes: Axes, results: Results) -> None:
    """Defocus as blur on the right; the channels' cones differ by less than a line is wide."""
    ratios = [w.blur.value / w.defocus.value for w in results if w.blur and w.defocus and w.defocus.value]
    if ratios:
        blur = axes.secondary_yaxis("right", functions=scaling(float(np.median(ratios))))
        blur.set_ylabel("blur on the sensor, µm")


def _range_bounds(results: Results, focus: Focus | None, shortest_mm: float) -> tuple[float, float]:
    ranges = [w.measured_range_mm for w in results if w.measured_range_mm is not None]
    ranges += [best.value for best in focus.best_focus_mm.values() if np.isfinite(best.value)] if focus else []
    low, high = min(ranges), max(ranges)
    margin = 0.06 * (high - low) or 0.01 * high
    return max(low - margin, shortest_mm), high + margin


def _points(axes: Axes, x: Floats, y: Floats, error: Floats, ink: Ink, label: str | None) -> None:
    axes.errorbar(x, y, error, fmt="none", ecolor=ink.colour, elinewidth=1.2, capsize=2)
    axes.plot(x, y, ink.marker, color=ink.colour, ms=5.5, mec="white", mew=0.6, label=label)


def _mark_focus(axes: Axes, value_mm: float, std_mm: float, ink: Ink) -> None:
    axes.axvline(value_mm, color=ink.colour, lw=0.8, ls=(0, (4, 3)))
    if np.isfinite(std_mm):
        axes.axvspan(value_mm - std_mm, value_mm + std_mm, color=ink.colour, alpha=0.25, lw=0)
    axes.plot([value_mm], [0], marker="|", ms=12, mew=1.6, color=ink.colour)


def zernike_chart(
    results: Results, range_mm: float | None, defocus: tuple[float, float], limit: float
) -> Figure | None:
    """Bars of the modes of one range, one for each channel, with standard errors; defocus on its own scale.

    defocus, limit: of the two axes, waves; the same for all ranges.
    """
    inks, fits = channel_inks(results.channels), results.at_range(range_mm)
    modes = sorted({j for w in fits for j in w.noll})
    if not modes:
        return None
    figure = Figure(figsize=(WIDTH_IN, 2.9), layout="constrained")
    groups = [[j for j in modes if j == 4], [j for j in modes if j != 4]]
    groups = [g for g in groups if g]
    axes_of = figure.subplots(1, len(groups), squeeze=False, width_ratios=[max(len(g), 1.4) for g in groups])[0]
    for axes, group in zip(axes_of, groups, strict=True):
        _bars(axes, group, fits, inks)
        nanometres = axes.secondary_yaxis("right", functions=scaling(results.reference_wavelength_nm))
        nanometres.tick_params(labelsize=7.5)
        if axes is axes_of[-1]:
            nanometres.set_ylabel("nm RMS")
        if group == [4] and defocus[0] < defocus[1]:
            axes.set_ylim(*defocus)
        elif group != [4] and limit > 0:
            axes.set_ylim(-limit, limit)
    axes_of[0].set_ylabel("waves RMS")
    axes_of[-1].legend(loc="upper right", ncols=len(fits), borderaxespad=0, handlelength=1)
    return figure


def _bars(axes: Axes, modes: Sequence[int], fits: Sequence[Wavefront], inks: dict[str, Ink]) -> None:
    width = 0.8 / len(fits)
    for k, fit in enumerate(fits):
        shown = [(i, fit.noll.index(j)) for i, j in enumerate(modes) if j in fit.noll]
        x = np.array([i for i, _ in shown]) + (k - (len(fits) - 1) / 2) * width
        index = [n for _, n in shown]
        axes.bar(x, fit.waves[index], 0.9 * width, color=inks[fit.channel].colour, label=fit.channel)
        axes.errorbar(
            x, fit.waves[index], np.nan_to_num(fit.std[index]), fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5
        )
    axes.axhline(0, color=SOFT, lw=0.7)
    axes.set_xticks(range(len(modes)), [_mode_label(j) for j in modes], fontsize=7)
    axes.set_xlim(-0.6, len(modes) - 0.4)
    axes.grid(False, axis="x")
    axes.tick_params(axis="x", length=0)


def _mode_label(j: int) -> str:
    return f"{j}\n" + mode_name(j).replace("astigmatism", "astig.").replace(" ", "\n")


def quantile_chart(results: Results, ranges_mm: Sequence[float | None]) -> Figure:
    """Quantiles of the normalised residuals against the normal law's, and the band that 99 % of points keep to."""
    inks = channel_inks(results.channels)
    figure, axes_of = panels(len(ranges_mm), columns_for(len(ranges_mm)), 2.9, sharex=True, sharey=True)
    for axes, range_mm in zip(axes_of, ranges_mm, strict=True):
        axes.set_title(millimetres(range_mm))
        axes.axline((0, 0), slope=1, color=SOFT, lw=0.8)
        drawn = [(w, w.residuals) for w in results.at_range(range_mm) if w.residuals is not None]
        for k, (fit, residuals) in enumerate(drawn):
            normal, low, high, observed = residual_quantiles(residuals)
            if k == 0:
                axes.fill_between(normal, low, high, color=FAINT, lw=0)
            ink = inks[fit.channel]
            axes.plot(normal, observed, ink.marker, ms=2.6, mew=0, color=ink.colour, alpha=0.85, label=fit.channel)
        axes.set_xlabel("normal quantile, σ")
        axes.legend(loc="upper left", handletextpad=0.2)
    axes_of[0].set_ylabel("quantile of the residuals, σ")
    return figure


def residual_quantiles(residuals: Residuals) -> tuple[Floats, Floats, Floats, Floats]:
    """A hundred quantiles, dense in the tails: of the normal law, the 99 % band around them, and of the residuals."""
    values = residuals.normalised
    values = np.sort(values[np.isfinite(values)])
    tail = np.unique(np.geomspace(1, max((values.size + 1) // 2, 1), 50).astype(int))
    rank = np.unique(np.concatenate([tail, values.size + 1 - tail]))
    rank = rank[(rank >= 1) & (rank <= values.size)]
    after = values.size + 1 - rank
    normal = special.ndtri((rank - 0.375) / (values.size + 0.25))  # Blom's plotting positions
    low, high = (np.asarray(special.ndtri(special.betaincinv(rank, after, p)), float) for p in (0.005, 0.995))
    return normal, low, high, values[rank - 1]
