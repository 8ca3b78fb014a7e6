"""Find the targets of a grid in a photograph: from one target to its neighbours, then their rows and columns.

A target found by `find_target` predicts the places of its neighbours; registration refines each neighbour, which predicts
further neighbours. No model of the whole picture is needed, so that perspective and distortion do no harm. Targets that the
frame cuts, or that the picture does not show, are left out.
"""

from __future__ import annotations

from collections import deque
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from labkit.errors import TargetError
from labkit.finder.carpet_search import is_carpet
from labkit.finder.find_target import (
    contains,
    find_target,
    is_target_shaped,
    likely_targets,
    margin_px,
    right_scale,
)
from labkit.finder.picture import Picture
from labkit.finder.registration import (
    LEAST_AGREEMENT,
    OWN_CORNERS,
    homography,
    mapped,
    parents,
    register,
)
from labkit.finder.tile_places import Lattice, first_place
from labkit.photographs.photograph import Photograph
from labkit.plan import TargetSpec
from labkit.target.grid import Place, TargetGrid, open_grid, whole_target
from labkit.target.target import Target
from labkit.types import Floats

NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def find_tiles(
    image: ArrayLike | Photograph | Picture,
    grid: TargetGrid,
    *,
    mm_per_pixel: float | None = None,
) -> dict[Place, Floats]:
    """Return the corners of a grid's targets in an image, by row and column, to about half a pixel.

    Rows and columns are counted from 0 at the upper left as the photograph shows the grid.
    Targets that the frame cuts or that are hidden are absent. Where the frame cuts the grid
    on two opposite sides, marks are needed.

    Parameters
    ----------
    image : a photograph, as `find_target` takes it
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
    picture = Picture.of(image)
    lattice = _found(picture, grid, mm_per_pixel)
    row_0, col_0 = first_place(picture, lattice, grid)
    return {
        (row - row_0, col - col_0): corners
        for (row, col), corners in sorted(lattice.tiles.items())
    }


def find_targets(
    image: ArrayLike | Photograph | Picture,
    spec: TargetSpec,
    *,
    mm_per_pixel: float | None = None,
) -> Floats:
    """Return the corners (n, 4, 2) of a plan's target, or of all targets of its grid, the one nearest to the middle first.

    Parameters and errors are those of `find_target` and `find_tiles`.
    """
    grid, picture = open_grid(spec), Picture.of(image)
    if grid is None:
        return find_target(picture, whole_target(spec), mm_per_pixel=mm_per_pixel)[None]
    tiles = np.stack([*find_tiles(picture, grid, mm_per_pixel=mm_per_pixel).values()])
    middle = (np.array(picture.shape) - 1) / 2
    away = np.linalg.norm(tiles.mean(axis=1) - middle, axis=-1)
    return np.asarray(tiles[np.argsort(away)])


def _found(picture: Picture, grid: TargetGrid, mm_per_pixel: float | None) -> Lattice:
    """Return the lattice about the first likely target that has neighbours, or else about any target."""
    best: Lattice | None = None
    batches = likely_targets(picture, grid.tile, mm_per_pixel)
    for likely in chain.from_iterable(batches):
        start = likely.corners
        if best is not None and any(contains(tile, start) for tile in best.tiles.values()):
            continue
        corners = _seen(picture, grid.tile, start)
        if corners is None or not right_scale(corners, grid.tile, mm_per_pixel):
            continue
        if is_carpet(grid.tile) and any(
            agreement > LEAST_AGREEMENT
            for _, agreement in parents(picture, grid.tile, corners)
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


def _grown(picture: Picture, grid: TargetGrid, first: Floats) -> Lattice:
    """Return all targets reached from a first one, neighbour by neighbour."""
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


def _seen(picture: Picture, tile: Target, expected: Floats) -> Floats | None:
    """Return a target's corners from nearby expected ones; None if the picture does not show all of it there."""
    if not is_target_shaped(expected):
        return None
    corners, agreement = register(picture, tile, expected)
    whole = is_target_shaped(corners) and margin_px(corners, picture.shape) >= 0
    return corners if whole and agreement.is_believable else None
