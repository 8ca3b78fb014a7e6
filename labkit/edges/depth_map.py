"""Ranges of a scene's edges, drawn over the photograph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from labkit.edges.found_edges import Box
from labkit.edges.outcome import EdgesOutcome, MeasuredEdge
from labkit.figure_style import INK, SOFT_INK, WIDTH_IN
from labkit.types import Floats

MAP = "viridis"  # in order of lightness too: for colour-blind readers, and in print
MOST_LABELS = 24
WIDE_PT, RIM_PT = 4.0, 6.5


def draw_depth_map(grey: Floats, outcome: EdgesOutcome) -> Figure:
    """Draw each edge in the colour of its range over the grey picture; without ranges, in that of its defocus.

    grey: (rows, columns) about 0 to 1, of the raw's pixels. Rejected boxes are drawn dashed.
    """
    rows, columns = grey.shape
    figure = Figure(
        figsize=(WIDTH_IN, WIDTH_IN * 0.86 * rows / columns + 1.1), layout="constrained"
    )
    axes = figure.subplots()
    axes.imshow(
        np.sqrt(np.clip(grey, 0, 1)),
        cmap="gray",
        vmin=-0.1,
        vmax=1.3,
        interpolation="nearest",
    )
    axes.grid(False)
    axes.set(
        xlabel="column, px",
        ylabel="row, px",
        xlim=(-0.5, columns - 0.5),
        ylim=(rows - 0.5, -0.5),
    )
    values, label = _values(outcome.edges)
    lines = [edge.line[:, ::-1] for edge in outcome.edges]
    axes.add_collection(
        LineCollection(lines, colors="white", linewidths=RIM_PT, capstyle="round")
    )
    drawn = LineCollection(lines, cmap=MAP, linewidths=WIDE_PT, capstyle="round")
    drawn.set_array(values)
    axes.add_collection(drawn)
    if len(outcome.edges):
        figure.colorbar(drawn, ax=axes, label=label, shrink=0.85, pad=0.01)
    for edge, words in zip(
        outcome.edges[:MOST_LABELS], _labels(outcome.edges, label), strict=False
    ):
        row, column = edge.line.mean(axis=0)
        box = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
        axes.annotate(
            words,
            (column, row),
            (6, 6),
            textcoords="offset points",
            fontsize=6.5,
            color=INK,
            bbox=box,
        )
    for of in outcome.rejected:
        axes.plot(*_outline(of.box), color=SOFT_INK, linestyle=(0, (3, 2)), linewidth=0.8)
    axes.set_title(f"{len(outcome.edges)} edges, {len(outcome.rejected)} rejected")
    return figure


def _values(edges: Sequence[MeasuredEdge]) -> tuple[Floats, str]:
    ranges = np.array([edge.range_mm.value for edge in edges])
    if np.isfinite(ranges).any():
        return ranges, "range, mm"
    return np.array(
        [abs(edge.main.defocus.value) for edge in edges]
    ), "defocus, waves RMS, either sign"


def _labels(edges: Sequence[MeasuredEdge], label: str) -> list[str]:
    if label.startswith("range"):
        return [_words(edge) for edge in edges]
    return [f"{abs(e.main.defocus.value):.2f} ± {e.main.defocus.std:.2f}" for e in edges]


def _words(edge: MeasuredEdge) -> str:
    """Return the range, and the other range if there is one."""
    if not np.isfinite(edge.range_mm.value):
        return ""
    other = (
        "" if edge.other is None else f"\nor {edge.other.value:.0f} ± {edge.other.std:.0f}"
    )
    return f"{edge.range_mm.value:.0f} ± {edge.range_mm.std:.0f}{other}"


def _outline(box: Box) -> tuple[list[float], list[float]]:
    """Return columns and rows around a box."""
    r0, c0, r1, c1 = (x - 0.5 for x in box)
    return [c0, c1, c1, c0, c0], [r0, r0, r1, r1, r0]
