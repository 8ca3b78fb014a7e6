"""Places of tiles: their corners on the target, and in the photographs as the fits estimated them.

A fit gives each tile a plane homography. A lens that distorts bends the tile, so that the
corners of the fit are those of the homography nearest to the bent tile, not the bent corners.

Of a fit's eight numbers six are used: the place of the tile's middle, and the linear map about
the middle. A tile's own convergence is left out: beside the tiles' places and sizes it tells
next to nothing about the target's tilt, and blur that changes over a tile passes for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss

from labkit.arrays import positive, real_array, symmetric
from labkit.key import Key, Tile
from labkit.results import Wavefront
from labkit.types import Floats

CORNERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
"""(y, x) of a tile's corners in halves of its sides, in the order of `Placement.corners_px`."""

NODES = 3
"""Points along each side of a tile: they integrate the square of a cubic displacement exactly."""


@dataclass(frozen=True, slots=True)
class TileGrid:
    """The tiles of a target, all equal.

    Parameters
    ----------
    shape : (rows, columns) of tiles
    pitch_mm : distance of neighbours' centres along rows and columns
    size_mm : (height, width) of a tile

    Raises
    ------
    ValueError : no tiles, or sizes that are not above 0
    """

    shape: tuple[int, int]
    pitch_mm: float
    size_mm: tuple[float, float]

    def __post_init__(self) -> None:
        if min(self.shape) < 1:
            raise ValueError(
                f"grid {self.shape}: at least one row and one column is needed"
            )
        positive("pitch_mm", self.pitch_mm, "mm")
        for side in self.size_mm:
            positive("size_mm", side, "mm")

    @property
    def whole_mm(self) -> tuple[float, float]:
        """(height, width) of all tiles together."""
        height, width = (
            (count - 1) * self.pitch_mm + side
            for count, side in zip(self.shape, self.size_mm, strict=True)
        )
        return height, width

    def places_mm(self, tile: tuple[int, int], within: Floats) -> Floats:
        """Return (n, 2) mm from the grid's centre, y down and x right, of places (n, 2) in halves of a tile's sides."""
        centre = (np.array(tile) - (np.array(self.shape) - 1) / 2) * self.pitch_mm
        return np.asarray(centre + within * np.array(self.size_mm) / 2)


@dataclass(frozen=True, slots=True)
class PartsOfTarget:
    """Tiles anywhere on one target.

    Attributes
    ----------
    whole_mm : (height, width) of the target
    ends : first and last row, and first and last column, of each tile on the target, (2, 2), -1 to 1
    """

    whole_mm: tuple[float, float]
    ends: Mapping[Tile, Floats]

    def places_mm(self, tile: Tile, within: Floats) -> Floats:
        """Return (n, 2) mm from the target's centre, y down and x right, of places (n, 2) in halves of a tile's sides."""
        first, last = self.ends[tile].T
        on_target = (first + last + within * (last - first)) / 2
        return np.asarray(on_target * np.array(self.whole_mm) / 2)


@dataclass(frozen=True, eq=False)
class TilePlace:
    """The place of one tile in the photographs of one range and channel.

    Parameters
    ----------
    key : range, channel, and tile
    corners_px : (4, 2) [row, column] of the fit's corners (0, 0), (0, w), (h, w), (h, 0)
    covariance_px2 : (8, 8) of `corners_px.ravel()`; None: as of equal information everywhere on the tile, up to a
        factor

    Raises
    ------
    ValueError : a key without a tile, or arrays of other shapes
    """

    key: Key
    corners_px: Floats
    covariance_px2: Floats | None = None

    def __post_init__(self) -> None:
        if self.key.tile is None:
            raise ValueError(f"{self.key.label}: a tile (row, column) is needed")
        real_array("corners_px", self.corners_px, (4, 2), "px")
        if self.covariance_px2 is not None:
            symmetric("covariance_px2", self.covariance_px2, 8, "px squared")

    @property
    def tile(self) -> tuple[int, int]:
        """(row, column) of the tile."""
        assert self.key.tile is not None
        return self.key.tile


def tile_places(wavefronts: Iterable[Wavefront]) -> tuple[TilePlace, ...]:
    """Return the place of every wavefront of a tile, as a mean over its photographs."""
    return tuple(
        TilePlace(w.key, w.placement.corners_px.mean(axis=0))
        for w in wavefronts
        if w.tile is not None and w.placement is not None
    )


@cache
def nodes() -> Floats:
    """Return (n, 2) places within a tile, in halves of its sides, at which its displacement is sampled."""
    at, _ = leggauss(NODES)
    return np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)


@cache
def corners_by_nodes() -> Floats:
    """Return (8, 2 n): displacements of the fit's corners by displacements of the nodes, equal information everywhere."""
    _, weight = leggauss(NODES)
    weights = np.repeat(np.outer(weight, weight).ravel(), 2)[:, None]
    inside = _homographies(nodes())
    normal = inside.T @ (weights * inside)
    return _homographies(CORNERS) @ np.linalg.solve(normal, (weights * inside).T)


@cache
def usual_covariance() -> Floats:
    """Return the covariance (8, 8) of a tile's corners for equal information everywhere, 1 px squared in the mean."""
    _, weight = leggauss(NODES)
    weights = np.repeat(np.outer(weight, weight).ravel(), 2)[:, None]
    inside = _homographies(nodes())
    outside = _homographies(CORNERS)
    covariance = outside @ np.linalg.solve(inside.T @ (weights * inside), outside.T)
    return np.asarray(covariance / np.trace(covariance) * len(covariance))


def affine_rows(corners_px: Floats) -> Floats:
    """Return (n, 6, 8): displacements of the middle, and the linear map about the middle, by displacements of the corners.

    Both are along the sides of the tiles (n, 4, 2) as they appear, px. Convergence does not
    change them.
    """
    basis = _turned(corners_px, _homographies(CORNERS))
    return np.asarray(np.linalg.inv(basis)[:, [2, 5, 0, 1, 3, 4]])


def usual_covariances(corners_px: Floats) -> Floats:
    """Return `usual_covariance` (n, 8, 8) for tiles that appear turned."""
    root = _turned(corners_px, np.asarray(np.linalg.cholesky(usual_covariance())))
    return np.asarray(root @ root.swapaxes(1, 2))


def _turned(corners_px: Floats, columns: Floats) -> Floats:
    """Return displacements (n, 8, k) of the corners as the tiles (n, 4, 2) appear in the photographs."""
    linear = corners_px.swapaxes(1, 2) @ CORNERS
    size = np.sqrt(np.abs(np.linalg.det(linear)))
    turn = linear / np.maximum(size, 1e-12)[:, None, None]
    by_corner = columns.reshape(1, 4, 2, -1)
    turned = np.einsum("nij,xcjk->ncik", turn, by_corner)
    return np.asarray(turned.reshape(len(corners_px), 8, -1))


def _homographies(places: Floats) -> Floats:
    """Return (2 n, 8) displacements [y, x] of places (n, 2) by the numbers of a homography near to the identity."""
    y, x = places.T
    one = np.ones_like(y)
    none = np.zeros_like(y)
    down = [y, x, one, none, none, none, y * y, x * y]
    right = [none, none, none, y, x, one, y * x, x * x]
    return np.stack([np.stack(down, -1), np.stack(right, -1)], axis=1).reshape(-1, 8)
