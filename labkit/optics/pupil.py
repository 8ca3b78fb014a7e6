"""Draw the aperture on a grid with a smooth edge, so that its transform hardly depends on the samples' place."""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial

from labkit.arrays import positive, real_array
from labkit.optics.rim import along
from labkit.types import Floats

KERNEL_REACH = 3  # of a disc's edge's kernel, in samples
OUTLINE_REACH = 6  # of any outline's
DEGREE = 5  # of the spline that smooths it
FLATTER = (0.25, 13 / 240, 139 / 12096)
"""Powers of the second difference that undo the spline's blur up to the eighth order of the frequency."""
ARC_SPACING = 0.5  # samples between the ends of an outline's arcs


def smooth_disc(offsets: Floats, radius: float) -> Floats:
    """Return a disc smoothed by the kernel of central Lagrange interpolation over six samples.

    A transform of samples repeats with their frequency. The error of a field by its copies
    and by the smooth edge grows with the sixth power of the distance from the centre; for a
    disc shaded by area, with the first and second power.

    Parameters
    ----------
    offsets : (n,), coordinates of the samples along either axis from the disc's centre,
        samples
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
    along = axis[:, None]
    across = axis[None, :]
    distance = np.hypot(along, across)
    octant = (distance < radius).astype(float)
    edge = (np.abs(distance - radius) < KERNEL_REACH * np.sqrt(2)) & (
        along >= across
    )  # where chords end steeply
    at, weight = (
        np.concatenate(each)
        for each in zip(*map(_gauss, range(-KERNEL_REACH, KERNEL_REACH)), strict=True)
    )
    rows, columns = np.nonzero(edge)
    half_chord = np.sqrt(np.maximum(radius**2 - (axis[columns, None] - at) ** 2, 0.0))
    inside = _primitive(half_chord - axis[rows, None]) - _primitive(
        -half_chord - axis[rows, None]
    )
    octant[rows, columns] = octant[columns, rows] = inside @ weight
    return np.asarray(octant[np.ix_(places, places)])


def _kernel(piece: int) -> Polynomial:
    """Return the kernel between two whole numbers: 1 at 0, and 0 at the other samples."""
    others = [
        node for node in range(piece - KERNEL_REACH + 1, piece + KERNEL_REACH + 1) if node
    ]
    product = Polynomial.fromroots(others)
    return product / product(0.0)


def _gauss(piece: int) -> tuple[Floats, Floats]:
    """Return nodes and weights of an integral times the kernel, over one of its pieces."""
    at, weight = np.polynomial.legendre.leggauss(KERNEL_REACH + 2)
    at = piece + (1 + at) / 2
    return at, weight / 2 * _kernel(piece)(at)


def _primitive(t: Floats) -> Floats:
    """Return the kernel's integral from 0 to t, which is 1/2 beyond its reach."""
    s = np.minimum(np.abs(t), KERNEL_REACH)
    total = np.zeros_like(t)
    for piece in range(KERNEL_REACH):
        total += _kernel(piece).integ(lbnd=piece)(np.clip(s, piece, piece + 1))
    return np.copysign(total, t)


def smooth_outline(offsets: Floats, edges: Sequence[Floats]) -> Floats:
    """Return a region of any outline, smoothed by a kernel of splines.

    The kernel is the B-spline of degree 5 with corrected lowest frequencies: the error of a
    field grows with the sixth power of the distance from the centre, as in `smooth_disc`.
    By Green's theorem a sample is a sum over the edges.

    Parameters
    ----------
    offsets : (n,), coordinates of the samples along either axis, samples, 1 apart; they
        reach 6 samples beyond the region
    edges : closed chains of arcs as of `labkit.optics.rim.Rim.edges`, samples, an arc APART
        or less

    Returns
    -------
    (n, n), about 0 to 1, rows along y

    Notes
    -----
    M. Unser, IEEE Signal Processing Magazine 16, 22 (1999).
    """
    size = len(offsets)
    passed = np.zeros(size * size)  # what is clear between a sample and the next
    for node, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True):
        points = [along(edge, 0.5 + 0.5 * node) for edge in edges]
        x, y = np.concatenate([place for place, _ in points]).T - offsets[0]
        steps = 0.5 * weight * np.concatenate([slope for _, slope in points])
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        by_column = _spline(x - column, DEGREE + 1)
        by_row = _spline(y - row, DEGREE) * steps[:, 1]
        columns = column - KERNEL_REACH + np.arange(DEGREE + 2)[:, None]
        rows = row - KERNEL_REACH + 1 + np.arange(DEGREE + 1)[:, None]
        passed += np.bincount(
            (rows[:, None] * size + columns).ravel(),
            (by_row[:, None] * by_column).ravel(),
            size * size,
        )
    region = np.cumsum(passed.reshape(size, size)[:, ::-1], axis=1)[:, ::-1]
    differ = 2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    flatten = np.eye(size)
    power = np.eye(size)
    for factor in FLATTER:
        power = power @ differ
        flatten += factor * power
    return np.asarray(flatten @ region @ flatten)


def _spline(t: Floats, degree: int) -> Floats:
    """Return (degree + 1, points) B-splines of whole knots at t past a knot, in the order of their ends."""
    values = np.ones((1, t.size))
    for d in range(1, degree + 1):
        wider = np.zeros((d + 1, t.size))
        for m in range(d + 1):
            if m:
                wider[m] += (t + d - m) / d * values[m - 1]
            if m < d:
                wider[m] += (m + 1 - t) / d * values[m]
        values = wider
    return values
