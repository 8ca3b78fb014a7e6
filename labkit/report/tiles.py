"""A session of tiles in a report: the tile that stands for the lens, and where each tile was in the photograph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from labkit.errors import InputError
from labkit.key import Tile
from labkit.results import Results, Wavefront
from labkit.types import Floats


def tiles_of(results: Results) -> tuple[Tile, ...]:
    """Return each tile once, row by row; empty for results of whole frames."""
    return tuple(sorted({w.tile for w in results if w.tile is not None}))


def of_tile(results: Results, tile: Tile | None) -> Results:
    """Return the results of one tile alone, with the session's own numbers; all of them for None.

    Raises InputError for a tile that was not fitted.
    """
    if tile is None:
        return results
    of = tuple(w for w in results if w.tile == tile)
    if not of:
        known = tiles_of(results)
        has = f"{known[0]} to {known[-1]}" if known else "no tiles"
        raise InputError(f"no tile {tile} was fitted: these results have {has}")
    return replace(results, wavefronts=of)


def central_tile(results: Results) -> Tile | None:
    """Return the tile nearest to the frame's centre among the tiles with most sound fits; None without tiles."""
    tiles = tiles_of(results)
    if not tiles:
        return None
    fits = {tile: [w for w in results if w.tile == tile] for tile in tiles}
    middle = (
        np.mean(tiles, axis=0) if results.field is None else results.field.frame.centre_px
    )

    def rank(tile: Tile) -> tuple[int, float]:
        sound = sum(w.accepted for w in fits[tile])
        place = np.array(tile) if results.field is None else mean_place_px(fits[tile])
        return -sound, float(np.hypot(*(place - middle)))

    return min(tiles, key=rank)


def mean_place_px(wavefronts: Iterable[Wavefront]) -> Floats:
    """Return the mean place (row, column) of some fits' tiles; nan where none is known."""
    corners = [w.placement.corners_px for w in wavefronts if w.placement is not None]
    places = [each.mean(axis=(0, 1)) for each in corners]
    return np.mean(places, axis=0) if places else np.full(2, np.nan)
