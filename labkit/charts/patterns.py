"""Charts recognised by their pattern: checkerboards by OpenCV's detector, grids of slanted squares by their outlines.

A pattern is found in small copies of the picture and refined in its own samples. Nothing else in a picture counts, however
straight its edges are: the squares about a checkerboard's corners must alternate, and slanted squares must be even, alike, on
even ground and on one lattice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from labkit.edges.found_edges import stretched
from labkit.types import Floats

Cell = tuple[int, int]
"""Row and column in a lattice."""

NEIGHBOUR_STEPS: tuple[Cell, ...] = ((0, 1), (0, -1), (1, 0), (-1, 0))
COPY_SAMPLES = 1.2e6  # of the largest copy that is searched
COPIES = 3  # each half as wide as the one before
MOST_LEFT_OUT = (
    1,
    2,
    3,
)  # steps of a board in one of the detector's, which leaves corners out of large boards
LEAST_BOARD = 3  # corners along either side of a checkerboard
QUADRANTS = (
    0.12,
    0.22,
    0.32,
)  # of a square's side: from a corner to parts of its four squares that are compared
QUADRANT_PART = 0.07  # of a square's side: half the width of such a part
MOST_UNLIKE = 0.35  # of the contrast: two squares of one colour at a corner
LEAST_CHART_CONTRAST = 0.04  # of the picture's stretch
MOST_AWAY = 0.2  # of a square's side, or of a lattice's step: a point from its place by its neighbours
WINDOW_SHARE, MOST_WINDOW = (
    0.2,
    10,
)  # of a square's side, and samples: half of a window that a corner is refined in

LEAST_SQUARE_SIDE = 8  # of a square in a copy, samples
LEVELS = np.linspace(15, 240, 24)  # grey levels whose outlines are searched
OUTLINE = 0.04  # of an outline's length: how far it may depart from its quadrilateral
ENCLOSED = 0.85  # of a quadrilateral's area, that its outline encloses
MOST_OBLONG = 1.6  # ratio of a square's sides, as it is seen
MOST_UNEVEN_SQUARE = (
    0.12  # of the contrast: standard deviation within a square, and on the ground around
)
WITHIN_SQUARE, AROUND_SQUARE = (
    0.6,
    1.3,
)  # of a square: sizes of a part of it, and of a ring around it
LEAST_SQUARE_COUNT, LEAST_SQUARE_ROWS = 6, 2
SIDES_ALIKE = 1.4  # ratio of the sides of neighbouring squares


@dataclass(frozen=True)
class Pattern:
    """A chart in a picture.

    Attributes
    ----------
    kind : in words
    sides : (n, 2, 2) ends (row, column) of the straight edges, at corners of squares, samples
    cells : (m, 2) row and column in the lattice
    points : (m, 2) of a checkerboard's corners, or of the centres of squares, samples
    """

    kind: str
    sides: Floats
    cells: NDArray[np.intp]
    points: Floats

    @property
    def side(self) -> float:
        """Median length of the edges, samples."""
        ends = self.sides[:, 1] - self.sides[:, 0]
        return float(np.median(np.hypot(*ends.T)))


def find_pattern(picture: Floats) -> Pattern | None:
    """Return the largest chart in a picture (rows, columns) of one colour, counts above black; None without one."""
    if (even := stretched(picture)) is None:
        return None
    grey = even[1].astype(np.float32)
    found: list[Pattern] = []
    for find in (_boards, _grids):
        found += [of for factor, copy in _copies(grey) for of in find(grey, copy, factor)]
        if found:
            break
    return max(found, key=lambda of: len(of.cells), default=None)


def _copies(grey: NDArray[np.float32]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield the samples along a sample of a copy, and the copy, the largest first."""
    least = max(1, int(np.ceil(np.sqrt(grey.size / COPY_SAMPLES))))
    for factor in (least * 2**k for k in range(COPIES)):
        rows, columns = (n // factor for n in grey.shape)
        if min(rows, columns) < 4 * LEAST_SQUARE_SIDE:
            return
        whole = grey[: rows * factor, : columns * factor]
        copy = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
        yield factor, np.round(255 * copy).astype(np.uint8)


def _in_picture(
    points: Floats,
    factor: int,
) -> Floats:
    """Return points (..., 2) of a copy, (column, row), as (row, column) of the picture."""
    return np.asarray((points[..., ::-1] + 0.5) * factor - 0.5, float)


def _refined(
    grey: NDArray[np.float32],
    points: Floats,
    side: float,
) -> Floats:
    """Return corners (n, 2) refined in the picture, nan where they move too far."""
    half = int(np.clip(WINDOW_SHARE * side, 2, MOST_WINDOW))
    found = np.ascontiguousarray(points[:, None, ::-1], np.float32)
    inside = np.all(
        (points > half + 2) & (points < np.array(grey.shape) - half - 3), axis=1
    )
    if inside.any():
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
        found[inside] = cv2.cornerSubPix(grey, found[inside], (half, half), (-1, -1), stop)
    refined = found[:, 0, ::-1].astype(float)
    near = np.hypot(*(refined - points).T) < MOST_AWAY * side
    return np.where((inside & near)[:, None], refined, np.nan)


def _boards(
    grey: NDArray[np.float32],
    copy: NDArray[np.uint8],
    factor: int,
) -> Iterator[Pattern]:
    """Yield the checkerboard around the corners that OpenCV finds in a copy."""
    size = (LEAST_BOARD, LEAST_BOARD)
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(
        copy, size, cv2.CALIB_CB_LARGER
    )
    if not found:
        return
    lattice = _in_picture(np.reshape(corners, (*meta.shape, 2)), factor)
    boards = [_grown_board(grey, seed) for seed in _seeds(lattice.reshape(-1, 2))]
    known = max(boards, key=len, default={})
    if _spans(known, LEAST_BOARD):
        yield Pattern("checkerboard", _board_sides(known), *_as_arrays(known))


Corners = dict[Cell, Floats]


def _seeds(points: Floats) -> Iterator[Corners]:
    """Yield 3 × 3 corners about the middle of some corners (m, 2) of a board, of which others may be missing."""
    away = points - points.mean(axis=0)
    point = points[int(np.argmin(np.hypot(*away.T)))]
    ways = points - point
    ways = ways[np.argsort(np.hypot(*ways.T))][1:]
    short = ways[0]
    across = np.abs(ways @ [-short[1], short[0]]) / np.hypot(*short) / np.hypot(*ways.T)
    if not (across > 0.5).any():
        return
    long = ways[int(np.argmax(across > 0.5))]
    long = long - np.round(long @ short / (short @ short)) * short
    for down, right in product(MOST_LEFT_OUT, MOST_LEFT_OUT):
        one, other = short / down, long / right
        for first, second in ((one, other), ((one + other) / 2, (one - other) / 2)):
            yield {
                (r, c): point + r * first + c * second
                for r, c in product((-1, 0, 1), (-1, 0, 1))
            }


def _grown_board(grey: NDArray[np.float32], seed: Corners) -> Corners:
    """Return the checkerboard around nine corners, empty where they are none."""
    refined = _refined(grey, np.array([*seed.values()]), _side(seed))
    known = {
        cell: point
        for cell, point in zip(seed, refined, strict=True)
        if np.isfinite(point).all()
    }
    known = _alternating(grey, known)
    while len(grown := _alternating(grey, known | _next(grey, known))) > len(known):
        known = grown
    return known


def _plus(
    cell: Cell,
    step: Cell,
    times: int = 1,
) -> Cell:
    return cell[0] + times * step[0], cell[1] + times * step[1]


def _next(
    grey: NDArray[np.float32],
    known: Corners,
) -> Corners:
    """Return the corners next to known ones, on their lines."""
    expected: dict[Cell, list[Floats]] = {}
    for cell, point in known.items():
        for step in NEIGHBOUR_STEPS:
            before = known.get(_plus(cell, step, -1))
            if before is not None and (after := _plus(cell, step)) not in known:
                expected.setdefault(after, []).append(2 * point - before)
    if not expected:
        return {}
    places = np.array([np.mean(of, axis=0) for of in expected.values()])
    refined = _refined(grey, places, _side(known))
    return {
        cell: point
        for cell, point in zip(expected, refined, strict=True)
        if np.isfinite(point).all()
    }


def _side(known: Corners) -> float:
    """Return the median distance of neighbouring points."""
    ends = [
        known[_plus(cell, step)] - point
        for cell, point in known.items()
        for step in ((0, 1), (1, 0))
        if _plus(cell, step) in known
    ]
    return float(np.median(np.hypot(*np.transpose(ends)))) if ends else 0.0


def _alternating(
    grey: NDArray[np.float32],
    known: Corners,
) -> Corners:
    """Return the largest connected part of those corners whose four squares alternate as a checkerboard's do."""
    signed = {}
    for cell, point in known.items():
        down, right = (_axis(known, cell, step) for step in ((1, 0), (0, 1)))
        if down is None or right is None:
            continue
        reach = QUADRANT_PART * min(np.hypot(*down), np.hypot(*right))
        contrasts = [
            _contrast(grey, point, share * down, share * right, reach)
            for share in QUADRANTS
        ]
        sign = np.sign(contrasts[-1])
        if min(sign * of for of in contrasts) > LEAST_CHART_CONTRAST:
            signed[cell] = sign * (-1) ** (sum(cell) % 2)
    sign = np.sign(sum(signed.values()))
    return _connected({cell: known[cell] for cell, of in signed.items() if of * sign > 0})


def _contrast(
    grey: NDArray[np.float32],
    point: Floats,
    down: Floats,
    right: Floats,
    reach: float,
) -> float:
    """Return how much brighter two opposite squares at a corner are than the others; 0 where opposite ones are unlike."""
    about = point + np.array([-down - right, down + right, right - down, down - right])
    one, other, third, fourth = _means(grey, about, reach)
    contrast = (one + other - third - fourth) / 2
    unlike = max(abs(one - other), abs(third - fourth))
    return contrast if unlike < MOST_UNLIKE * abs(contrast) else 0.0


def _axis(
    known: Corners,
    cell: Cell,
    step: Cell,
) -> Floats | None:
    """Return the way from a corner to the next one; None without a neighbour."""
    for times in (1, -1):
        if (other := known.get(_plus(cell, step, times))) is not None:
            return times * (other - known[cell])
    return None


def _means(
    grey: NDArray[np.float32],
    points: Floats,
    reach: float,
) -> list[float]:
    """Return mean grey about points (n, 2), as far as reach, nan outside of the picture."""
    found = []
    for point in points:
        low = np.floor(point - reach).astype(int)
        high = np.ceil(point + reach).astype(int) + 1
        inside = (low >= 0).all() and (high <= grey.shape).all()
        found.append(
            float(grey[low[0] : high[0], low[1] : high[1]].mean()) if inside else np.nan
        )
    return found


def _connected(known: Corners) -> Corners:
    """Return the largest part of a lattice whose points are neighbours."""
    left = set(known)
    parts: list[list[Cell]] = []
    while left:
        part = [left.pop()]
        for cell in part:
            for step in NEIGHBOUR_STEPS:
                if (other := _plus(cell, step)) in left:
                    left.discard(other)
                    part.append(other)
        parts.append(part)
    return {cell: known[cell] for cell in max(parts, key=len, default=[])}


def _spans(
    known: Corners,
    least: int,
) -> bool:
    """Return whether points fill so many rows and columns."""
    if len(known) < least**2:
        return False
    return bool(np.all(np.ptp([*known], axis=0) + 1 >= least))


def _board_sides(known: Corners) -> Floats:
    """Return the edges (n, 2, 2) from corner to corner, and from the outer ones to where the next would be."""
    sides = []
    for cell, point in known.items():
        for step in NEIGHBOUR_STEPS:
            after = known.get(_plus(cell, step))
            before = known.get(_plus(cell, step, -1))
            if after is not None and sum(step) > 0:
                sides.append([point, after])
            elif after is None and before is not None:
                sides.append([point, 2 * point - before])
    return np.array(sides)


def _as_arrays(known: Corners) -> tuple[NDArray[np.intp], Floats]:
    """Return cells (m, 2) and points (m, 2)."""
    return np.array([*known], np.intp), np.array([*known.values()])


def _grids(
    grey: NDArray[np.float32],
    copy: NDArray[np.uint8],
    factor: int,
) -> Iterator[Pattern]:
    """Yield the largest grid of squares in a copy."""
    outlines = [_in_picture(of, factor) for of in _quadrilaterals(copy)]
    smooth = np.asarray(cv2.blur(grey, (3, 3)), np.float32)
    squares = np.array([of for of in _each_once(outlines) if _is_even(smooth, of)])
    if len(squares) < LEAST_SQUARE_COUNT:
        return
    known = _lattice(squares)
    if len(known) < LEAST_SQUARE_COUNT or not _spans_squares(known):
        return
    cells = np.array([*known], np.intp)
    chosen = squares[[*known.values()]]
    refined = _refined(grey, chosen.reshape(-1, 2), _mean_side(chosen)).reshape(
        chosen.shape
    )
    corners = np.where(np.isfinite(refined), refined, chosen)
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    yield Pattern("slanted squares", sides.reshape(-1, 2, 2), cells, corners.mean(axis=1))


def _spans_squares(known: dict[Cell, int]) -> bool:
    return bool(np.all(np.ptp([*known], axis=0) + 1 >= LEAST_SQUARE_ROWS))


def _mean_side(squares: Floats) -> float:
    """Return the median side of squares (n, 4, 2)."""
    return float(np.median(np.hypot(*(squares - np.roll(squares, 1, axis=1)).T)))


def _quadrilaterals(copy: NDArray[np.uint8]) -> Iterator[Floats]:
    """Yield corners (4, 2) of outlines at all levels, (column, row), that are nearly squares."""
    smooth = cv2.GaussianBlur(copy, (0, 0), 1.0)
    for level in LEVELS:
        mask = (smooth > level).astype(np.uint8)
        outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            if len(outline) < 4 * LEAST_SQUARE_SIDE:
                continue
            corners = cv2.approxPolyDP(outline, OUTLINE * len(outline), closed=True)
            if len(corners) != 4 or not cv2.isContourConvex(corners):
                continue
            sides = np.hypot(*(corners - np.roll(corners, 1, axis=0))[:, 0].T)
            area = cv2.contourArea(corners)
            if sides.max() > MOST_OBLONG * sides.min() or area < 0.7 * np.mean(sides) ** 2:
                continue
            if ENCLOSED < cv2.contourArea(outline) / area < 1 / ENCLOSED:
                clockwise = cv2.contourArea(corners, oriented=True) > 0
                yield corners[:: 1 if clockwise else -1, 0].astype(float)


def _each_once(outlines: Sequence[Floats]) -> list[Floats]:
    """Return of outlines (4, 2) about one square the one of median size."""
    if not outlines:
        return []
    centres = np.array([of.mean(axis=0) for of in outlines])
    sizes = np.array([_mean_side(of[None]) for of in outlines])
    tree = cKDTree(centres)
    left = np.ones(len(outlines), bool)

    def about(k: int) -> list[int]:
        """Return the outlines that are left of the square that an outline is about."""
        near = tree.query_ball_point(centres[k], sizes[k] / 4)
        return [j for j in near if left[j] and sizes[k] / 2 < sizes[j] < 2 * sizes[k]]

    chosen = []
    for k in range(len(outlines)):
        if left[k]:
            near = about(k)
            middle = near[int(np.argsort(sizes[near])[len(near) // 2])]
            chosen.append(outlines[middle])
            # outlines near the chosen one are about its square, too
            left[near + about(middle)] = False
    return chosen


def _is_even(
    smooth: NDArray[np.float32],
    corners: Floats,
) -> bool:
    """Return whether a square (4, 2) and the ground around it are even, but for a slope of the light."""
    along = np.linspace(-0.5, 0.5, 7)
    v, u = np.meshgrid(along, along, indexing="ij")
    around = np.maximum(np.abs(u), np.abs(v)) > 0.49
    parts = []
    for size, used in ((WITHIN_SQUARE, np.ones_like(around)), (AROUND_SQUARE, around)):
        a, b = size * v[used] + 0.5, size * u[used] + 0.5
        weight = np.stack([(1 - a) * (1 - b), (1 - a) * b, a * b, a * (1 - b)], axis=1)
        parts.append(map_coordinates(smooth, (weight @ corners).T, order=1, cval=np.nan))
        slope = np.stack([np.ones_like(a), a, b], axis=1)
        seen = np.isfinite(parts[-1])
        if seen.mean() < 0.7:
            return False
        level = np.linalg.lstsq(slope[seen], parts[-1][seen], rcond=None)[0]
        parts[-1] = np.append(parts[-1][seen] - slope[seen] @ level, level @ [1, 0.5, 0.5])
    contrast = abs(parts[0][-1] - parts[1][-1])
    rough = max(float(np.std(of[:-1])) for of in parts)
    return bool(contrast > LEAST_CHART_CONTRAST and rough < MOST_UNEVEN_SQUARE * contrast)


def _lattice(squares: Floats) -> dict[Cell, int]:
    """Return the largest lattice of squares (n, 4, 2) that are alike: the number of the square in each cell."""
    centres = squares.mean(axis=1)
    sizes = np.array([_mean_side(of[None]) for of in squares])
    tree = cKDTree(centres)
    best: dict[Cell, int] = {}
    left = set(range(len(squares)))
    while left:
        start = min(left)
        grown = _grown(tree, centres, sizes, start)
        left -= {start, *grown.values()}
        best = max(best, grown, key=len)
    return best


def _grown(
    tree: cKDTree,
    centres: Floats,
    sizes: Floats,
    start: int,
) -> dict[Cell, int]:
    """Return the lattice around a square."""
    count = min(9, len(centres))
    _, nearest = tree.query(centres[[start]], count)
    near = centres[np.ravel(nearest)[1:]] - centres[start]
    right = near[0]
    turn = np.abs(near @ [-right[1], right[0]]) / np.hypot(*right) / np.hypot(*near.T)
    if not (turn > 0.8).any():
        return {}
    down = near[int(np.argmax(turn > 0.8))]
    known = {(0, 0): start}
    steps = {(0, 0): {(0, 1): right, (0, -1): -right, (1, 0): down, (-1, 0): -down}}
    queue = [(0, 0)]
    for cell in queue:
        here = known[cell]
        for step, way in steps[cell].items():
            after = _plus(cell, step)
            away, other = tree.query(centres[here] + way)
            ratio = sizes[other] / sizes[here]
            fits = (
                away < MOST_AWAY * np.hypot(*way) and 1 / SIDES_ALIKE < ratio < SIDES_ALIKE
            )
            if after in known or other in known.values() or not fits:
                continue
            known[after] = int(other)
            moved = centres[other] - centres[here]
            back = (-step[0], -step[1])
            steps[after] = steps[cell] | {step: moved, back: -moved}
            queue.append(after)
    return known
