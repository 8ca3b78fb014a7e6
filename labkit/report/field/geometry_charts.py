"""Where the lens puts the image: the distorted grid, and lateral colour, with errors and the factor they are drawn at."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from labkit.field.geometry import FieldGeometry
from labkit.figure_style import DASHED, HALF_IN, INK, SOFT_INK, Ink, round_length
from labkit.report.field.maps import frame_axes
from labkit.report.field.sampled import Grid
from labkit.report.field.shapes import LONGEST_ARROW, arrows, bar, ellipses
from labkit.types import Floats

GRID_LINES, FINE_STEPS = 8, 5
"""Rectangles of the grid along the frame's longer side, and steps along each side of a rectangle."""

LATERAL_ACROSS = 7


def distortion_factor(geometry: FieldGeometry) -> float:
    """Return the round factor at which the largest distortion is a visible part of a rectangle."""
    grid = Grid.edge_to_edge(geometry.model.frame, GRID_LINES)
    moved = np.hypot(*_shifts_mm(geometry, grid.each_px)[0].T).max()
    return max(round_length(LONGEST_ARROW * grid.step_mm / moved), 1.0) if moved else 1.0


def distortion_chart(geometry: FieldGeometry, ink: Ink, factor: float) -> Figure:
    """Draw a rectangular grid as the lens images it, its distortion enlarged, and ellipses of one standard error at nodes."""
    frame = geometry.model.frame
    title = f"distortion, {factor:g} times enlarged"
    figure, axes = frame_axes(frame, HALF_IN, title=title)
    nodes = Grid.edge_to_edge(frame, GRID_LINES)
    fine = Grid(frame, _finer(nodes.y_mm), _finer(nodes.x_mm))
    shifts, _ = _shifts_mm(geometry, fine.each_px)
    moved = fine.heights_mm + factor * shifts.reshape(fine.heights_mm.shape)
    _grid_lines(axes, fine.heights_mm, SOFT_INK, 0.6, DASHED)
    _grid_lines(axes, moved, ink.colour, 1.2, "-")
    away, covariance = _shifts_mm(geometry, nodes.each_px)
    rings = factor * ellipses(covariance)
    centres = (nodes.each_mm + factor * away)[:, np.newaxis]
    axes.add_collection(
        LineCollection(list((centres + rings)[..., ::-1]), colors=INK, linewidths=0.7)
    )
    return figure


def _finer(places: Floats) -> Floats:
    """Return places (n,) in equal steps with others between them."""
    return np.linspace(places[0], places[-1], FINE_STEPS * (len(places) - 1) + 1)


def _grid_lines(
    axes: Axes, places_mm: Floats, colour: str, width: float, line: Any
) -> None:
    """Draw every `FINE_STEPS`th row and column of places (rows, columns, 2)."""
    rows = list(places_mm[::FINE_STEPS, :, ::-1])
    columns = list(places_mm[:, ::FINE_STEPS, ::-1].swapaxes(0, 1))
    for lines in (rows, columns):
        drawn = LineCollection(lines, colors=colour, linewidths=width, linestyles=line)
        axes.add_collection(drawn)


def _shifts_mm(geometry: FieldGeometry, places_px: Floats) -> tuple[Floats, Floats]:
    """Return the distortion (n, 2) at places, mm, and covariances (n, 2, 2)."""
    pitch_mm = 1e-3 * geometry.model.frame.pixel_pitch_um
    shift, covariance = geometry.distortion_px(places_px)
    return pitch_mm * shift, pitch_mm**2 * covariance


def lateral_over(geometry: FieldGeometry, channel: str) -> tuple[Grid, Floats, Floats]:
    """Return places over the frame, lateral colour (n, 2) there, um, down and right, and covariances (n, 2, 2)."""
    grid = Grid.middles(geometry.model.frame, LATERAL_ACROSS)
    shift, covariance = geometry.lateral_px(channel, grid.each_px)
    pitch_um = geometry.model.frame.pixel_pitch_um
    return grid, pitch_um * shift, pitch_um**2 * covariance


def longest_um(geometry: FieldGeometry) -> float:
    """Return the largest lateral colour over the frame of all channels."""
    every = [lateral_over(geometry, c)[1] for c in geometry.model.channels[1:]]
    return float(np.hypot(*np.concatenate(every).T).max()) if every else 0.0


def lateral_chart(
    geometry: FieldGeometry, channel: str, ink: Ink, longest: float
) -> Figure:
    """Draw the place of a channel's image less that of the reference as arrows, with ellipses of one standard error.

    longest: of all channels' arrows, um
    """
    grid, shift, covariance = lateral_over(geometry, channel)
    reference = geometry.model.channels[0]
    title = f"{channel}  lateral colour against {reference}"
    figure, axes = frame_axes(grid.frame, HALF_IN, title=title, below_in=0.62)
    mm_per_um = LONGEST_ARROW * grid.step_mm / (longest or 1.0)
    shifts = mm_per_um * shift[:, ::-1]
    rings = mm_per_um * ellipses(covariance)[..., ::-1]
    arrows(axes, grid.each_mm[:, ::-1], shifts, rings, ink.colour)
    length_um = round_length(longest)
    pixels = length_um / grid.frame.pixel_pitch_um
    bar(figure, axes, length_um * mm_per_um, f"{length_um:g} µm, {pixels:.2g} pixels")
    return figure
