"""Find the nested squares of a carpet in a target, and quadrilaterals that resemble them in an image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labkit.finder.registration import binned
from labkit.target import CellTarget, Target
from labkit.types import Floats

Singles = NDArray[np.float32]

THRESHOLDS = (0.75, 0.65, 0.55, 0.45, 0.35)
"""Thresholds tried, as fractions of the picture's range."""

LEAST_SQUARE_SIDE_PX = 6.0
LEAST_POINTS = 4 * LEAST_SQUARE_SIDE_PX / np.sqrt(2)
"""Of a square's contour: from a point to the next it is a pixel, or a pixel's diagonal."""

SEARCH_SIDE = 1200
"""A picture of more than twice this many pixels across is binned down before it is searched."""


class _Quad(NamedTuple):
    """A contour (points, 1, 2) of whole pixels (x, y), its corners (4, 2) among them, and their area."""

    contour: NDArray[np.int32]
    corners: Floats
    area: float


def central_square(target: Target) -> float | None:
    """Return the relative side of a white square at the target's centre that determines the pose; else None.

    The square determines the pose if the target is unchanged by a quarter turn and in a
    mirror, has a black rim around the square, and has no other white area as large: a
    Sierpinski carpet.
    """
    if not isinstance(target, CellTarget) or target.size_mm[0] != target.size_mm[1]:
        return None
    cells = target.cells
    if not (np.array_equal(cells, np.rot90(cells)) and np.array_equal(cells, cells.T)):
        return None
    labels, _ = ndimage.label(cells == cells.max())
    middle = labels[cells.shape[0] // 2, cells.shape[1] // 2]
    areas = np.bincount(labels.ravel())
    if middle == 0 or areas[middle] != areas[1:].max():
        return None
    side = np.count_nonzero((labels == middle).any(axis=1))
    return (
        float(side / cells.shape[0])
        if areas[middle] == side**2 and side < cells.shape[0]
        else None
    )


def square_hypotheses(image: Singles, side_fraction: float) -> Iterator[Floats]:
    """Yield (4, 2) target corners (row, col), each from a possible image of the central square, largest first.

    image: (rows, cols), about 0..1. The corners have the order of least rotation.
    """
    factor = max(1, max(image.shape) // SEARCH_SIDE)
    image = binned(image, factor)
    quads = [quad for binary in _thresholded(image) for quad in _quadrilaterals(binary)]
    yield from _widened(quads, side_fraction, factor)


def levelled_hypotheses(
    image: Singles, side_fraction: float, factor: int
) -> Iterator[Floats]:
    """Yield corners like `square_hypotheses`, of one threshold after the other: for pictures with many squares.

    factor: by which the picture is binned down before it is searched.
    """
    for binary in _thresholded(binned(image, factor)):
        yield from _widened(_quadrilaterals(binary), side_fraction, factor)


def _quadrilaterals(binary: NDArray[np.uint8]) -> list[_Quad]:
    contours, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return [
        quad
        for contour in contours
        if len(contour) >= LEAST_POINTS
        and (quad := _quadrilateral(np.asarray(contour, dtype=np.int32))) is not None
    ]


def _widened(quads: list[_Quad], side_fraction: float, factor: int) -> Iterator[Floats]:
    """Yield a target's corners about each distinct quadrilateral, largest first.

    Sides are fitted to a quadrilateral as its turn comes: of hundreds, few are asked for.
    """
    distinct: list[Floats] = []
    unit = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    for quad in sorted(quads, key=lambda quad: quad.area, reverse=True):
        near = 0.08 * np.sqrt(quad.area)
        if distinct and np.abs(quad.corners - distinct).max(axis=(1, 2)).min() <= near:
            continue
        distinct.append(quad.corners)
        fitted = _least_rotation(
            _fitted_sides(quad.contour[:, 0].astype(np.float64), quad.corners)
        )
        widened = cv2.perspectiveTransform(
            (unit / side_fraction)[None],
            cv2.getPerspectiveTransform(unit, fitted.astype(np.float32)),
        )[0]
        yield (widened[:, ::-1].astype(np.float64) + 0.5) * factor - 0.5


def _thresholded(image: Singles) -> Iterator[NDArray[np.uint8]]:
    smooth = cv2.GaussianBlur(image, (0, 0), 0.8)
    for level in THRESHOLDS:
        yield (smooth > level).astype(np.uint8)
    # uneven light: against the mean of the neighbourhood
    for divisor in (2, 5):
        width = max(9, min(image.shape) // divisor)
        yield (smooth > cv2.blur(smooth, (width, width)) + 0.05).astype(np.uint8)


def _quadrilateral(contour: NDArray[np.int32]) -> _Quad | None:
    """Return the contour of a convex quadrilateral with its corners, clockwise from the upper left; else None."""
    length = cv2.arcLength(contour, True)
    if length < 4 * LEAST_SQUARE_SIDE_PX:
        return None
    coarse = cv2.approxPolyDP(contour, 0.06 * length, True)
    if len(coarse) != 4 or not cv2.isContourConvex(coarse):
        return None
    corners = coarse[:, 0, :].astype(np.float64)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    if sides.min() < LEAST_SQUARE_SIDE_PX or sides.max() > 2.0 * sides.min():
        return None
    corners = _least_rotation(corners)
    area = float(cv2.contourArea(corners.astype(np.float32)))
    if abs(area - cv2.contourArea(contour)) > 0.2 * area:
        return None
    return _Quad(contour, corners, area)


def _fitted_sides(points: Floats, corners: Floats) -> Floats:
    """Return the sub-pixel intersections of straight lines through the middle parts of the four sides."""
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (points - start) @ (end - start) / np.sum((end - start) ** 2)
        across = np.abs(_cross(end - start, points - start)) / np.linalg.norm(end - start)
        side = points[
            (along > 0.2) & (along < 0.8) & (across < 0.15 * np.linalg.norm(end - start))
        ]
        if len(side) < 3:
            return corners
        centre = side.mean(axis=0)
        normal = np.linalg.svd(side - centre)[2][1]
        lines.append((normal, normal @ centre))
    met = []
    for before, after in zip([lines[-1], *lines[:-1]], lines, strict=True):
        normals = np.array([before[0], after[0]])
        if (
            abs(np.linalg.det(normals)) < 0.3
        ):  # neighbouring sides of a square are never nearly parallel
            return corners
        met.append(np.linalg.solve(normals, np.array([before[1], after[1]])))
    return np.array(met)


def _least_rotation(corners: Floats) -> Floats:
    """Return corners clockwise on the screen (x right, y down), the first side nearest to pointing right."""
    if _cross(corners[1] - corners[0], corners[2] - corners[1]) < 0:
        corners = corners[::-1]
    sides = np.roll(corners, -1, axis=0) - corners
    return np.roll(
        corners, -int(np.argmax(sides[:, 0] / np.linalg.norm(sides, axis=1))), axis=0
    )


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the third component of the vector product of (..., 2) vectors."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
