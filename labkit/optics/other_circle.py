"""The same wavefront over another circle, of another radius, about another centre; and over the clear part alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.optics.rim import Rim
from labkit.optics.zernike import modes_at
from labkit.types import Floats

RADIAL_NODES, ANGULAR_NODES = 12, 48
"""Nodes of integrals over the clear part."""

SMALL_MODES = 1e-3
"""Square of the ratio of the allowed departure over the clear part to the modes' size: beyond the clear part a polynomial is
free, and its modes would grow."""

TILTED = (1, 2, 3)
"""Piston and tilts."""


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
    normal[len(TILTED) :, len(TILTED) :] += SMALL_MODES * np.eye(len(noll))
    found: Floats = np.asarray(np.linalg.solve(normal, (basis * weights) @ path), float)
    return found[len(TILTED) :], found[1 : len(TILTED)]


def root_over_clear_part(noll: Sequence[int], rim: Rim) -> Floats:
    """Return a matrix (modes, modes) that maps modes to numbers whose root sum of squares is the RMS over the clear part.

    Mean and tilts over the clear part do not count. In a round clear pupil it is the identity.
    """
    if rim.is_round:
        return np.eye(len(noll))
    x, y, weights = rim.quadrature(RADIAL_NODES, ANGULAR_NODES)
    basis = modes_at((*TILTED, *noll), x, y) * np.sqrt(weights)
    planes, _ = np.linalg.qr(basis[: len(TILTED)].T)
    modes = basis[len(TILTED) :].T
    modes -= planes @ (planes.T @ modes)
    values, vectors = np.linalg.eigh(modes.T @ modes)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
