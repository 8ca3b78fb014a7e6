"""Edges found in a picture: straight segments (OpenCV's LSD), cut into pieces, each with a box around it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from labkit.arrays import real_array
from labkit.edges.region import turned
from labkit.types import Bools, Floats

Box = tuple[int, int, int, int]
"""Rows and columns r0, c0, r1, c1 of the raw, the last ones not included."""

PIECE = 48.0  # length of the pieces of a segment, samples of the picture
CORNER = 12.0  # samples at the end of an edge, which the next edge of its square blurs
SHORTEST = 20.0  # length of a segment, samples
DEEP = 14.0  # depth of the sides of a piece, samples
MOST_UNEVEN_SIDE = 0.12  # of the step: a side's own standard deviation, where noise alone does not explain it
SHADES = (0.2, 99.8)  # percentiles that a picture is stretched between
LEAST_STEP = 0.05  # of that stretch
READ_WITHIN = (0.1, 0.9)  # of a piece's length, where its sides are read
APART_ACROSS = 1.2  # of the depth: pieces of different edges
APART_ALONG = 0.8  # of the length


@dataclass(frozen=True)
class FoundEdge:
    """A piece of an edge.

    Attributes
    ----------
    box : around the piece, in pixels of the raw
    middle : (row, column) there
    angle : of its normal towards the brighter side, radians from x towards y
    length_px : in the raw
    step : over the picture's stretch
    """

    box: Box
    middle: tuple[float, float]
    angle: float
    length_px: float
    step: float

    def on(self, first: tuple[int, int], step: int) -> FoundEdge:
        """Return the edge in pixels of a raw. first, step : first sample, and pixels from sample to sample."""
        r0, c0, r1, c1 = (o + step * x for o, x in zip(first * 2, self.box, strict=True))
        row, column = (o + step * x for o, x in zip(first, self.middle, strict=True))
        length_px = step * self.length_px
        return FoundEdge((r0, c0, r1, c1), (row, column), self.angle, length_px, self.step)

    def mask(self, rows: Floats, columns: Floats, depth_px: float) -> Bools:
        """Return the mask of pixels within a depth of the line, and within half its length of its middle."""
        row, column = self.middle
        across, along = turned(self.angle, columns - column, rows - row)
        near = (np.abs(across) <= depth_px) & (np.abs(along) <= self.length_px / 2)
        return np.asarray(near)

    @property
    def cut(self) -> bool:
        """Return whether the border of the picture cuts a side, so that the brighter side is unknown."""
        return bool(np.isnan(self.angle))

    def apart(self, other: FoundEdge) -> bool:
        """Return whether two pieces, in samples, are of different edges and outside each other's sides."""
        y, x = np.subtract(self.middle, other.middle)
        across, along = turned(other.angle, x, y)
        reach = (self.length_px + other.length_px) / 2
        return bool(abs(across) > APART_ACROSS * DEEP or abs(along) > APART_ALONG * reach)


def find_edges(picture: Floats, most: int = 60) -> list[FoundEdge]:
    """Find straight edges between two even sides, the clearest first, none upon another, in samples.

    Parameters
    ----------
    picture : (rows, columns) of a colour, counts above black
    most : number of edges
    """
    found: list[FoundEdge] = []
    pieces = edge_pieces(picture, CORNER, short=True)
    edges = [edge for edge in pieces if edge.step > LEAST_STEP]
    for edge in sorted(edges, key=lambda edge: -edge.step * edge.length_px):
        if len(found) < most and all(edge.apart(other) for other in found):
            found.append(edge)
    return found


def edge_pieces(picture: Floats, trim: float, short: bool = False) -> list[FoundEdge]:
    """Find pieces of straight segments, several upon one edge.

    Parameters
    ----------
    picture : (rows, columns) of a colour, counts above black
    trim : left out at either end of a segment, samples
    short : whether segments that are too short for it lose less

    Returns
    -------
    pieces in samples; the step of one without two even sides is nan
    """
    if (even := stretched(picture)) is None:
        return []
    picture, eye = even
    grey = np.round(255 * eye).astype(np.uint8)
    lines = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    pieces = []
    for line in [] if lines is None else lines.reshape(-1, 2, 2).astype(float):
        start, end = line[:, ::-1]
        length = float(np.hypot(*(end - start)))
        left_out = min(trim, max(length - SHORTEST, 0) / 2) if short else trim
        if length - 2 * left_out >= SHORTEST:
            cut = left_out / length * (end - start)
            count = max(1, round((length - 2 * left_out) / PIECE))
            ends = np.linspace(start + cut, end - cut, count + 1)
            pieces += [piece_between(picture, *piece) for piece in pairwise(ends)]
    return pieces


def stretched(picture: Floats) -> tuple[Floats, Floats] | None:
    """Return a picture (rows, columns) between its darkest and brightest parts, 0 to 1, and by the eye's curve; None if all
    of it is equal.

    By the eye's curve edges in the dark count as well.
    """
    picture = real_array("picture", picture, (None, None), "counts")
    low, high = np.percentile(picture, SHADES)
    if not high > low:
        return None
    picture = (picture - low) / (high - low)
    return picture, np.sqrt(picture.clip(0, 1))


def piece_between(picture: Floats, start: Floats, end: Floats) -> FoundEdge:
    """Return a piece between two points (row, column), in samples; its step is nan if a side is uneven or cut by the border.

    Sides begin at a third of their depth, where blur has mostly ended.
    """
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    normal = along[::-1] * [1, -1]
    steps = np.arange(*(length * share for share in READ_WITHIN))[:, None, None]
    depth = np.arange(DEEP / 3, DEEP)[:, None]
    sides = [
        map_coordinates(
            picture, np.moveaxis(line + side * depth, -1, 0), order=0, cval=np.nan
        )
        for line in [start + along * steps]
        for side in (-normal, normal)
    ]
    rise = float(np.median(sides[1]) - np.median(sides[0]))
    rough = max(float(np.std(cv2.blur(side, (3, 3)))) for side in sides)
    aside = DEEP * np.sign(rise) * normal
    corners = np.stack([start - aside, start + aside, end - aside, end + aside])
    low = np.floor(corners.min(axis=0)).clip(0)
    high = np.minimum(np.ceil(corners.max(axis=0)) + 1, picture.shape)
    r0, c0, r1, c1 = np.nan_to_num([*low, *high]).astype(int).tolist()
    row, column = ((start + end) / 2).tolist()
    return FoundEdge(
        (r0, c0, r1, c1),
        (row, column),
        float(np.arctan2(*aside)),
        length,
        abs(rise) if rough < MOST_UNEVEN_SIDE * abs(rise) else np.nan,
    )
