"""Tell which rows and columns of a grid a photograph shows: by its marks, or by where the frame ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.errors import TargetError
from labkit.finder.registration import homography
from labkit.target_grid import Place, TargetGrid
from labkit.target_marks import MARK_MODULES, Reading, read_marks
from labkit.types import Bools, Floats

Singles = NDArray[np.float32]

OWN_CORNERS = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
"""A target's corners from its centre, in its own size."""

MODULE_PX = 8
"""Side of a mark's module in the straightened picture from which it is read; the middle half of a module counts."""

LEAST_MARK_CONTRAST = 0.15
"""Of a mark's light and dark modules, of the picture's range: noise alone makes no mark."""

QUARTER_TURNS = ("", "by 90° to the left", "by 180°", "by 90° to the right")


@dataclass(slots=True)
class Lattice:
    """Targets found from one of them, at (0, 0): their corners, and places in the frame where no target is."""

    tiles: dict[Place, Floats]
    empty: set[Place] = field(default_factory=set)

    def extent(self, axis: int) -> tuple[int, int]:
        """Return the first index and the number of rows, or of columns."""
        indices = [place[axis] for place in self.tiles]
        return min(indices), max(indices) - min(indices) + 1

    def ends_at(self, axis: int, index: int) -> bool:
        """Whether a row, or a column, is in the frame and has no target."""
        return any(place[axis] == index for place in self.empty)


@dataclass(frozen=True, slots=True)
class _Seen:
    """A mark in a photograph: the target up and left of it, in the lattice, and how it reads."""

    place: Place
    reading: Reading


def first_place(picture: Singles, lattice: Lattice, grid: TargetGrid) -> Place:
    """Return the lattice's place of the grid's first target.

    Raises TargetError for a grid that contradicts the plan, is turned or mirrored, and for
    one that the frame cuts so that its rows or columns cannot be told.
    """
    seen = list(_marks(picture, lattice, grid)) if grid.marks else []
    first = _by_marks(seen, grid) if seen else None
    if first is None:
        first = (_by_the_frame(lattice, grid, 0), _by_the_frame(lattice, grid, 1))
    for axis in (0, 1):
        start, count = lattice.extent(axis)
        if start < first[axis] or start + count > first[axis] + grid.grid[axis]:
            raise TargetError(_too_many(lattice, grid))
    return first


def _marks(picture: Singles, lattice: Lattice, grid: TargetGrid) -> Iterator[_Seen]:
    """Yield each mark around the found targets that can be read, in every reading."""
    own_mm = OWN_CORNERS * grid.tile.size_mm
    # a mark is between two rows, and between two columns, unless there is one of them alone
    rows, cols = ((0, -1) if count > 1 else (0,) for count in grid.grid)
    looked: set[Place] = set()
    for (row, col), corners in lattice.tiles.items():
        by = homography(own_mm, corners)
        for down, right in product(rows, cols):
            place = (row + down, col + right)
            if place in looked:
                continue
            looked.add(place)
            middle = [
                (step + 0.5) * grid.pitch_mm if count > 1 else 0.0
                for step, count in zip((down, right), grid.grid, strict=True)
            ]
            modules = _modules(picture, by, np.array(middle) + OWN_CORNERS * grid.mark_mm)
            if modules is not None:
                for reading in read_marks(modules, on_dark=not grid.surround):
                    yield _Seen(place, reading)


def _modules(picture: Singles, by: Floats, corners_mm: Floats) -> Bools | None:
    """Return which modules (6, 6) of a mark are light; None without contrast, or outside of the picture."""
    side = MARK_MODULES * MODULE_PX
    end = side - 0.5
    straight = np.array([[-0.5, -0.5], [-0.5, end], [end, end], [end, -0.5]])
    from_straight = by @ homography(straight, corners_mm)
    upright = cv2.warpPerspective(
        picture,
        from_straight,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderValue=np.nan,
    )
    middle = slice(MODULE_PX // 4, MODULE_PX - MODULE_PX // 4)
    cells = upright.reshape(MARK_MODULES, MODULE_PX, MARK_MODULES, MODULE_PX)
    levels = cells[:, middle, :, middle].mean(axis=(1, 3))
    low, high = float(levels.min()), float(levels.max())
    if not high - low > LEAST_MARK_CONTRAST:
        return None
    return np.asarray(levels > (low + high) / 2)


def _by_marks(seen: list[_Seen], grid: TargetGrid) -> Place | None:
    """Return the lattice's place of the first target by most of the marks; None where no mark is the grid's.

    Raises TargetError for a grid that is turned or mirrored, or whose marks are of another grid.
    """
    many, cols = np.prod(grid.mark_grid), grid.mark_grid[1]
    own = [mark for mark in seen if mark.reading.number < many]
    if not own:
        return None
    ways = Counter((mark.reading.mirrored, mark.reading.turns) for mark in own)
    mirrored, turns = ways.most_common(1)[0][0]
    if mirrored:
        raise TargetError(
            "the grid is mirrored in the photograph, its marks show: show and photograph it unmirrored"
        )
    if turns:
        raise TargetError(
            f"the grid is turned {QUARTER_TURNS[turns]} in the photograph, its marks show: turn the camera or the grid, or "
            "write [target] grid as the photograph shows it and leave out marks"
        )
    upright = [
        mark for mark in own if mark.reading == Reading(mark.reading.number, 0, False)
    ]
    firsts = Counter(
        (
            mark.place[0] - mark.reading.number // cols,
            mark.place[1] - mark.reading.number % cols,
        )
        for mark in upright
    )
    first, votes = firsts.most_common(1)[0]
    if 2 * votes <= len(upright):
        raise TargetError(
            f"the marks in the photograph are those of another grid than [target] grid = {list(grid.grid)}"
        )
    return first


def _by_the_frame(lattice: Lattice, grid: TargetGrid, axis: int) -> int:
    """Return the lattice's index of the grid's first row, or column.

    Of a grid that the frame cuts, the rows that are missing must be where the frame ends.
    """
    first, count = lattice.extent(axis)
    total, name = grid.grid[axis], ("rows", "columns")[axis]
    if count > total:
        raise TargetError(_too_many(lattice, grid))
    beyond = total - count
    starts = [
        first - before
        for before in range(beyond + 1)
        if not (before > 0 and lattice.ends_at(axis, first - 1))
        and not (before < beyond and lattice.ends_at(axis, first + count))
    ]
    shown = f"{count} of the grid's {total} {name}"
    if not starts:
        raise TargetError(
            f"only {shown} are found, and the frame has room for more: uncover the grid, "
            "or check grid, pitch_mm and size_mm of [target]"
        )
    if len(starts) > 1:
        raise TargetError(
            f"{shown} are in the frame, which cuts the grid on both sides, so that it is unknown which ones: show all {name}, "
            "or marks between the targets (marks = true)"
        )
    return starts[0]


def _too_many(lattice: Lattice, grid: TargetGrid) -> str:
    rows, cols = (lattice.extent(axis)[1] for axis in (0, 1))
    turned = (
        f"; if the camera or the grid is turned by 90°, write grid = [{rows}, {cols}]"
        if (cols, rows) == grid.grid
        else ""
    )
    return (
        f"{rows} rows and {cols} columns of targets are found, [target] has grid = {list(grid.grid)}: "
        f"check grid and what is shown{turned}"
    )
