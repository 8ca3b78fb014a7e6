"""Find the targets of a grid in a photograph: from one target to its neighbours, then their rows and columns.

A target, found as `find_target` finds one, predicts where its neighbours are; registration refines each of them, and they
predict theirs. No model of the whole picture is needed, so that perspective and distortion do no harm. Targets that the
frame cuts, or that the picture does not show, are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.errors import TargetError
from labkit.finder.carpet_squares import central_square, levelled_hypotheses
from labkit.finder.find_target import (
    LEAST_AGREEMENT,
    believable,
    is_target_shaped,
    margin_px,
    prepared,
    right_scale,
    swept,
)
from labkit.finder.registration import (
    homography,
    mapped,
    parent_agreement,
    quick_agreement,
    register,
)
from labkit.target import Target
from labkit.target_grid import Place, TargetGrid
from labkit.types import Floats

Singles = NDArray[np.float32]

NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))

OWN_CORNERS = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
"""A target's corners from its centre, in its own size."""

MOST_STARTS = 24
"""Likely places of a first target that are looked at, of each threshold."""

LEAST_START = 0.3
"""Correlation at a coarse scale from which on a place is looked at closely."""

SEARCHED_SIDE_PX = 60.0
"""Side of a target, pixels, in a picture binned down to be searched; its central square then has twenty."""


@dataclass(slots=True)
class _Lattice:
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


def find_tiles(
    image: ArrayLike, grid: TargetGrid, *, mm_per_pixel: float | None = None
) -> dict[Place, Floats]:
    """Return the corners of a grid's targets in an image, by row and column, to about half a pixel.

    Rows and columns are counted from 0 at the upper left as the photograph shows the grid.
    Targets that the frame cuts or that are hidden are absent.

    Parameters
    ----------
    image : (rows, cols) grey, as `find_target` takes it
    grid : targets, their number and their distance
    mm_per_pixel : millimetres on the targets for each pixel, within 15 %; not needed for
        carpets

    Returns
    -------
    (row, column) -> (4, 2) corners (row, col) in pixels, in the order of `find_target`

    Raises
    ------
    TargetError
        no target is found, or the number of targets contradicts the grid, or which rows and
        columns are in the frame cannot be told
    """
    picture = prepared(image)
    lattice = _found(picture, grid, mm_per_pixel)
    firsts = [_first(lattice, grid, axis) for axis in (0, 1)]
    return {
        (row - firsts[0], col - firsts[1]): corners
        for (row, col), corners in sorted(lattice.tiles.items())
    }


def _found(picture: Singles, grid: TargetGrid, mm_per_pixel: float | None) -> _Lattice:
    """Return the lattice about the first likely target that has neighbours, or else about any target."""
    best: _Lattice | None = None
    for start in _starts(picture, grid, mm_per_pixel):
        if best is not None and any(_covers(tile, start) for tile in best.tiles.values()):
            continue
        corners = _seen(picture, grid.tile, start)
        if corners is None or not right_scale(corners, grid.tile, mm_per_pixel):
            continue
        if (
            central_square(grid.tile) is not None
            and parent_agreement(picture, grid.tile, corners) > LEAST_AGREEMENT
        ):
            continue
        lattice = _grown(picture, grid, corners)
        if best is None or len(lattice.tiles) > len(best.tiles):
            best = lattice
        if len(best.tiles) >= min(2, grid.grid[0] * grid.grid[1]):
            return best
    if best is None:
        raise TargetError(
            "no target found in the frame: check [target] in the plan, focus and light"
        )
    return best


def _starts(
    picture: Singles, grid: TargetGrid, mm_per_pixel: float | None
) -> Iterator[Floats]:
    """Yield likely corners of a first target, from squares if the targets have them, then from the sweep."""
    fraction = central_square(grid.tile)
    squares: Iterator[Floats] = iter(())
    if fraction is not None:
        likely = (
            corners
            for factor in _factors(picture, grid)
            for corners in levelled_hypotheses(picture, fraction, factor)
            if margin_px(corners, picture.shape) >= 0
            and right_scale(corners, grid.tile, mm_per_pixel, slack=2.0)
            and quick_agreement(picture, grid.tile, corners) > LEAST_START
        )
        squares = islice(likely, MOST_STARTS)
    return chain(squares, swept(picture, grid.tile, mm_per_pixel))


def _factors(picture: Singles, grid: TargetGrid) -> Iterator[int]:
    """Yield by how much to bin down the picture: for a grid that fills the frame, then for smaller ones."""
    largest_px = min(np.array(picture.shape) / grid.size_mm) * min(grid.tile.size_mm)
    factor = max(1, int(largest_px / SEARCHED_SIDE_PX))
    yield factor
    while factor > 1:
        factor = factor // 2
        yield factor


def _grown(picture: Singles, grid: TargetGrid, first: Floats) -> _Lattice:
    """Return all targets that are reached from a first one, neighbour by neighbour."""
    lattice = _Lattice({(0, 0): first})
    queue: deque[Place] = deque([(0, 0)])
    while queue:
        row, col = queue.popleft()
        for down, right in NEIGHBOURS:
            place = (row + down, col + right)
            if place in lattice.tiles or place in lattice.empty:
                continue
            expected = _neighbour(lattice.tiles[row, col], grid, (down, right))
            if margin_px(expected, picture.shape) < 0:
                continue
            corners = _seen(picture, grid.tile, expected)
            if corners is None:
                lattice.empty.add(place)
            else:
                lattice.tiles[place] = corners
                queue.append(place)
    return lattice


def _neighbour(corners: Floats, grid: TargetGrid, step: Place) -> Floats:
    """Return the expected corners of a target's neighbour."""
    away = np.array(step) * grid.pitch_mm / np.array(grid.tile.size_mm)
    return mapped(homography(OWN_CORNERS, corners), OWN_CORNERS + away)


def _seen(picture: Singles, tile: Target, expected: Floats) -> Floats | None:
    """Return a target's corners from nearby expected ones; None if the picture does not show all of it there."""
    if not is_target_shaped(expected):
        return None
    corners, agreement = register(picture, tile, expected)
    whole = is_target_shaped(corners) and margin_px(corners, picture.shape) >= 0
    return corners if whole and believable(agreement) else None


def _covers(corners: Floats, other: Floats) -> bool:
    """Whether a target's centre is within another."""
    return bool(
        np.all(
            np.abs(mapped(homography(corners, OWN_CORNERS), other.mean(axis=0)[None])) < 0.5
        )
    )


def _first(lattice: _Lattice, grid: TargetGrid, axis: int) -> int:
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
            f"{shown} are in the frame, which cuts the grid on both sides, so that it is unknown which ones: show all {name}"
        )
    return starts[0]


def _too_many(lattice: _Lattice, grid: TargetGrid) -> str:
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
