"""Find the targets of a grid in a photograph: from one target to its neighbours, then their rows and columns.

A target found by `find_target` predicts the places of its neighbours; registration refines each neighbour, which predicts
further neighbours. No model of the whole picture is needed, so that perspective and distortion do no harm. Targets that the
frame cuts, or that the picture does not show, are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import chain, islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.errors import TargetError
from labkit.finder.carpet_squares import central_square, levelled_hypotheses
from labkit.finder.find_target import (
    LEAST_AGREEMENT,
    believable,
    find_target,
    is_target_shaped,
    margin_px,
    prepared,
    right_scale,
    swept,
)
from labkit.finder.registration import (
    OWN_CORNERS,
    homography,
    mapped,
    parent_agreement,
    quick_agreement,
    register,
)
from labkit.finder.tile_places import Lattice, first_place
from labkit.plan import TargetSpec
from labkit.target import Target, open_target
from labkit.target_grid import Place, TargetGrid, open_grid
from labkit.types import Floats

Singles = NDArray[np.float32]

NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))

MOST_STARTS = 24
"""Likely places of a first target that are looked at, of each threshold."""

LEAST_START = 0.3
"""Correlation at a coarse scale from which on a place is looked at closely."""

SEARCHED_SIDE_PX = 60.0
"""Side of a target, pixels, in a picture binned down to be searched; its central square then has twenty."""


def find_tiles(
    image: ArrayLike, grid: TargetGrid, *, mm_per_pixel: float | None = None
) -> dict[Place, Floats]:
    """Return the corners of a grid's targets in an image, by row and column, to about half a pixel.

    Rows and columns are counted from 0 at the upper left as the photograph shows the grid.
    Targets that the frame cuts or that are hidden are absent. Where the frame cuts the grid
    on two opposite sides, marks are needed.

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
        no target is found; the number of targets contradicts the grid; marks show that the
        grid is turned or mirrored; or which rows and columns are in the frame cannot be told
    """
    picture = prepared(image)
    lattice = _found(picture, grid, mm_per_pixel)
    row_0, col_0 = first_place(picture, lattice, grid)
    return {
        (row - row_0, col - col_0): corners
        for (row, col), corners in sorted(lattice.tiles.items())
    }


def find_targets(
    image: ArrayLike, spec: TargetSpec, *, mm_per_pixel: float | None = None
) -> Floats:
    """Return the corners (n, 4, 2) of a plan's target, or of all targets of its grid, the one nearest to the middle first.

    Parameters and errors are those of `find_target` and `find_tiles`.
    """
    grid = open_grid(spec)
    if grid is None:
        return find_target(image, open_target(spec), mm_per_pixel=mm_per_pixel)[None]
    tiles = np.stack([*find_tiles(image, grid, mm_per_pixel=mm_per_pixel).values()])
    middle = (np.array(np.shape(image)) - 1) / 2
    away = np.linalg.norm(tiles.mean(axis=1) - middle, axis=-1)
    return np.asarray(tiles[np.argsort(away)])


def _found(picture: Singles, grid: TargetGrid, mm_per_pixel: float | None) -> Lattice:
    """Return the lattice about the first likely target that has neighbours, or else about any target."""
    best: Lattice | None = None
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


def _grown(picture: Singles, grid: TargetGrid, first: Floats) -> Lattice:
    """Return all targets that are reached from a first one, neighbour by neighbour."""
    lattice = Lattice({(0, 0): first})
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
    """Return whether a target's centre is within another."""
    return bool(
        np.all(
            np.abs(mapped(homography(corners, OWN_CORNERS), other.mean(axis=0)[None])) < 0.5
        )
    )
