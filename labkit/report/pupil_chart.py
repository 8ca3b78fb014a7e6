"""The pupil as it was found, where it is no clear disc."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path

from labkit.figure_style import INK, SOFT_INK, THIRD_IN
from labkit.optics.rim import Rim

DRAWN_ARCS = 360  # of the outline as it is drawn
CLEAR = "#e9e3cf"


def pupil_chart(rim: Rim) -> Figure:
    """The clear part of the pupil, the circle of equal area dashed, and the full pupil around it; y down as on the sensor."""
    figure = Figure(figsize=(THIRD_IN, THIRD_IN))
    axes = figure.add_axes((0.03, 0.03, 0.94, 0.94))
    outlines = [
        Path(np.concatenate([e, e[:1]]), closed=True) for e in rim.edges(DRAWN_ARCS)
    ]
    axes.add_patch(PathPatch(Path.make_compound_path(*outlines), fc=CLEAR, ec=INK, lw=1.0))
    axes.add_patch(Circle((0, 0), 1.0, fill=False, ec=INK, lw=0.8, ls=(0, (4, 3))))
    axes.add_patch(Circle((0, 0), rim.outer, fill=False, ec=SOFT_INK, lw=0.6))
    side = 1.08 * max(rim.longest, rim.outer, 1.0)
    axes.set(xlim=(-side, side), ylim=(side, -side), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    axes.axis("off")
    return figure
