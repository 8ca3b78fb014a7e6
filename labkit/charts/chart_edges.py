"""Edges of a chart over the whole frame, grouped by place: cells of a grid over the frame, edges of two directions each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from labkit.edges.boxes import ChannelFrame, Place
from labkit.edges.found_edges import CORNER, LEAST_STEP, PIECE, FoundEdge, edge_pieces
from labkit.errors import DataError

Cell = tuple[int, int]
"""Row and column of a place in the grid."""

NEIGHBOUR_LENGTHS = (
    1.5  # lengths of a piece: pieces that are farther apart are of different edges
)
LEAST_GRID_ROWS = 3  # of the grid
ALIGNED_DEG = 1.0  # against rows or columns: such an edge is sampled at few phases


@dataclass(frozen=True)
class ChartEdges:
    """Edges of one photograph.

    Attributes
    ----------
    places : edges of each cell
    cut, clipped, spare : edges that the border cuts, that have clipped pixels, and that the
        cells do not need
    """

    places: Mapping[Cell, tuple[Place, ...]]
    cut: int
    clipped: int
    spare: int


def grid(shape: tuple[int, int], columns: int) -> tuple[int, int]:
    """Return rows and columns of nearly square cells over a frame, both odd: the middle is a place of its own."""
    rows, wide = shape
    half = (columns * rows / wide - 1) / 2
    return max(LEAST_GRID_ROWS, 2 * round(half) + 1), columns


def chart_edges(frame: ChannelFrame, cells: tuple[int, int], each: int) -> ChartEdges:
    """Find the edges of a chart in a channel's first plane.

    Parameters
    ----------
    frame : the channel of a photograph
    cells : rows and columns of the grid
    each : edges of either direction in a cell

    Raises
    ------
    DataError : no edge is whole and unclipped
    """
    pieces = edge_pieces(frame.first_plane(), CORNER)
    cut = sum(piece.cut for piece in pieces)
    whole = _once([piece for piece in pieces if piece.step > LEAST_STEP])
    places = [frame.found_at(one) for one in whole]
    unclipped = [place for place in places if frame.planes(place)]
    clipped = len(places) - len(unclipped)
    if not unclipped:
        raise DataError(
            f"no chart was found: of its straight edges between two even sides, {cut} are cut by the frame and {clipped} "
            "clipped; photograph a checkerboard or slanted squares, sides of 80 pixels at least, without clipping"
        )
    size = np.array(frame.part.shape) / cells
    by_cell: dict[Cell, list[Place]] = {}
    for place in unclipped:
        assert place.found is not None
        across, down = (np.array(place.found.middle) / size).astype(int).tolist()
        by_cell.setdefault((across, down), []).append(place)
    chosen = {cell: _two_directions(of, each) for cell, of in sorted(by_cell.items())}
    spare = len(unclipped) - sum(map(len, chosen.values()))
    return ChartEdges(chosen, cut, clipped, spare)


def is_aligned(angle_deg: float) -> bool:
    """Return whether an edge runs along rows or columns, nearly."""
    return abs((angle_deg + 45) % 90 - 45) < ALIGNED_DEG


def _once(pieces: Sequence[FoundEdge]) -> list[FoundEdge]:
    """Return pieces, the clearest first, none upon another."""
    pieces = sorted(pieces, key=lambda piece: -piece.step * piece.length_px)
    if not pieces:
        return []
    tree = cKDTree([piece.middle for piece in pieces])
    kept: dict[int, FoundEdge] = {}
    for k, near in enumerate(
        tree.query_ball_point([piece.middle for piece in pieces], NEIGHBOUR_LENGTHS * PIECE)
    ):
        if all(pieces[k].apart(kept[j]) for j in near if j in kept):
            kept[k] = pieces[k]
    return [*kept.values()]


def _two_directions(places: Sequence[Place], each: int) -> tuple[Place, ...]:
    """Return the clearest edges of a cell, `each` along the clearest one and as many across."""
    angles = np.array([place.found.angle for place in places if place.found])
    along = np.abs(np.cos(angles - angles[0])) > np.sqrt(0.5)
    first = np.flatnonzero(along)[:each]
    other = np.flatnonzero(~along)[:each]
    return tuple(places[k] for k in (*first.tolist(), *other.tolist()))
