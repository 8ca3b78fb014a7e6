"""An edge and the pixels around it: geometry, the mean that a camera records of it, and its slopes (thesis 5.1-5.27)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from labkit.arrays import real_array
from labkit.edges.spread import edge_spread
from labkit.imaging.optics import Optics
from labkit.types import Bools, Floats

LEAST_REGION_PIXELS = 60  # of a region: an edge and its noise are six numbers


class Edge(NamedTuple):
    """A straight line between two even sides, as the four numbers of its estimate. Thesis (5.1).

    Attributes
    ----------
    angle : of the normal, radians from x (right) towards y (down)
    distance_px : of the line from the region's centre, along the normal
    near, far : radiance before and beyond the line along the normal, counts
    """

    angle: float
    distance_px: float
    near: float
    far: float

    @property
    def rise(self) -> float:
        """Step along the normal, counts."""
        return self.far - self.near

    @property
    def towards_light(self) -> Edge:
        """The same line with its normal pointing to the brighter side."""
        if self.rise >= 0:
            return self._replace(angle=within_a_turn(self.angle))
        angle = within_a_turn(self.angle + np.pi)
        return Edge(angle, -self.distance_px, self.far, self.near)


def within_a_turn(angle: float) -> float:
    """Return an angle, radians, between -pi and pi."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def turned(angle: float, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return coordinates along a normal at an angle (radians, from x towards y), and along its line."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return x * cosine + y * sine, y * cosine - x * sine


@dataclass(frozen=True)
class Region:
    """Pixels of a colour around an edge in a frame.

    Attributes
    ----------
    rows, columns : (n,) in the raw, pixel centres at integers
    counts : (n,) above black
    centre : (row, column) that distances are counted from
    frame, depth, light : places of its noise, its defocus and its colour among those of a problem

    Raises
    ------
    ValueError : arrays of different sizes, or too few pixels
    """

    rows: Floats
    columns: Floats
    counts: Floats
    centre: tuple[float, float]
    frame: int = 0
    depth: int = 0
    light: int = 0

    def __post_init__(self) -> None:
        size = np.size(self.rows)
        for name, unit in (("rows", "pixels"), ("columns", "pixels"), ("counts", "counts")):
            array = real_array(name, getattr(self, name), (size,), unit)
            object.__setattr__(self, name, array)
        if size < LEAST_REGION_PIXELS:
            raise ValueError(
                f"{size} pixels around an edge: {LEAST_REGION_PIXELS} are needed at least"
            )

    @property
    def offsets(self) -> tuple[Floats, Floats]:
        """(n,) x and y from the centre, pixels."""
        return self.columns - self.centre[1], self.rows - self.centre[0]

    def across_and_along(self, edge: Edge) -> tuple[Floats, Floats]:
        """Return distances (n,) beyond the line along its normal, and along the line, pixels: r and t of thesis (5.1)."""
        across, along = turned(edge.angle, *self.offsets)
        return across - edge.distance_px, along

    def part(self, chosen: Bools) -> Region:
        """Return some of the pixels. chosen: (n,) mask. Raises ValueError for too few."""
        arrays = (self.rows, self.columns, self.counts)
        rows, columns, counts = (array[chosen] for array in arrays)
        return replace(self, rows=rows, columns=columns, counts=counts)


def mean_and_slopes(
    region: Region, edge: Edge, optics: Optics, waves: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return mean counts (n,), their slopes (4, n) by angle, distance, near and far, and (modes, n) per wave RMS.

    Thesis (5.12), (5.16), (5.20), (5.25)-(5.27).
    """
    across, along = region.across_and_along(edge)
    pitch_um = optics.pitch_um
    reach_um = float(np.abs(across).max()) * pitch_um + pitch_um
    rows = edge_spread(optics, waves, edge.angle, reach_um).read(across * pitch_um)
    step, line, *by_waves, turning = rows
    line = edge.rise * line * pitch_um
    by_edge = np.stack([along * line + edge.rise * turning, -line, 1 - step, step])
    return edge.near + edge.rise * step, by_edge, edge.rise * np.stack(by_waves)
