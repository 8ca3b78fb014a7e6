"""Grids of places over the frame, and numbers on them: what the best plane leaves, and MTF."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline

from labkit.field.surfaces import focus_rows, in_um
from labkit.optics.field import FieldFrame, FieldModel
from labkit.optics.mtf import Direction, mtf
from labkit.types import Floats

FOCUS_STEPS, MTF_STEPS, SMOOTH_STEPS = 24, 14, 90
"""Steps along the frame's longer side: of focus, of MTF, and of contours between them."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A rectangular grid of places over the frame.

    Parameters
    ----------
    frame : coordinates
    y_mm, x_mm : (rows,), (columns,) from the frame's centre
    """

    frame: FieldFrame
    y_mm: Floats
    x_mm: Floats

    @classmethod
    def edge_to_edge(cls, frame: FieldFrame, steps: int) -> Grid:
        """Return a grid from edge to edge, `steps` along the longer side."""
        counts = _counts(frame, steps) + 1
        y_mm, x_mm = (
            half * np.linspace(-1, 1, count)
            for half, count in zip(half_sides_mm(frame), counts, strict=True)
        )
        return cls(frame, y_mm, x_mm)

    @classmethod
    def middles(cls, frame: FieldFrame, across: int) -> Grid:
        """Return the middles of equal rectangles that cover the frame, `across` along the longer side."""
        y_mm, x_mm = (
            half * ((2 * np.arange(count) + 1) / count - 1)
            for half, count in zip(
                half_sides_mm(frame), _counts(frame, across), strict=True
            )
        )
        return cls(frame, y_mm, x_mm)

    @cached_property
    def heights_mm(self) -> Floats:
        """(rows, columns, 2) heights, y and x."""
        return np.stack(np.meshgrid(self.y_mm, self.x_mm, indexing="ij"), axis=-1)

    @property
    def each_mm(self) -> Floats:
        """(places, 2) the same in a row."""
        return self.heights_mm.reshape(-1, 2)

    @property
    def places_px(self) -> Floats:
        """(rows, columns, 2) places as row and column."""
        return self.frame.places_px(self.heights_mm)

    @property
    def each_px(self) -> Floats:
        """(places, 2) the same in a row."""
        return self.places_px.reshape(-1, 2)

    @property
    def step_mm(self) -> float:
        """Smaller of the steps between rows and between columns."""
        steps = [np.ptp(a) / (len(a) - 1) for a in (self.y_mm, self.x_mm) if len(a) > 1]
        return float(min(steps, default=self.frame.radius_mm))

    def smooth(self, values: Floats) -> tuple[Grid, Floats]:
        """Return a fine grid, and values (rows, columns) on it by splines."""
        fine = Grid.edge_to_edge(self.frame, SMOOTH_STEPS)
        degrees = [min(3, len(a) - 1) for a in (self.y_mm, self.x_mm)]
        spline = RectBivariateSpline(
            self.y_mm, self.x_mm, values, kx=degrees[0], ky=degrees[1]
        )
        return fine, np.asarray(spline(fine.y_mm, fine.x_mm))


def half_sides_mm(frame: FieldFrame) -> Floats:
    """Return (2,) half the height and half the width of a frame."""
    return np.array(frame.shape_px) / 2 * frame.pixel_pitch_um * 1e-3


def _counts(frame: FieldFrame, along: int) -> Floats:
    """Return (2,) counts of rows and columns of nearly square fields, `along` the longer side."""
    shape = np.array(frame.shape_px)
    counts = np.maximum(np.round(along * shape / shape.max()), 1)
    return np.asarray(counts.astype(int))


def after_plane_um(model: FieldModel, channel: str, grid: Grid) -> tuple[Floats, Floats]:
    """Return what the best plane leaves of the focus error (rows, columns), um, and its standard error."""
    rows = focus_rows(model, channel, grid.places_px)
    flat = rows.reshape(-1, rows.shape[-1])
    plane = np.column_stack([np.ones(len(flat)), grid.each_mm])
    left = flat - plane @ np.linalg.lstsq(plane, flat, rcond=None)[0]
    return in_um(model, left.reshape(rows.shape))


def mtf_over(
    model: FieldModel, channel: str, grid: Grid, per_mm: float, direction: Direction
) -> tuple[Floats, Floats]:
    """Return the MTF (rows, columns) of the optics at a frequency over a grid, and its standard error."""
    curves = [
        mtf(model.wavefront(channel, place), per_mm, direction, tuple(height))
        for place, height in zip(grid.each_px, grid.each_mm, strict=True)
    ]
    shape = len(grid.y_mm), len(grid.x_mm)
    values = np.array([float(curve.value) for curve in curves])
    errors = np.array([float(curve.std) for curve in curves])
    return values.reshape(shape), errors.reshape(shape)
