"""Strehl ratio and MTF through focus, all channels on one axis of ranges, with the depth of focus."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.optics.through_focus import DEPTH
from labkit.report.curves import Curves
from labkit.report.style import DASHED, HALF_IN, SOFT, SOLID, Ink, banded, chart

HEIGHT_IN = 3.2


def strehl_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """Strehl ratio of each channel against range with bands of one standard error; its depth of focus as a bar."""
    figure, axes = chart(HALF_IN, HEIGHT_IN)
    for k, each in enumerate(curves):
        ink = inks[each.channel]
        banded(axes, each.places, each.strehl.value, each.strehl.std, ink.colour)
        axes.plot([], [], color=ink.colour, label=each.channel)
        if each.depth is not None:
            ends = [each.place(end.value) for end in (each.depth.near, each.depth.far)]
            level = 0.035 + 0.035 * k
            axes.plot(ends, [level, level], color=ink.colour, lw=3, solid_capstyle="butt")
            axes.plot(
                [each.place(each.depth.highest.value)],
                [level],
                "|",
                color="white",
                ms=5,
                mew=1.2,
            )
    axes.axhline(DEPTH, color=SOFT, lw=0.5, ls=(0, (1, 3)))
    _frame(axes, curves)
    axes.set_ylabel("Strehl ratio")
    axes.legend(
        loc="upper right",
        ncols=len(curves),
        borderaxespad=0,
        handlelength=1.2,
        bbox_to_anchor=(1, 1.12),
    )
    return figure


def modulation_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """MTF of each channel at one frequency along x and y against range: where both part, the lens is astigmatic."""
    figure, axes = chart(HALF_IN, HEIGHT_IN)
    for each in curves:
        for line, curve in zip((SOLID, DASHED), each.modulation.values(), strict=True):
            banded(
                axes, each.places, curve.value, curve.std, inks[each.channel].colour, line
            )
    _frame(axes, curves)
    axes.set_ylabel(f"MTF at {curves[0].through_per_mm:.3g} cycles/mm")
    keys = [
        Line2D([], [], color=SOFT, ls=line, label=label)
        for line, label in ((SOLID, "x"), (DASHED, "y"))
    ]
    axes.legend(
        handles=keys,
        loc="upper right",
        ncols=2,
        borderaxespad=0,
        handlelength=2.2,
        bbox_to_anchor=(1, 1.12),
    )
    return figure


def _frame(axes: Axes, curves: Sequence[Curves]) -> None:
    places = np.concatenate([each.places for each in curves])
    label = (
        "range of the target, mm"
        if curves[0].in_ranges
        else "shift of the sensor from best focus, µm"
    )
    axes.set(xlim=(places.min(), places.max()), ylim=(0, 1.0), xlabel=label)
