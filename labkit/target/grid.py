"""A grid of equal targets that fills a frame: the plane between the targets is their surround.

ArUco marks between the targets name the places in the grid and show its directions. A single target with marks is a grid of
one, with a mark beyond each corner.
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
from labkit.target.target import (
    CellTarget,
    Target,
    low_pass,
    on_dots,
    open_target,
    read_spec,
)
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

FIRST_OF_A_SINGLE = 971
"""Number of the first of four marks around a single target, which differ in 5 of 16 bits in every direction. A grid of fewer
marks is not taken for a single target."""

RIM_SHARE = 0.2
"""Clear rim between a single target and its marks, in sides of the target: a fit uses 0.06 and at least 10 pixels as surround,
0.16 of a target of 60 pixels."""

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
        numbered row by row; in a grid of one row or column, between each two; of a single target,
        where they would be in a grid, with numbers of their own

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
        if self.marks and np.prod(self.mark_grid) > MOST_MARKS:
            raise TargetError(
                f"[target] marks: grid = {list(self.grid)} has no room for 1 to {MOST_MARKS} marks between its targets"
            )

    @property
    def is_marked_one(self) -> bool:
        """Return whether it is a single target with marks around it."""
        return self.marks and self.grid == (1, 1)

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of all targets, from the first one's edge to the last one's; with the marks of a single one."""
        if self.is_marked_one:
            return (self.pitch_mm + self.mark_mm,) * 2
        (rows, cols), (height, width) = self.grid, self.tile.size_mm
        return (rows - 1) * self.pitch_mm + height, (cols - 1) * self.pitch_mm + width

    @property
    def surround(self) -> float | None:
        """Radiance between and around the targets; None if unknown."""
        return self.tile.surround

    @property
    def mark_grid(self) -> tuple[int, int]:
        """(rows, columns) of marks, if the grid has any."""
        if self.is_marked_one:
            return 2, 2
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

    def mark_centres_mm(self) -> Floats:
        """Return (y, x) of the marks' centres (marks, 2), from the centre of the grid."""
        places = np.ndindex(*self.mark_grid)
        return np.array([_centre(place, self.mark_grid, self.pitch_mm) for place in places])

    def mark(self, number: int) -> CellTarget:
        """Return a mark, by its number in the grid, as a target of its own."""
        around = self.surround or 0.0
        cells = mark_cells(self.mark_numbers[number], on_dark=not around)
        return CellTarget(cells, (self.mark_mm, self.mark_mm), around)

    @property
    def mark_numbers(self) -> range:
        """Numbers of the marks in the dictionary."""
        first = FIRST_OF_A_SINGLE if self.is_marked_one else 0
        return range(first, first + int(np.prod(self.mark_grid)))

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
        drawn = np.stack([self.mark(k).cells for k in range(len(self.mark_numbers))])
        module_mm = self.mark_mm / MARK_MODULES
        at = np.stack((down[on_mark], right[on_mark])) / module_mm + MARK_MODULES / 2
        row, col = np.floor(at).astype(np.intp)
        radiance[on_mark] = drawn[number, row, col]
        return radiance

    def in_dots(self, tile: Floats, dot_mm: float) -> TargetGrid:
        """Return the grid on a raster of square dots, whole ones from target to target; its lengths are in dots.

        Parameters
        ----------
        tile : (rows, cols) radiance of a target's dots
        dot_mm : side of a dot

        Raises
        ------
        TargetError
            the gaps are too narrow for marks
        """
        # the dots are the cells of the target that the raster shows
        (height, width), least = tile.shape, LEAST_MODULE_DOTS * MARK_MODULES / MARK_SHARE
        dots = CellTarget(tile, (float(height), float(width)), self.surround)
        gap = max(round(self.pitch_mm / dot_mm) - max(tile.shape), 1)
        if self.is_marked_one:
            # every module in whole dots
            whole = round(MARK_MODULES / MARK_SHARE)
            gap = max(round(gap / whole) * whole, round(least))
        if self.marks and gap < least:
            raise TargetError(
                f"[target] marks: the gaps between the targets are {gap} pixels, and marks "
                f"take {least:g}: make pitch_mm larger, or leave out marks"
            )
        return TargetGrid(dots, self.grid, float(gap + max(tile.shape)), self.marks)

    def radiance_of_dots(self) -> Floats:
        """Return the radiance on the raster of a grid in dots, see `in_dots`."""
        height, width = self.size_mm
        return on_dots(self, (round(height), round(width)))

    def _parts(self) -> Iterator[tuple[Target, tuple[float, float]]]:
        """Yield all targets and marks with their centres."""
        for place in np.ndindex(*self.grid):
            yield self.tile, self.centre_mm(place)
        for number, (down_mm, right_mm) in enumerate(self.mark_centres_mm()):
            if self.marks:
                yield self.mark(number), (down_mm, right_mm)


def open_grid(spec: TargetSpec) -> TargetGrid | None:
    """Return the grid of targets of a plan's [target] table; None for a single target.

    Raises TargetError for targets that overlap or are unknown.
    """
    if not spec.of_many or spec.grid is None or spec.pitch_mm is None:
        return None
    return TargetGrid(open_target(spec), spec.grid, spec.pitch_mm, spec.marks)


def open_marked(spec: TargetSpec) -> TargetGrid | None:
    """Return the single target of a plan's [target] table with its marks; None for many, or without marks."""
    if spec.of_many or not spec.marks:
        return None
    target = open_target(spec)
    gap = RIM_SHARE / ((1 - MARK_SHARE) / 2)
    return TargetGrid(target, (1, 1), (1 + gap) * max(target.size_mm), marks=True)


def whole_target(spec: TargetSpec | str) -> Target:
    """Open all that a display or a print shows: the grid of targets, or the single target, with its marks.

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
    return open_grid(spec) or open_marked(spec) or open_target(spec)


def _centre(place: Place, counts: Place, pitch_mm: float) -> tuple[float, float]:
    """Return (y, x) of a member of equally spaced rows and columns, from the centre of them all."""
    row, col = place
    rows, cols = counts
    return (row - (rows - 1) / 2) * pitch_mm, (col - (cols - 1) / 2) * pitch_mm


def _nearest(at_mm: Floats, count: int, pitch_mm: float) -> tuple[NDArray[np.intp], Floats]:
    """Return the index of the nearest of equally spaced places along an axis, and the distance from it."""
    index = np.clip(np.rint(at_mm / pitch_mm + (count - 1) / 2), 0, count - 1)
    return index.astype(np.intp), at_mm - (index - (count - 1) / 2) * pitch_mm
