"""Maps over the frame: a number at every place, with labelled contours."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, isfinite, radians, sin
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Wedge
from matplotlib.ticker import MaxNLocator

from labkit.figure_style import INK, SOFT_INK, THIRD_IN
from labkit.optics.field import FieldFrame
from labkit.report.field.sampled import Grid, half_sides_mm
from labkit.types import Floats
from labkit.uncertain import Uncertain

DIVERGING = LinearSegmentedColormap.from_list(
    "signed", ["#2b6ca3", "#9dc3de", "#ffffff", "#f2b48a", "#b8541a"]
)
"""Blue below zero, orange above: colour-blind readers can tell them apart, and ink can be read on both."""

SEQUENTIAL = LinearSegmentedColormap.from_list("sizes", ["#ffffff", "#a9c7b9", "#4d9078"])
MOST_CONTOURS = 11
MAP_DECIMALS = 9
"""Of a map's values, in its unit: beyond is rounding, whose contours would look like the lens's."""

TILT_ARROW = 0.7
"""Of an arrow, in halves of the frame's shorter side."""


def frame_axes(
    frame: FieldFrame,
    width_in: float = THIRD_IN,
    *,
    title: str = "",
    below_in: float = 0.42,
    labelled: bool = True,
) -> tuple[Figure, Axes]:
    """Return a figure with the frame in millimetres, y down.

    below_in: room below the frame; labelled: whether the axes have numbers
    """
    rows, columns = frame.shape_px
    left_in = 0.48 if labelled else 0.06
    top_in = 0.28 if title else 0.08
    side_in = width_in - left_in - 0.1
    frame_in = side_in * rows / columns
    height_in = frame_in + below_in + top_in
    figure = Figure(figsize=(width_in, height_in))
    box = (
        left_in / width_in,
        below_in / height_in,
        side_in / width_in,
        frame_in / height_in,
    )
    axes = figure.add_axes(box)
    half = half_sides_mm(frame)
    axes.set(xlim=(-half[1], half[1]), ylim=(half[0], -half[0]), aspect="equal")
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set(visible=True)
    if labelled:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axes.set_xlabel("x, mm", labelpad=1)
        axes.set_ylabel("y, mm", labelpad=1)
    else:
        axes.set(xticks=[], yticks=[])
    if title:
        figure.text(
            0.02, 1 - 0.13 / height_in, title, fontweight="bold", fontsize=9, va="center"
        )
    return figure, axes


def even_levels(low: float, high: float, most: int = MOST_CONTOURS) -> Floats:
    """Return round levels that cover an interval."""
    if not high - low > 10.0**-MAP_DECIMALS:
        low, high = low - 0.5, high + 0.5
    ticks = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
    first = int(np.searchsorted(ticks, low, "right")) - 1
    last = int(np.searchsorted(ticks, high, "left"))
    return np.asarray(ticks[max(first, 0) : last + 1])


def covering(values: Sequence[Floats]) -> Floats:
    """Return round levels that cover all values."""
    return even_levels(
        min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    )


def map_chart(
    grid: Grid,
    value: Floats,
    title: str,
    unit: str,
    levels: Floats,
    *,
    signed: bool = True,
    tiles_mm: Floats | None = None,
    towards: Uncertain | None = None,
    width_in: float = THIRD_IN,
) -> Figure:
    """Draw a number (rows, columns) over the frame, in steps of colour with labelled contours.

    signed: whether zero has a meaning, and is white; tiles_mm: (n, 2) y and x of the tiles that
    the model rests on, drawn as dots; towards: a direction, degrees from right towards down
    """
    figure, axes = frame_axes(grid.frame, width_in, title=title, below_in=0.86)
    most = float(np.abs(levels).max())
    colours: dict[str, Any] = (
        {"cmap": DIVERGING, "vmin": -most, "vmax": most} if signed else {"cmap": SEQUENTIAL}
    )
    fine, smooth = grid.smooth(np.round(value, MAP_DECIMALS))
    at = fine.x_mm, fine.y_mm, smooth.clip(levels[0], levels[-1])
    filled = axes.contourf(*at, levels=levels, **colours)
    lines = axes.contour(*at, levels=levels[1:-1], colors=INK, linewidths=0.5)
    axes.clabel(lines, fontsize=6.5, fmt=lambda level: f"{level:g}")
    if tiles_mm is not None:
        axes.plot(tiles_mm[:, 1], tiles_mm[:, 0], **dots(len(tiles_mm)))
    if towards is not None and isfinite(towards.value):
        _direction(axes, towards, TILT_ARROW * min(half_sides_mm(grid.frame)))
    scale = colour_bar(figure, filled, unit)
    scale.xaxis.set_major_locator(MaxNLocator(5))
    return figure


def _direction(axes: Axes, towards: Uncertain, length_mm: float) -> None:
    """Draw an arrow from the centre, in a wedge of one standard error to either side."""
    ends = towards.value - towards.std, towards.value + towards.std
    wedge = Wedge((0, 0), length_mm, *ends, color=INK, alpha=0.25, lw=0)
    axes.add_patch(wedge)
    turn = radians(towards.value)
    tip = (length_mm * cos(turn), length_mm * sin(turn))
    style = {"arrowstyle": "-|>", "color": INK, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, (0, 0), arrowprops=style)


def dots(count: int) -> dict[str, Any]:
    """Return how tiles are marked, smaller where there are many."""
    return {
        "ls": "none",
        "marker": "o",
        "ms": 3.0 if count <= 60 else 1.1,
        "mfc": "none" if count <= 60 else SOFT_INK,
        "mec": INK if count <= 60 else SOFT_INK,
        "mew": 0.9 if count <= 60 else 0,
    }


def colour_bar(figure: Figure, shown: Any, unit: str, width: float = 0.6) -> Axes:
    """Draw the scale of a map below it, and return its axes. width: of the figure's."""
    height_in = figure.get_size_inches()[1]
    at = (0.16, 0.3 / height_in, width, 0.08 / height_in)
    bar = figure.colorbar(shown, cax=figure.add_axes(at), orientation="horizontal")
    bar.ax.tick_params(labelsize=7, pad=1, length=2)
    bar.ax.text(1.05, 0.5, unit, va="center", fontsize=7.5, transform=bar.ax.transAxes)
    bar.ax.grid(False)
    return bar.ax
