"""Tell which rows and columns of a grid a photograph shows: by its marks, or by where the frame ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from math import log

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.errors import TargetError
from labkit.finder.picture import Picture
from labkit.finder.registration import OWN_CORNERS, homography, neighbourhood
from labkit.target.grid import MARK_MODULES, Place, TargetGrid
from labkit.types import Floats

MODULE_PX = 8
"""Side of a mark's module in the straightened picture from which it is read; the middle half of a module counts."""

LEAST_MARK_CONTRAST = 0.15
"""Of a mark's light and dark modules, of the picture's range: noise alone makes no mark."""

RINGS = np.array([[0, 1, 1, 0], [1, 2, 2, 1], [1, 2, 2, 1], [0, 1, 1, 0]])
"""Bits of a mark that have equally many neighbours in its rim."""

RINGLESS_BITS = RINGS.size - 3
"""Free numbers among a mark's bits without the means of its rings."""

LEAST_ODDS = 1000.0
"""Of the likeliest way to read all marks, against all others."""

LEAST_MARK_AGREEMENT = 0.25
"""Least correlation of three quarters of the marks of the plan's grid; of another grid's marks half are uncorrelated."""

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
        """Return whether a row, or a column, is in the frame and has no target."""
        return any(place[axis] == index for place in self.empty)


@dataclass(frozen=True, slots=True)
class _Way:
    """One way in which the marks of a grid could appear in a photograph.

    mirrored, turns: as in a mirror, then in quarter turns to the left; first: the lattice's
    place of the first target, of an upright grid; agreement: correlation of all marks with
    those of the grid there; each: (marks,) of every mark.
    """

    mirrored: bool
    turns: int
    first: Place
    agreement: float
    each: Floats


def first_place(picture: Picture, lattice: Lattice, grid: TargetGrid) -> Place:
    """Return the lattice's place of the grid's first target.

    Raises TargetError for a grid that contradicts the plan, is turned or mirrored, and for
    one that the frame cuts so that its rows or columns cannot be told.
    """
    seen = dict(_marks(picture, lattice, grid)) if grid.marks else {}
    first = _by_marks(seen, lattice, grid) if seen else None
    if first is None:
        first = (_by_the_frame(lattice, grid, 0), _by_the_frame(lattice, grid, 1))
    for axis in (0, 1):
        start, count = lattice.extent(axis)
        if start < first[axis] or start + count > first[axis] + grid.grid[axis]:
            raise TargetError(_too_many(lattice, grid))
    return first


def _marks(
    picture: Picture, lattice: Lattice, grid: TargetGrid
) -> Iterator[tuple[Place, Floats]]:
    """Yield the place of the target up and left of each mark, and the light (4, 4) of the mark's bits."""
    own_mm = OWN_CORNERS * grid.tile.size_mm
    # a mark is between two rows, and between two columns, unless there is one of them alone
    rows, cols = ((0, -1) if count > 1 else (0,) for count in grid.grid)
    looked: set[Place] = set()
    for (row, col), corners in lattice.tiles.items():
        image, at, _ = neighbourhood(
            picture, corners, _samples(grid), grid.pitch_mm / min(grid.tile.size_mm)
        )
        by = homography(own_mm, at)
        for down, right in product(rows, cols):
            place = (row + down, col + right)
            if place in looked:
                continue
            looked.add(place)
            middle = [
                (step + 0.5) * grid.pitch_mm if count > 1 else 0.0
                for step, count in zip((down, right), grid.grid, strict=True)
            ]
            levels = _levels(image, by, np.array(middle) + OWN_CORNERS * grid.mark_mm)
            if np.ptp(levels) > LEAST_MARK_CONTRAST:  # False for nan
                yield place, levels[1:-1, 1:-1]


def _samples(grid: TargetGrid) -> float:
    """Return the samples across a target in which a module of a mark has MODULE_PX."""
    return min(grid.tile.size_mm) / grid.mark_mm * MARK_MODULES * MODULE_PX


def _levels(image: NDArray[np.float32], by: Floats, corners_mm: Floats) -> Floats:
    """Return the mean light in the modules (6, 6) of a mark; nan outside of the picture."""
    side = MARK_MODULES * MODULE_PX
    end = side - 0.5
    straight = np.array([[-0.5, -0.5], [-0.5, end], [end, end], [end, -0.5]])
    from_straight = by @ homography(straight, corners_mm)
    upright = cv2.warpPerspective(
        image,
        from_straight,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderValue=np.nan,
    )
    middle = slice(MODULE_PX // 4, MODULE_PX - MODULE_PX // 4)
    cells = upright.reshape(MARK_MODULES, MODULE_PX, MARK_MODULES, MODULE_PX)
    return np.asarray(cells[:, middle, :, middle].mean(axis=(1, 3)), dtype=np.float64)


def _by_marks(
    seen: dict[Place, Floats], lattice: Lattice, grid: TargetGrid
) -> Place | None:
    """Return the lattice's place of the first target by all marks together; None where the marks cannot be told.

    A way to read them counts if its likelihood is a thousand times that of all others together,
    and of no marks at all.

    Raises TargetError for a grid turned or mirrored, or whose marks are of another grid.
    """
    ways = sorted(_ways(seen, lattice, grid), key=lambda way: way.agreement, reverse=True)
    if not ways:
        return None
    best = ways[0]
    # the log-likelihood of Gaussian noise of unknown size grows by this for each way, from no marks
    gains = [
        -RINGLESS_BITS * len(seen) / 2 * log(max(1 - max(way.agreement, 0.0) ** 2, 1e-6))
        for way in ways[:2]
    ]
    enough = log(LEAST_ODDS * len(ways))
    if gains[0] < enough:
        return None
    if np.percentile(best.each, 25) < LEAST_MARK_AGREEMENT:
        raise TargetError(
            f"the marks in the photograph are those of another grid than [target] grid = {list(grid.grid)}"
        )
    if gains[0] - max(gains[1:], default=0.0) < enough:
        return None
    if best.mirrored:
        raise TargetError(
            "the grid is mirrored in the photograph, its marks show: show and photograph it unmirrored"
        )
    if best.turns:
        raise TargetError(
            f"the grid is turned {QUARTER_TURNS[best.turns]} in the photograph, its marks show: turn the camera or the grid, "
            "or write [target] grid as the photograph shows it and leave out marks"
        )
    return best.first


def _ways(seen: dict[Place, Floats], lattice: Lattice, grid: TargetGrid) -> Iterator[_Way]:
    """Yield all ways in which the grid could hold the targets found, with its marks where marks are seen."""
    rows, cols = grid.mark_grid
    known = np.stack([grid.mark(k).cells[1:-1, 1:-1] for k in range(rows * cols)])
    wanted = _ringless(known)
    after = np.array([0.5 * (count > 1) for count in grid.grid])
    for mirrored, turns in product((False, True), range(4)):
        marks = np.array(list(seen)) + after
        tiles = np.array(list(lattice.tiles))
        bits = np.stack([*seen.values()])
        if mirrored:
            marks, tiles, bits = marks * (1, -1), tiles * (1, -1), bits[:, :, ::-1]
        for _ in range(turns):
            marks = np.column_stack((marks[:, 1], -marks[:, 0]))
            tiles = np.column_stack((tiles[:, 1], -tiles[:, 0]))
        match = _ringless(np.rot90(bits, -turns, axes=(1, 2))) @ wanted.T
        low = tiles.max(axis=0) - np.array(grid.grid) + 1
        for first in product(*map(range, low, tiles.min(axis=0) + 1)):
            row, col = np.rint(marks - after - first).astype(int).T
            inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
            number = np.where(inside, row * cols + col, 0)
            each = np.where(inside, match[np.arange(len(marks)), number], 0.0)
            yield _Way(mirrored, turns, (first[0], first[1]), float(each.mean()), each)


def _ringless(bits: Floats) -> Floats:
    """Return bits (n, 4, 4) as unit vectors (n, 16) without the means of corners, edges and middle.

    Blur makes the bits next to a mark's rim brighter.
    """
    left = bits.reshape(-1, RINGS.size).astype(np.float64)
    for ring in np.unique(RINGS):
        members = RINGS.ravel() == ring
        left[:, members] -= left[:, members].mean(axis=1, keepdims=True)
    norms = np.linalg.norm(left, axis=1, keepdims=True)
    return np.asarray(left / np.maximum(norms, 1e-9))


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
        remedy = (
            "and no mark can be read: larger gaps have larger marks"
            if grid.marks
            else "so that it is unknown which ones: show marks between the targets (marks = true)"
        )
        raise TargetError(
            f"{shown} are in the frame, which cuts the grid on both sides, {remedy}, or show all {name}"
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
