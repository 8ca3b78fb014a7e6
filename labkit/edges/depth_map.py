"""Ranges of a scene's edges, drawn over the photograph."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from labkit.edges.found_edges import Box
from labkit.edges.outcome import Backdrop, EdgesOutcome
from labkit.figure_style import INK, SOFT_INK, WIDTH_IN
from labkit.types import Floats
from labkit.uncertain import Uncertain

MAP = "viridis"  # in order of lightness too: for colour-blind readers, and in print
MOST_LABELS = 24
WIDE_PT, RIM_PT = 4.0, 6.5
LABEL_BOX = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}


def draw_depth_map(backdrop: Backdrop, outcome: EdgesOutcome) -> Figure:
    """Draw each edge in the colour of its range over the photograph; without ranges, of its defocus.

    Rejected boxes are drawn dashed.
    """
    size = (WIDTH_IN, WIDTH_IN * 0.86 * backdrop.tallness + 1.1)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    axes.imshow(
        np.sqrt(backdrop.grey.clip(0, 1)),
        cmap="gray",
        vmin=-0.1,
        vmax=1.3,
        interpolation="nearest",
        extent=backdrop.extent_px,
    )
    axes.grid(False)
    axes.set(xlabel="column, px", ylabel="row, px")
    edges = outcome.edges
    numbers = [(edge.range_mm, edge.other) for edge in edges]
    label, digits = "range, mm", 0
    if not any(np.isfinite(own.value) for own, _ in numbers):
        numbers = [(edge.main.defocus, None) for edge in edges]
        numbers = [(Uncertain(abs(own.value), own.std), None) for own, _ in numbers]
        label, digits = "defocus, waves RMS, either sign", 2
    lines = [edge.line[:, ::-1] for edge in edges]
    rim = LineCollection(lines, colors="white", linewidths=RIM_PT, capstyle="round")
    drawn = LineCollection(lines, cmap=MAP, linewidths=WIDE_PT, capstyle="round")
    drawn.set_array(np.array([own.value for own, _ in numbers]))
    boxes = [_outline(of.box) for of in outcome.rejected]
    dashed = LineCollection(
        boxes, colors=SOFT_INK, linestyles=[(0, (3, 2))], linewidths=0.8
    )
    for collection in (rim, drawn, dashed):
        axes.add_collection(collection, autolim=False)
    if edges:
        figure.colorbar(drawn, ax=axes, label=label, shrink=0.85, pad=0.01)
    for line, each in list(zip(lines, numbers, strict=True))[:MOST_LABELS]:
        words = [
            f"{of.value:.{digits}f} ± {of.std:.{digits}f}"
            for of in each
            if of is not None and np.isfinite(of.value)
        ]
        axes.annotate(
            "\nor ".join(words),
            line.mean(axis=0),
            (6, 6),
            textcoords="offset points",
            fontsize=6.5,
            color=INK,
            bbox=LABEL_BOX,
        )
    axes.set_title(f"{len(edges)} edges, {len(outcome.rejected)} rejected")
    return figure


def _outline(box: Box) -> Floats:
    """Return the corners (5, 2) of a box, column and row, back to the first."""
    r0, c0, r1, c1 = (x - 0.5 for x in box)
    return np.array([(c0, r0), (c1, r0), (c1, r1), (c0, r1), (c0, r0)])
