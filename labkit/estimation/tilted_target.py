"""The target's tilt, by the sizes of its tiles.

Along a tilted plane, the depth at the place h in the picture is Z0 / (1 + g·h). Lines of constant depth have the scale
f′ / Z there, with a pinhole f′ in front of the picture, and a small tile has

    (f′ / Z0)² c (1 + g·h)³

of its area on the target: the slope of the sizes over the field tells g. c is how much the picture is shortened across those
lines in the middle of the frame. It is the cosine of the tilt for a sensor at right angles to the axis, and 1 where sensor and
target are tilted as much, in contrary ways, so it is measured, by the shapes of the tiles. It is the same for a picture in
perspective and for one whose tiles are each drawn by the linear map at their middles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from labkit.estimation.candidate import Measured, Reading
from labkit.estimation.field_terms import polynomials
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Bools, Floats, Indices

NEAREST_DEPTH = 0.1
"""Least depth over that in the middle of the frame: a climb may try tilts far beyond those of targets."""


@dataclass(frozen=True, eq=False)
class TiltedTarget:
    """The place of the target's middle in the picture of each exposure: the stated range is the middle's.

    Attributes
    ----------
    order : radial order of the field's expansion
    middle : (exposures, 2) place of the target's middle without a tilt, down and right, over half the frame's diagonal
    spread : (exposures, 2, 2) by which a tilt moves that place
    """

    order: int
    middle: Floats
    spread: Floats

    @classmethod
    def of(
        cls, order: int, readings: Sequence[Reading], exposures: Indices
    ) -> TiltedTarget:
        """Find the middle of the target by the places of its tiles: h / (1 + g·h) is linear in the place on the target."""
        count = int(exposures.max()) + 1
        middle, spread = np.zeros((count, 2)), np.zeros((count, 2, 2))
        if order == 0:
            return cls(order, middle, spread)
        tiles = np.array([reading.key.tile for reading in readings], float)
        places = np.array([reading.place for reading in readings])
        rows = np.column_stack([np.ones(len(tiles)), tiles - tiles.mean(axis=0)])
        for k in range(count):
            here = exposures == k
            weights = np.linalg.pinv(rows[here])[0]
            middle[k] = weights @ places[here]
            spread[k] = (weights[:, None] * places[here]).T @ places[here]
        return cls(order, middle, spread)

    def log_scale(self, tilt: Floats) -> Floats:
        """Return the coefficients (terms, ..., exposures) that a tilt adds to ln of the scale, without c.

        Parameters
        ----------
        tilt : (2, ..., exposures) g, down and right, over half the frame's diagonal
        """
        places, expanded = _expansion(self.order)
        nearer = np.maximum(np.tensordot(places, tilt, 1), NEAREST_DEPTH - 1)
        scale = np.tensordot(expanded, 1.5 * np.log1p(nearer), 1)
        # Z0 is the depth in the middle of the frame
        beyond = np.einsum("i...n,ni->...n", tilt, self.middle)
        beyond -= np.einsum("i...n,j...n,nij->...n", tilt, tilt, self.spread)
        scale[0] -= beyond
        return np.asarray(scale)


def foreshortenings(
    readings: Sequence[Reading],
    chosen: Sequence[Measured | None],
    members: Bools,
    *,
    tiled: bool,
) -> Floats:
    """Return by how much a tilt makes ln of each size less, -ln(c) / 2, and its standard error, (n, 2).

    Of a target that is whole, the fit's own convergence tells it; of tiles, the shapes of all members of a station.
    """
    if tiled:
        return _by_shapes(readings, chosen, members)
    return np.array([(0.0, 0.0) if one is None else one.foreshortening for one in chosen])


def _by_shapes(
    readings: Sequence[Reading], chosen: Sequence[Measured | None], members: Bools
) -> Floats:
    """Return the foreshortening at the station of each observation, and its standard error, (n, 2).

    Over the frame the stretch changes linearly with a tilt, and by distortion with the square of the image height, the same at
    all stations.
    """
    stretches = np.array([(0.0, 0.0) if one is None else one.stretch for one in chosen])
    names, station = np.unique([one.station for one in readings], return_inverse=True)
    y, x = np.array([one.place for one in readings]).T
    here = np.eye(len(names))[station]
    of_station = np.hstack([here, here * y[:, None], here * x[:, None]])
    none = np.zeros_like(of_station)
    along = np.hstack([of_station, none, (x**2 - y**2)[:, None]])
    mixed = np.hstack([none, of_station, (2 * x * y)[:, None]])
    rows = np.vstack([along[members], mixed[members]])
    known = stretches[members].T.ravel()
    inverse = np.linalg.pinv(rows)
    numbers = inverse @ known
    spare = max(len(known) - int(np.linalg.matrix_rank(rows)), 1)
    noise = np.sum((known - rows @ numbers) ** 2) / spare
    std = np.sqrt(noise * np.sum(inverse**2, axis=1))[: len(names)]
    parts = numbers[:-1].reshape(2, -1)[:, : len(names)]
    return np.stack([np.hypot(*parts), std], axis=1)[station]


@cache
def _expansion(order: int) -> tuple[Floats, Floats]:
    """Return places (n, 2) over the frame, and the coefficients (terms, n) of what is 1 at one of them."""
    across = np.linspace(-1, 1, 2 * order + 3)
    square = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2)
    places = square[np.hypot(*square.T) <= 1]
    rows = polynomials(order, places, (DEFOCUS,), 3)[:, -1]
    return places, np.asarray(np.linalg.pinv(rows), float)
