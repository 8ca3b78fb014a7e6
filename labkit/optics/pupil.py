"""The aperture on a grid: a disc whose edge the samples share so that its transform hardly depends on where they lie."""

import numpy as np
from numpy.polynomial import Polynomial

from labkit.arrays import positive, real_array
from labkit.types import Floats

REACH = 3  # of the edge's kernel, in samples


def smooth_disc(offsets: Floats, radius: float) -> Floats:
    """A disc smoothed by the kernel of central Lagrange interpolation over six samples.

    A transform of samples repeats with their frequency. The error of a field by its copies and by the smooth edge grows
    with the sixth power of the distance from the centre; for a disc shaded by area, with the first and second power.

    Parameters
    ----------
    offsets : (n,), coordinates of the samples along either axis from the disc's centre, samples
    radius : samples, 2 or more

    Returns
    -------
    (n, n), about 0 to 1

    Raises
    ------
    ValueError
        for offsets of another shape or not finite, and for a radius that is not positive

    Notes
    -----
    G. Strang and G. Fix, in Constructive Aspects of Functional Analysis (CIME, 1971).
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    axis, places = np.unique(np.abs(offsets), return_inverse=True)
    along, across = axis[:, None], axis[None, :]
    distance = np.hypot(along, across)
    octant = (distance < radius).astype(float)
    edge = (np.abs(distance - radius) < REACH * np.sqrt(2)) & (
        along >= across
    )  # where chords end steeply
    at, weight = (
        np.concatenate(each)
        for each in zip(*map(_gauss, range(-REACH, REACH)), strict=True)
    )
    rows, columns = np.nonzero(edge)
    half_chord = np.sqrt(np.maximum(radius**2 - (axis[columns, None] - at) ** 2, 0.0))
    inside = _primitive(half_chord - axis[rows, None]) - _primitive(
        -half_chord - axis[rows, None]
    )
    octant[rows, columns] = octant[columns, rows] = inside @ weight
    return np.asarray(octant[np.ix_(places, places)])


def _kernel(piece: int) -> Polynomial:
    """The kernel from a whole number to the next: 1 at 0, and 0 at the other samples that take part there."""
    others = [node for node in range(piece - REACH + 1, piece + REACH + 1) if node]
    product = Polynomial.fromroots(others)
    return product / product(0.0)


def _gauss(piece: int) -> tuple[Floats, Floats]:
    """Nodes and weights of an integral times the kernel, over one of its pieces."""
    at, weight = np.polynomial.legendre.leggauss(REACH + 2)
    at = piece + (1 + at) / 2
    return at, weight / 2 * _kernel(piece)(at)


def _primitive(t: Floats) -> Floats:
    """The kernel's integral from 0 to t, 1/2 from its reach on."""
    s, total = np.minimum(np.abs(t), REACH), np.zeros_like(t)
    for piece in range(REACH):
        total += _kernel(piece).integ(lbnd=piece)(np.clip(s, piece, piece + 1))
    return np.copysign(total, t)
