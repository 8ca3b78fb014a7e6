"""Tiles held out: their measurements against the prediction of all other tiles."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from labkit.estimation.lens_fit import LensFit
from labkit.key import Key, Tile
from labkit.types import Floats, Indices


def pulls_of_tiles(lens: LensFit) -> dict[Key, Floats]:
    """Return, of each member of a tiled session, its modes less the prediction of all other tiles, over their standard errors.

    Returns
    -------
    (modes,) of each key; unit normal if the model of the field is right. Empty without tiles, or with one
    """
    model = lens.model
    tiles: dict[Tile | None, list[int]] = {}
    for k in np.flatnonzero(lens.measured.used).tolist():
        tiles.setdefault(model.readings[k].key.tile, []).append(k)
    if not model.tiled or len(tiles) < 2:
        return {}
    return {
        model.readings[k].key: pulls[: len(model.noll)]
        for rows in tiles.values()
        for k, pulls in zip(rows, _pulls(lens, np.array(rows)), strict=True)
    }


def _pulls(lens: LensFit, rows: Indices) -> Floats:
    """Return the pulls (m, values) of m members that are held out together.

    With residuals r about the estimate from all, noise N and covariance S of the fitted values, the residuals about the
    estimate from the others are N (N - S)⁻¹ r, with the covariance N (N - S)⁻¹ N.
    """
    model = lens.model
    noise = block_diag(*(lens.measured.covariance[rows] + np.diag(model.scatter())))
    left = noise - _spread(lens, rows)
    rest = (lens.measured.values - lens.solved.predicted)[rows].ravel()
    held = noise @ np.linalg.solve(left, np.column_stack([rest, noise]))
    std = np.sqrt(np.maximum(np.diag(held[:, 1:]), 0.0))
    return np.asarray((held[:, 0] / std / lens.birge_ratio).reshape(len(rows), -1))


def _spread(lens: LensFit, rows: Indices) -> Floats:
    """Return the covariance (m values, m values) of the fitted values of m observations."""
    model, solved = lens.model, lens.solved
    normal, blocks = solved.normal, model.blocks[model.exposures[rows]]
    followed = model.seen(solved.followed, rows).reshape(-1, len(lens.theta))
    own = model.seen(solved.own_slopes, rows)
    spread = followed @ normal.covariance @ followed.T
    for block in np.unique(blocks):
        at = np.flatnonzero(blocks == block)
        stacked = own[at].reshape(len(at) * model.values, -1)
        places = (at[:, None] * model.values + np.arange(model.values)).ravel()
        spread[np.ix_(places, places)] += stacked @ normal.own_covariance[block] @ stacked.T
    return np.asarray(spread)
