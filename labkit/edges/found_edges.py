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
LEAST_STEP = 0.05  # of that stretch


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
        """Return the mask of pixels within a depth of the line, and within half its length of its middle."""
        y, x = rows - self.middle[0], columns - self.middle[1]
        across = x * np.cos(self.angle) + y * np.sin(self.angle)
        along = y * np.cos(self.angle) - x * np.sin(self.angle)
        return np.asarray(
            (np.abs(across) <= depth_px) & (np.abs(along) <= self.length_px / 2)
        )


def find_edges(
    picture: Floats, first: tuple[int, int] = (0, 0), step: int = 1, most: int = 60
) -> list[FoundEdge]:
    """Find straight edges between two even sides, the clearest first, none upon another.

    Parameters
    ----------
    picture : (rows, columns) of one colour, counts above black
    first, step : (row, column) of the first sample in the raw, and pixels from sample to sample
    most : number of edges
    """
    picture = real_array("picture", picture, (None, None), "counts")
    low, high = np.percentile(picture, (DARKEST, BRIGHTEST))
    if not high > low:
        return []
    # the eye's curve: edges in the dark count as well
    stretched = np.sqrt(np.clip((picture - low) / (high - low), 0, 1))
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD)
    lines = detector.detect(np.round(255 * stretched).astype(np.uint8))[0]
    good = []
    for line in [] if lines is None else lines.reshape(-1, 4).astype(float):
        for start, end in _pieces(line):
            rise = _rise(picture, start, end) / float(high - low)
            if abs(rise) > LEAST_STEP:
                good.append((start, end, rise))
    good.sort(key=lambda of: -abs(of[2]) * np.hypot(*(of[1] - of[0])))
    found: list[FoundEdge] = []
    for start, end, rise in good:
        edge = _found(start, end, rise, first, step, picture.shape)
        if all(_apart(edge, other, step) for other in found):
            found.append(edge)
        if len(found) == most:
            break
    return found


def _pieces(line: Floats) -> list[tuple[Floats, Floats]]:
    """Return the pieces of a segment (x0, y0, x1, y1), each from its (x, y) to its (x, y)."""
    start = line[:2]
    end = line[2:]
    length = float(np.hypot(*(end - start)))
    if length < SHORTEST:
        return []
    count = max(1, round(length / PIECE))
    return list(pairwise(start + (end - start) * k / count for k in range(count + 1)))


def _rise(picture: Floats, start: Floats, end: Floats) -> float:
    """Return the step from side to side along the normal (-dy, dx); 0 if a side is uneven or cut by the border.

    Sides begin at a third of their depth, where blur has mostly ended.
    """
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    steps = np.arange(0.1 * length, 0.9 * length)[:, None]
    depth = np.arange(DEEP / 3, DEEP)
    sides = []
    for sign in (-1, 1):
        x = start[0] + along[0] * steps - sign * along[1] * depth
        y = start[1] + along[1] * steps + sign * along[0] * depth
        rows, columns = picture.shape
        if min(x.min(), y.min()) < 0 or x.max() > columns - 1 or y.max() > rows - 1:
            return 0.0
        sides.append(picture[np.round(y).astype(int), np.round(x).astype(int)])
    rise = float(np.median(sides[1]) - np.median(sides[0]))
    rough = max(float(np.std(cv2.blur(side, (3, 3)))) for side in sides)
    return rise if rough < MOST_UNEVEN_SIDE * abs(rise) else 0.0


def _found(
    start: Floats,
    end: Floats,
    rise: float,
    first: tuple[int, int],
    step: int,
    shape: tuple[int, ...],
) -> FoundEdge:
    """Return a piece as an edge in pixels of the raw."""
    along = end - start
    angle = float(np.arctan2(along[0], -along[1])) + (np.pi if rise < 0 else 0.0)
    aside = DEEP * np.array([np.cos(angle), np.sin(angle)])
    corners = np.array([start - aside, start + aside, end - aside, end + aside])
    low = np.floor(corners.min(axis=0)).clip(0)
    high = np.minimum(np.ceil(corners.max(axis=0)) + 1, shape[::-1])
    middle = (start + end) / 2

    def raw(x: float, y: float) -> tuple[float, float]:
        return first[0] + step * float(y), first[1] + step * float(x)

    r0, c0, r1, c1 = map(int, (*raw(*low), *raw(*high)))
    return FoundEdge(
        (r0, c0, r1, c1),
        raw(*middle),
        float((angle + np.pi) % (2 * np.pi) - np.pi),
        step * float(np.hypot(*along)),
        abs(rise),
    )


def _apart(edge: FoundEdge, other: FoundEdge, step: int) -> bool:
    """Whether two pieces are of different edges and outside each other's sides."""
    y, x = edge.middle[0] - other.middle[0], edge.middle[1] - other.middle[1]
    across = x * np.cos(other.angle) + y * np.sin(other.angle)
    along = y * np.cos(other.angle) - x * np.sin(other.angle)
    reach = (edge.length_px + other.length_px) / 2
    return bool(abs(across) > 1.2 * DEEP * step or abs(along) > 0.8 * reach)
