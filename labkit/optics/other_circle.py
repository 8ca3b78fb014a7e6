"""The same wavefront over another circle, of another radius, about another centre; and over the clear part alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.optics.rim import ROUND, Rim
from labkit.optics.zernike import modes_at
from labkit.types import Floats

RADIAL_NODES, ANGULAR_NODES = 12, 48
"""Nodes of integrals over the clear part."""

SMALL_MODES = 1e-3
"""Square of the ratio of the allowed departure over the clear part to the modes' size: beyond the clear part a polynomial is
free, and its modes would grow."""

TILTED = (1, 2, 3)
"""Piston and tilts."""

PLANES = len(TILTED)


def over_other_circle(
    noll: Sequence[int], waves: Floats, rim: Rim, other: Rim
) -> tuple[Floats, Floats]:
    """Return the modes of a wavefront over the unit circle of another rim whose clear part is alike.

    Centres and areas of the clear parts agree. The modes are as small as a departure of 3 %
    of them over the clear part allows.

    Parameters
    ----------
    noll, waves : (modes,) over the unit circle of `rim`
    rim, other : rims of the same clear part, relative to two circles

    Returns
    -------
    (modes,) over the unit circle of `other`, and the tilts (2,) along x and y that the
    modes lack, in the unit of `waves`
    """
    x, y, weights = other.quadrature(RADIAL_NODES, ANGULAR_NODES)
    factor = np.sqrt(rim.area / other.area)
    (old_x, old_y), (new_x, new_y) = rim.centre, other.centre
    path = np.tensordot(
        waves,
        modes_at(tuple(noll), old_x + factor * (x - new_x), old_y + factor * (y - new_y)),
        1,
    )
    basis = modes_at((*TILTED, *noll), x, y)
    normal = (basis * weights) @ basis.T
    normal[PLANES:, PLANES:] += SMALL_MODES * np.eye(len(noll))
    found: Floats = np.asarray(np.linalg.solve(normal, (basis * weights) @ path), float)
    return found[PLANES:], found[1:PLANES]


def moved_over(noll: Sequence[int], waves: Floats, away: Floats, wider: float) -> Floats:
    """Return the modes of a wavefront over a circle of another radius, about another centre; exact for whole radial orders.

    Parameters
    ----------
    noll : the modes beside piston and tilts
    waves : (3 + modes,) over the unit circle, piston and tilts first
    away : (2,) x, y of the other circle's centre
    wider : its radius

    Returns
    -------
    (3 + modes,) over the other circle
    """
    x, y, weights = ROUND.quadrature(RADIAL_NODES, ANGULAR_NODES)
    every = (*TILTED, *noll)
    path = waves @ modes_at(every, away[0] + wider * x, away[1] + wider * y)
    return np.asarray((modes_at(every, x, y) * weights) @ path)


def root_over_clear_part(noll: Sequence[int], rim: Rim) -> Floats:
    """Return a matrix (modes, modes) that maps modes to numbers whose root sum of squares is the RMS over the clear part.

    Mean and tilts over the clear part do not count. In a round clear pupil it is the identity.
    """
    if rim.is_round:
        return np.eye(len(noll))
    x, y, weights = rim.quadrature(RADIAL_NODES, ANGULAR_NODES)
    basis = modes_at((*TILTED, *noll), x, y) * np.sqrt(weights)
    planes, _ = np.linalg.qr(basis[:PLANES].T)
    modes = basis[PLANES:].T
    modes -= planes @ (planes.T @ modes)
    values, vectors = np.linalg.eigh(modes.T @ modes)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
