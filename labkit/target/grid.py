"""A grid of equal targets that fills a frame: the plane between the targets is their surround.

ArUco marks between the targets name the places in the grid and show its directions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.plan import TargetSpec
from labkit.target.target import CellTarget, Target, low_pass, open_target, read_spec
from labkit.types import Floats

MARK_MODULES = 6
"""Modules along a side of a mark: four bits and the rim."""

MOST_MARKS = 1000
"""Number of marks in the dictionary."""

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)


def mark_cells(number: int, *, on_dark: bool) -> Floats:
    """Return the modules (6, 6) of a mark: 1 is light, 0 dark."""
    drawn = DICTIONARY.generateImageMarker(number, MARK_MODULES, borderBits=1) > 0
    return np.asarray(drawn != on_dark, dtype=np.float64)


Place = tuple[int, int]
"""(row, column) of a target in a grid, from 0."""

MARK_SHARE = 0.5
"""Side of a mark, in gaps between two targets: the rest keeps its light away from the targets."""

LEAST_MODULE_DOTS = 2.0
"""Dots of a raster along a module of a mark."""


@dataclass(frozen=True, slots=True)
class TargetGrid:
    """Equal targets in rows and columns.

    Parameters
    ----------
    tile : each target; its surround lies between the targets too
    grid : (rows, columns) of targets
    pitch_mm : distance of neighbours' centres along rows and columns
    marks : whether ArUco marks stand in the gaps, one in the middle of each four neighbours,
        numbered row by row; in a grid of one row or column, between each two

    Raises
    ------
    TargetError
        no targets, targets that overlap, or marks without gaps to stand in
    """

    tile: Target
    grid: tuple[int, int]
    pitch_mm: float
    marks: bool = False

    def __post_init__(self) -> None:
        if min(self.grid) < 1:
            raise TargetError(f"[target] grid = {list(self.grid)}: allowed is 1 and more")
        height, width = self.tile.size_mm
        if not max(height, width) < self.pitch_mm < np.inf:
            raise TargetError(
                f"[target] pitch_mm = {self.pitch_mm:g}: allowed is more than a target's {height:g} × {width:g} mm"
            )
        if self.marks and (max(self.grid) < 2 or np.prod(self.mark_grid) > MOST_MARKS):
            raise TargetError(
                f"[target] marks: grid = {list(self.grid)} has no room for 1 to {MOST_MARKS} marks between its targets"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of all targets, from the first one's edge to the last one's."""
        (rows, cols), (height, width) = self.grid, self.tile.size_mm
        return (rows - 1) * self.pitch_mm + height, (cols - 1) * self.pitch_mm + width

    @property
    def surround(self) -> float | None:
        """Radiance between and around the targets; None if unknown."""
        return self.tile.surround

    @property
    def mark_grid(self) -> tuple[int, int]:
        """(rows, columns) of marks, if the grid has any."""
        return max(1, self.grid[0] - 1), max(1, self.grid[1] - 1)

    @property
    def mark_mm(self) -> float:
        """Side of a mark."""
        return MARK_SHARE * (self.pitch_mm - max(self.tile.size_mm))

    @property
    def clear_mm(self) -> float:
        """Width of the surround around a target that is nearer to the target than to marks and neighbours."""
        gap_mm = self.pitch_mm - max(self.tile.size_mm)
        return (1 - MARK_SHARE) / 4 * gap_mm if self.marks else gap_mm / 2

    def centre_mm(self, place: Place) -> tuple[float, float]:
        """Return (y, x) of a target's centre, from the centre of the grid."""
        return _centre(place, self.grid, self.pitch_mm)

    def mark(self, number: int) -> CellTarget:
        """Return a mark as a target of its own."""
        around = self.surround or 0.0
        cells = mark_cells(number, on_dark=not around)
        return CellTarget(cells, (self.mark_mm, self.mark_mm), around)

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the radiance (m, n) on the grid y_mm (m,) × x_mm (n,) after the filter of `CellTarget.sample`.

        Each target is added where the filter lets it reach. Raises ValueError unless
        bandwidth_per_mm > 0.
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y, x = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        around = self.surround or 0.0
        reach_mm = low_pass()[0] / bandwidth_per_mm
        made = np.full((y.size, x.size), around)
        for part, (down_mm, right_mm) in self._parts():
            height, width = part.size_mm
            rows = np.flatnonzero(np.abs(y - down_mm) < height / 2 + reach_mm)
            cols = np.flatnonzero(np.abs(x - right_mm) < width / 2 + reach_mm)
            made[np.ix_(rows, cols)] += (
                part.sample(y[rows] - down_mm, x[cols] - right_mm, bandwidth_per_mm)
                - around
            )
        return made

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return exact point values at broadcast (y_mm, x_mm); between targets and marks the surround, 0 if unknown."""
        y, x = np.broadcast_arrays(
            real_array("y_mm", y_mm, None, "mm"), real_array("x_mm", x_mm, None, "mm")
        )
        down, right = (
            _nearest(at, count, self.pitch_mm)[1]
            for at, count in zip((y, x), self.grid, strict=True)
        )
        radiance = self.tile.radiance(down, right)
        if not self.marks:
            return radiance
        rows, down = _nearest(y, self.mark_grid[0], self.pitch_mm)
        cols, right = _nearest(x, self.mark_grid[1], self.pitch_mm)
        on_mark = np.maximum(np.abs(down), np.abs(right)) < self.mark_mm / 2
        number = (rows * self.mark_grid[1] + cols)[on_mark]
        drawn = np.stack([self.mark(k).cells for k in range(int(np.prod(self.mark_grid)))])
        module_mm = self.mark_mm / MARK_MODULES
        at = np.stack((down[on_mark], right[on_mark])) / module_mm + MARK_MODULES / 2
        row, col = np.floor(at).astype(np.intp)
        radiance[on_mark] = drawn[number, row, col]
        return radiance

    def laid_out(self, tile: Floats, pitch_dots: int) -> Floats:
        """Return the radiance of the grid on a raster.

        Parameters
        ----------
        tile : (rows, cols) radiance of a target's dots
        pitch_dots : from target to target

        Raises
        ------
        TargetError
            the gaps are too narrow for marks
        """
        # the dots are the cells of the target that the raster shows
        height, width = tile.shape
        dots = CellTarget(tile, (float(height), float(width)), self.surround)
        drawn = TargetGrid(dots, self.grid, float(pitch_dots), self.marks)
        if self.marks and drawn.mark_mm < LEAST_MODULE_DOTS * MARK_MODULES:
            raise TargetError(
                f"[target] marks: the gaps between the targets are {pitch_dots - max(tile.shape)} pixels, and marks "
                f"take {LEAST_MODULE_DOTS * MARK_MODULES / MARK_SHARE:g}: make pitch_mm larger, or leave out marks"
            )
        y, x = (np.arange(side) - (side - 1) / 2 for side in drawn.size_mm)
        return drawn.radiance(y[:, None], x[None, :])

    def _parts(self) -> Iterator[tuple[Target, tuple[float, float]]]:
        """Yield all targets and marks with their centres."""
        for place in np.ndindex(*self.grid):
            yield self.tile, self.centre_mm(place)
        for number, place in enumerate(np.ndindex(*self.mark_grid)):
            if self.marks:
                yield self.mark(number), _centre(place, self.mark_grid, self.pitch_mm)


def open_grid(spec: TargetSpec) -> TargetGrid | None:
    """Return the grid of targets of a plan's [target] table; None for a single target.

    Raises TargetError for targets that overlap or are unknown.
    """
    if not spec.of_many or spec.grid is None or spec.pitch_mm is None:
        return None
    return TargetGrid(open_target(spec), spec.grid, spec.pitch_mm, spec.marks)


def whole_target(spec: TargetSpec | str) -> Target:
    """Open all that a display or a print shows: the grid of targets, or the single target.

    Parameters
    ----------
    spec : table of a plan, or a text as `labkit.open_target` takes

    Raises
    ------
    PlanError
        for a bad plan
    TargetError
        for an unknown kind
    """
    spec = read_spec(spec) if isinstance(spec, str) else spec
    return open_grid(spec) or open_target(spec)


def _centre(place: Place, counts: Place, pitch_mm: float) -> tuple[float, float]:
    """Return (y, x) of a member of equally spaced rows and columns, from the centre of them all."""
    row, col = place
    rows, cols = counts
    return (row - (rows - 1) / 2) * pitch_mm, (col - (cols - 1) / 2) * pitch_mm


def _nearest(at_mm: Floats, count: int, pitch_mm: float) -> tuple[NDArray[np.intp], Floats]:
    """Return the index of the nearest of equally spaced places along an axis, and the distance from it."""
    index = np.clip(np.rint(at_mm / pitch_mm + (count - 1) / 2), 0, count - 1)
    return index.astype(np.intp), at_mm - (index - (count - 1) / 2) * pitch_mm
