"""Strehl ratio and MTF through focus, all channels on one axis of ranges, with the depth of focus."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.figure_style import DASHED, HALF_IN, POINT, SOFT_INK, SOLID, Ink, banded, chart
from labkit.optics.through_focus import DEPTH
from labkit.report.curves import CURVE_STEPS, Curves

THROUGH_CHART_IN = 3.2
MARK_EVERY = CURVE_STEPS // 5  # points of a curve to a marker, staggered between channels


def strehl_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """Strehl ratio of each channel against range with bands of one standard error; its depth of focus as a bar."""
    figure, axes = chart(HALF_IN, THROUGH_CHART_IN)
    for k, each in enumerate(curves):
        ink, strehl = inks[each.channel], each.strehl
        marks = _marks(k, len(curves), ink)
        banded(axes, each.places, strehl.value, strehl.std, ink.colour, **marks)
        if each.depth is not None:
            ends = [each.place(end.value) for end in (each.depth.near, each.depth.far)]
            level = 0.035 + 0.04 * k
            axes.plot(ends, [level, level], color=ink.colour, lw=3, solid_capstyle="butt")
            highest = each.place(each.depth.highest.value)
            axes.plot([highest], [level], ink.marker, color=ink.colour, **POINT)
    axes.axhline(DEPTH, color=SOFT_INK, lw=0.5, ls=(0, (1, 3)))
    _frame(axes, curves)
    axes.set_ylabel("Strehl ratio")
    _legend(axes, _channel_keys(curves, inks))
    return figure


def modulation_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """MTF of each channel at one frequency along x and y against range: where both part, the lens is astigmatic."""
    figure, axes = chart(HALF_IN, THROUGH_CHART_IN)
    for k, each in enumerate(curves):
        ink, marks = inks[each.channel], _marks(k, len(curves), inks[each.channel])
        for line, curve in zip((SOLID, DASHED), each.modulation.values(), strict=True):
            banded(axes, each.places, curve.value, curve.std, ink.colour, line, **marks)
    _frame(axes, curves)
    axes.set_ylabel(f"MTF at {curves[0].through_per_mm:.3g} cycles/mm")
    directions = [
        Line2D([], [], color=SOFT_INK, ls=line, label=label)
        for line, label in ((SOLID, "x"), (DASHED, "y"))
    ]
    _legend(axes, [*_channel_keys(curves, inks), *directions])
    return figure


def _marks(k: int, channels: int, ink: Ink) -> dict[str, Any]:
    """Return the markers of channel k, at other points than those of the other channels."""
    first = round((k + 0.5) * MARK_EVERY / channels)
    return {"marker": ink.marker, "markevery": (first, MARK_EVERY), **POINT}


def _channel_keys(curves: Sequence[Curves], inks: dict[str, Ink]) -> list[Line2D]:
    return [
        Line2D([], [], color=ink.colour, marker=ink.marker, label=each.channel, **POINT)
        for each in curves
        for ink in [inks[each.channel]]
    ]


def _legend(axes: Axes, keys: Sequence[Line2D]) -> None:
    """Put the keys in one line above the axes."""
    axes.legend(
        handles=keys,
        loc="lower right",
        ncols=len(keys),
        borderaxespad=0,
        handlelength=2.2,
        columnspacing=1.2,
        bbox_to_anchor=(1, 1.01),
    )


def _frame(axes: Axes, curves: Sequence[Curves]) -> None:
    places = np.concatenate([each.places for each in curves])
    label = (
        "range of the target, mm"
        if curves[0].in_ranges
        else "shift of the sensor from best focus, µm"
    )
    axes.set(xlim=(places.min(), places.max()), ylim=(0, 1.0), xlabel=label)
