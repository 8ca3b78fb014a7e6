"""Charts of focus: defocus against range with residuals, and encircled energy at best focus."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labkit.figure_style import (
    DOTTED,
    HALF_IN,
    INK,
    POINT,
    SOFT_INK,
    Ink,
    banded,
    channel_inks,
    chart,
    scaling,
)
from labkit.report.curves import Curves
from labkit.report.table import estimated, plus_minus
from labkit.results import Focus, Results, Wavefront
from labkit.results.best_focus import SHARE
from labkit.types import Floats

Curve = Callable[[str, Floats], Floats]  # channel, ranges in mm -> waves RMS
FOCUS_CHART_IN, LEGEND_IN = 3.0, 0.18
"""Of a chart without its legend, and of a line of the legend above it."""


def defocus_chart(
    results: Results, focus: Focus | None, curve: Curve, shortest_mm: float
) -> Figure:
    """Defocus against range with the fitted curves and best focus.

    curve: the fitted defocus of a channel at ranges; shortest_mm: where it may be drawn from.
    """
    inks = channel_inks(results.channels)
    figure, axes = _focus_axes(results, right=0.55)
    bounds = _range_bounds(results, focus, shortest_mm)
    axes.axhline(0, color=SOFT_INK, lw=0.7)
    for channel in results.channels:
        fits = _with_range(results, channel)
        ink = inks[channel]
        label = channel
        if focus and channel in focus.best_focus_mm:
            best = focus.best_focus_mm[channel]
            label += f"   {plus_minus(best.value, best.std)} mm"
            grid = np.linspace(*bounds, 100)
            axes.plot(grid, curve(channel, grid), color=ink.colour, lw=1.2)
            _mark_focus(axes, best.value, best.std, ink)
        x = np.array([w.measured_range_mm for w in fits], float)
        y = np.array([w.defocus.value for w in fits if w.defocus])
        _points(
            axes, x, y, np.array([w.defocus.std for w in fits if w.defocus]), ink, label
        )
    axes.set(xlim=bounds, xlabel="range of the target, mm")
    axes.set_ylabel(f"defocus, waves RMS at {results.reference_wavelength_nm:g} nm")
    _legend_above(axes)
    _blur_axis(axes, results)
    return figure


def residual_chart(results: Results, focus: Focus, shortest_mm: float) -> Figure:
    """Return the defocus residuals of the focus fit against range, in thousandths of a wave."""
    inks = channel_inks(results.channels)
    figure, axes = _focus_axes(results)
    bounds = _range_bounds(results, focus, shortest_mm)
    for k, channel in enumerate(results.channels):
        fits = _with_range(results, channel)
        rest = focus.residuals(channel)
        if len(rest) != len(fits):
            continue
        dodge = (k - (len(results.channels) - 1) / 2) * 0.008 * (bounds[1] - bounds[0])
        x = np.array([w.measured_range_mm for w in fits], float) + dodge
        waves = np.array([each.value for each in rest])
        std = np.array([each.std for each in rest])
        _points(axes, x, 1e3 * waves, 1e3 * std, inks[channel], channel)
    axes.axhline(0, color=SOFT_INK, lw=0.7)
    axes.margins(y=0.25)
    axes.set(
        xlim=bounds,
        xlabel="range of the target, mm",
        ylabel="defocus residual, milliwaves",
    )
    _legend_above(axes)
    return figure


def _focus_axes(results: Results, right: float = 0.12) -> tuple[Figure, Axes]:
    """Return axes with room above for a line of legend for each channel."""
    above = LEGEND_IN * len(results.channels) + 0.1
    return chart(HALF_IN, FOCUS_CHART_IN + above, left=0.72, right=right, top=above)


def _legend_above(axes: Axes) -> None:
    """Put the legend above the axes, where no line crosses it."""
    handles, _ = axes.get_legend_handles_labels()
    if not handles:  # residuals are kept of none of these fits
        return
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1),
        borderaxespad=0,
        labelspacing=0.25,
        handletextpad=0.2,
    )


def _with_range(results: Results, channel: str) -> list[Wavefront]:
    return [
        w
        for w in results.of_channel(channel)
        if w.defocus and w.measured_range_mm is not None
    ]


def _blur_axis(axes: Axes, results: Results) -> None:
    """Defocus as blur on the right; the channels' cones differ by less than a line is wide."""
    ratios = [
        w.blur.value / w.defocus.value
        for w in results
        if w.blur and w.defocus and w.defocus.value
    ]
    if ratios:
        blur = axes.secondary_yaxis("right", functions=scaling(float(np.median(ratios))))
        blur.set_ylabel("blur on the sensor, µm")


def _range_bounds(
    results: Results, focus: Focus | None, shortest_mm: float
) -> tuple[float, float]:
    ranges = [w.measured_range_mm for w in results if w.measured_range_mm is not None]
    ranges += (
        [best.value for best in focus.best_focus_mm.values() if np.isfinite(best.value)]
        if focus
        else []
    )
    low, high = min(ranges), max(ranges)
    margin = 0.06 * (high - low) or 0.01 * high
    return max(low - margin, shortest_mm), high + margin


def _points(
    axes: Axes, x: Floats, y: Floats, error: Floats, ink: Ink, label: str | None
) -> None:
    axes.errorbar(
        x, y, np.nan_to_num(error), fmt="none", ecolor=ink.colour, elinewidth=1.2, capsize=2
    )
    axes.plot(x, y, ink.marker, color=ink.colour, label=label, **POINT)


def _mark_focus(axes: Axes, value_mm: float, std_mm: float, ink: Ink) -> None:
    axes.axvline(value_mm, color=ink.colour, lw=0.8, ls=(0, (4, 3)))
    if np.isfinite(std_mm):
        axes.axvspan(
            value_mm - std_mm, value_mm + std_mm, color=ink.colour, alpha=0.25, lw=0
        )
    axes.plot([value_mm], [0], marker="|", ms=12, mew=1.6, color=ink.colour)


def energy_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """Encircled energy of each channel at best focus with error bands, beside a perfect lens's."""
    figure, axes = chart(HALF_IN, 3.2, top=0.12)
    for each in curves:
        ink = inks[each.channel]
        at = each.focus.best.energy_radius()
        energy = each.energy
        banded(axes, energy.radius_um, energy.value, energy.std, ink.colour)
        axes.plot(
            energy.radius_um, each.perfect_energy, color=ink.colour, lw=0.8, ls=DOTTED
        )
        label = f"{each.channel}: {100 * SHARE:.0f} % within {estimated(at)} µm"
        axes.plot(
            [at.value],
            [SHARE],
            ink.marker,
            color=ink.colour,
            label=label,
            **POINT,
        )
    axes.plot([], [], color=INK, lw=0.8, ls=DOTTED, label="diffraction limit")
    axes.axhline(SHARE, color=SOFT_INK, lw=0.5, ls=(0, (1, 3)))
    last = curves[0].energy.radius_um[-1]
    axes.set(
        xlim=(0, last),
        ylim=(0, 1.0),
        xlabel="radius on the sensor, µm",
        ylabel="encircled energy",
    )
    axes.legend(loc="lower right")
    return figure
