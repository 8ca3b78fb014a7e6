"""Edges found in a picture: straight segments (OpenCV's LSD), cut into pieces, each with a box around it."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from labkit.arrays import real_array
from labkit.types import Bools, Floats

Box = tuple[int, int, int, int]
"""Rows and columns r0, c0, r1, c1 of the raw, the last ones not included."""

PIECE, SHORTEST, DEEP = 48.0, 20.0, 14.0
"""Of a segment, in samples of the picture: pieces along it, the shortest one, and how deep the sides of a piece must be."""

MOST_UNEVEN_SIDE = 0.12  # of the step: a side's own standard deviation, where noise alone does not explain it
BRIGHTEST, DARKEST = 99.8, 0.2  # percentiles that a picture is stretched between
LEAST_EDGE_STEP = 0.05  # of that stretch


@dataclass(frozen=True)
class FoundEdge:
    """A piece of an edge: box around it in pixels of the raw; middle: (row, column) there; angle of its normal towards the
    brighter side, radians from x towards y; length_px, and step over the picture's stretch, by which they are ranked."""

    box: Box
    middle: tuple[float, float]
    angle: float
    length_px: float
    step: float

    def mask(self, rows: Floats, columns: Floats, depth_px: float) -> Bools:
        """Which pixels belong to it: no farther from the line than a depth, nor along it than half its length."""
        y, x = rows - self.middle[0], columns - self.middle[1]
        across = x * np.cos(self.angle) + y * np.sin(self.angle)
        along = y * np.cos(self.angle) - x * np.sin(self.angle)
        return np.asarray(
            (np.abs(across) <= depth_px) & (np.abs(along) <= self.length_px / 2)
        )


def find_edges(
    picture: Floats, first: tuple[int, int] = (0, 0), step: int = 1, most: int = 60
) -> list[FoundEdge]:
    """Straight edges between two even sides, the clearest first, none upon another.

    picture: (rows, columns) of one colour, black removed, whose samples lie `step` pixels of the raw apart from (row, column)
    `first` on. most: of them.
    """
    picture = real_array("picture", picture, (None, None), "counts")
    low, high = np.percentile(picture, (DARKEST, BRIGHTEST))
    if not high > low:
        return []
    # the eye's curve: edges in the dark count as well
    stretched = np.sqrt(np.clip((picture - low) / (high - low), 0, 1))
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD)
    lines = detector.detect(np.round(255 * stretched).astype(np.uint8))[0]
    pieces = (
        []
        if lines is None
        else [p for line in lines.reshape(-1, 4) for p in _pieces(line.astype(float))]
    )
    judged = [(piece, *_judged(picture, *piece)) for piece in pieces]
    scale = float(high - low)
    good = [
        (start, end, rise)
        for (start, end), rise, even in judged
        if even and abs(rise) > LEAST_EDGE_STEP * scale
    ]
    good.sort(key=lambda of: -abs(of[2]) * np.hypot(*(of[1] - of[0])))
    found: list[FoundEdge] = []
    for start, end, rise in good:
        edge = _found(start, end, rise, rise / scale, first, step, picture.shape)
        if all(_apart(edge, other, step) for other in found):
            found.append(edge)
        if len(found) == most:
            break
    return found


def _pieces(line: Floats) -> list[tuple[Floats, Floats]]:
    """A segment (x0, y0, x1, y1) as pieces, each from its (x, y) to its (x, y)."""
    start, end = line[:2], line[2:]
    length = float(np.hypot(*(end - start)))
    if length < SHORTEST:
        return []
    count = max(1, round(length / PIECE))
    at = [start + (end - start) * k / count for k in range(count + 1)]
    return list(pairwise(at))


def _judged(picture: Floats, start: Floats, end: Floats) -> tuple[float, bool]:
    """The step from one side to the other along the normal (-dy, dx), and whether both sides are even.

    Sides are looked at from a third of their depth on, where blur has mostly ended.
    """
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    normal = np.array([-along[1], along[0]])
    steps = np.arange(0.1 * length, 0.9 * length)
    depth = np.arange(DEEP / 3, DEEP)
    sides = []
    for sign in (-1, 1):
        x = start[0] + along[0] * steps[:, None] + sign * normal[0] * depth
        y = start[1] + along[1] * steps[:, None] + sign * normal[1] * depth
        if (
            x.min() < 0
            or y.min() < 0
            or x.max() > picture.shape[1] - 1
            or y.max() > picture.shape[0] - 1
        ):
            return 0.0, False
        sides.append(picture[np.round(y).astype(int), np.round(x).astype(int)])
    rise = float(np.median(sides[1]) - np.median(sides[0]))
    rough = [float(np.std(cv2.blur(side, (3, 3)))) for side in sides]
    return rise, max(rough) < MOST_UNEVEN_SIDE * abs(rise)


def _found(
    start: Floats,
    end: Floats,
    rise: float,
    share: float,
    first: tuple[int, int],
    step: int,
    shape: tuple[int, ...],
) -> FoundEdge:
    """In pixels of the raw."""
    along = end - start
    angle = float(np.arctan2(along[0], -along[1])) + (np.pi if rise < 0 else 0.0)
    corners = np.array(
        [
            at + sign * DEEP * np.array([np.cos(angle), np.sin(angle)])
            for at in (start, end)
            for sign in (-1, 1)
        ]
    )
    low = np.floor(corners.min(axis=0)).clip(0)
    high = np.minimum(np.ceil(corners.max(axis=0)) + 1, [shape[1], shape[0]])
    box = (
        first[0] + step * int(low[1]),
        first[1] + step * int(low[0]),
        first[0] + step * int(high[1]),
        first[1] + step * int(high[0]),
    )
    middle = (start + end) / 2
    where = (first[0] + step * float(middle[1]), first[1] + step * float(middle[0]))
    return FoundEdge(
        box,
        where,
        float((angle + np.pi) % (2 * np.pi) - np.pi),
        step * float(np.hypot(*along)),
        abs(share),
    )


def _apart(edge: FoundEdge, other: FoundEdge, step: int) -> bool:
    """Whether two pieces are no part of the same edge, nor stand in each other's sides."""
    y, x = edge.middle[0] - other.middle[0], edge.middle[1] - other.middle[1]
    across = x * np.cos(other.angle) + y * np.sin(other.angle)
    along = y * np.cos(other.angle) - x * np.sin(other.angle)
    reach = (edge.length_px + other.length_px) / 2
    return bool(abs(across) > 1.2 * DEEP * step or abs(along) > 0.8 * reach)
