"""Edges of a chart over the whole frame, by its pattern, grouped by place: cells of a grid over the frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labkit.charts.patterns import Cell, Pattern, find_pattern
from labkit.edges.boxes import ChannelFrame, Place
from labkit.edges.found_edges import (
    CORNER,
    LEAST_STEP,
    SHORTEST,
    FoundEdge,
    piece_between,
    stretched,
)
from labkit.errors import DataError
from labkit.types import Floats

LONGEST = 128.0  # samples of a piece of an edge: the lens is nearly the same along it
LEAST_GRID_ROWS = 3  # of the grid
ALIGNED_DEG = 1.0  # against rows or columns: such an edge is sampled at few phases


@dataclass(frozen=True)
class ChartEdges:
    """Edges of one photograph.

    Attributes
    ----------
    pattern : the chart, in samples of the channel's first plane
    points_px : (m, 2) of its lattice, (row, column) in the raw
    places : edges of each cell
    cut, clipped, uneven, spare : edges that the border cuts, that have clipped pixels or
        uneven sides, and that the cells do not need
    small : edges too short to be measured
    side_px, least_px : of the squares, and of the smallest that can be measured
    """

    pattern: Pattern
    points_px: Floats
    places: Mapping[Cell, tuple[Place, ...]]
    cut: int
    clipped: int
    uneven: int
    spare: int
    small: int
    side_px: float
    least_px: float


def grid(
    shape: tuple[int, int],
    columns: int,
) -> tuple[int, int]:
    """Return rows and columns of nearly square cells over a frame, both odd: the middle is a place of its own."""
    rows, wide = shape
    half = (columns * rows / wide - 1) / 2
    return max(LEAST_GRID_ROWS, 2 * round(half) + 1), columns


def chart_edges(
    frame: ChannelFrame,
    cells: tuple[int, int],
    each: int,
) -> ChartEdges:
    """Find a chart and its edges in a channel's first plane.

    Parameters
    ----------
    frame : the channel of a photograph
    cells : rows and columns of the grid
    each : edges of either direction in a cell

    Raises
    ------
    DataError : there is no chart, or all of its edges are clipped, cut or uneven
    """
    picture = frame.first_plane()
    pattern = find_pattern(picture)
    if pattern is None:
        raise DataError(
            "no chart was found: neither a checkerboard of 4 × 4 squares or more, nor 6 or more slanted squares in rows and "
            "columns; labkit edges measures other straight edges, with --box"
        )
    even = stretched(picture)
    assert even is not None
    sides = [_pieces(*side) for side in pattern.sides]
    pieces = [
        piece_between(even[0], *ends)
        for side in sides
        for ends in side
        if _is_inside(np.mean(ends, axis=0), picture.shape)
    ]
    whole = [piece for piece in pieces if piece.step > LEAST_STEP]
    places = [frame.found_at(one) for one in sorted(whole, key=_clearness)]
    unclipped = [place for place in places if frame.planes(place)]
    cut = sum(piece.cut for piece in pieces)
    clipped = len(places) - len(unclipped)
    uneven = len(pieces) - len(whole) - cut
    if pieces and not unclipped:
        raise DataError(
            f"a chart was found ({pattern.kind}), but of its {len(pieces)} edges the frame cuts {cut}, {clipped} are clipped "
            f"and {uneven} have uneven sides: photograph it whole, sharper, and without clipping"
        )
    size = np.array(frame.part.shape) / cells
    by_cell: dict[Cell, list[Place]] = {}
    for place in unclipped:
        assert place.found is not None
        across, down = (np.array(place.found.middle) / size).astype(int).tolist()
        by_cell.setdefault((across, down), []).append(place)
    chosen = {cell: _two_directions(of, each) for cell, of in sorted(by_cell.items())}
    spare = len(unclipped) - sum(map(len, chosen.values()))
    step = frame.pixels.period
    return ChartEdges(
        pattern,
        frame.pixels.places[0] + step * pattern.points,
        chosen,
        cut,
        clipped,
        uneven,
        spare,
        small=sum(not side for side in sides),
        side_px=step * pattern.side,
        least_px=step * (2 * CORNER + SHORTEST),
    )


def _pieces(
    start: Floats,
    end: Floats,
) -> list[tuple[Floats, Floats]]:
    """Return the ends (2,) of the pieces of a side of a square, without its corners; none for a short one."""
    length = float(np.hypot(*(end - start)))
    if length - 2 * CORNER < SHORTEST:
        return []
    cut = CORNER / length * (end - start)
    count = int(np.ceil((length - 2 * CORNER) / LONGEST))
    return [*pairwise(np.linspace(start + cut, end - cut, count + 1))]


def _is_inside(
    point: Floats,
    shape: tuple[int, ...],
) -> bool:
    return bool(np.all(point >= 0) and np.all(point < np.array(shape) - 1))


def _clearness(piece: FoundEdge) -> float:
    """Return the order of pieces: the clearest first."""
    return float(-piece.step * np.sqrt(piece.length_px))


def is_aligned(angle_deg: float) -> bool:
    """Return whether an edge runs along rows or columns, nearly."""
    return abs((angle_deg + 45) % 90 - 45) < ALIGNED_DEG


def _two_directions(
    places: Sequence[Place],
    each: int,
) -> tuple[Place, ...]:
    """Return the clearest edges of a cell, `each` along the clearest one and as many across."""
    angles = np.array([place.found.angle for place in places if place.found])
    along = np.abs(np.cos(angles - angles[0])) > np.sqrt(0.5)
    first = np.flatnonzero(along)[:each]
    other = np.flatnonzero(~along)[:each]
    return tuple(places[k] for k in (*first.tolist(), *other.tolist()))
