"""The aperture on a grid: a disc whose edge the samples share so that its transform hardly depends on where they lie."""

import numpy as np
from numpy.polynomial import Polynomial

from labkit.arrays import positive, real_array
from labkit.types import Floats

REACH = 3  # of the edge's kernel, in samples


def smooth_disc(offsets: Floats, radius: float) -> Floats:
    """A disc under the kernel of central Lagrange interpolation over six samples, on a grid: (n, n), about 0 to 1.

    offsets: (n,) coordinates of the samples along either axis, from the disc's centre. radius: in samples, 2 or more.
    A transform of samples repeats with their frequency. What its copies add to a field, and what a soft edge takes from it, go
    here with the sixth power of the distance from the centre; of `disc_area` with the first and second. G. Strang, G. Fix,
    in Constructive Aspects of Functional Analysis (CIME, 1971). Raises ValueError for offsets of another shape or not finite,
    and for no radius.
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    axis, places = np.unique(np.abs(offsets), return_inverse=True)
    along, across = axis[:, None], axis[None, :]
    distance = np.hypot(along, across)
    octant = (distance < radius).astype(float)
    edge = (np.abs(distance - radius) < REACH * np.sqrt(2)) & (along >= across)  # where chords end steeply
    at, weight = (np.concatenate(each) for each in zip(*map(_gauss, range(-REACH, REACH)), strict=True))
    rows, columns = np.nonzero(edge)
    half_chord = np.sqrt(np.maximum(radius**2 - (axis[columns, None] - at) ** 2, 0.0))
    inside = _primitive(half_chord - axis[rows, None]) - _primitive(-half_chord - axis[rows, None])
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


def _quadrant_area(x: Floats, y: Floats, radius: float) -> Floats:
    """Area of the disc inside the rectangle from the centre to (x, y), odd in both x and y."""
    sign = np.sign(x) * np.sign(y)
    x, y = np.minimum(np.abs(x), radius), np.minimum(np.abs(y), radius)

    def half_chord(t: Floats) -> Floats:
        return np.asarray(np.sqrt((radius - t) * (radius + t)))  # as a difference of squares it may round to below 0

    def under_arc(t: Floats) -> Floats:
        return 0.5 * (t * half_chord(t) + radius**2 * np.arcsin(t / radius))

    flat = np.minimum(x, half_chord(y))  # up to here the top of the rectangle is inside the disc
    return sign * (y * flat + under_arc(x) - under_arc(flat))


def disc_area(offsets: Floats, radius: float) -> Floats:
    """The shaded aperture: area of a disc inside each unit square of a grid.

    offsets: (n,) coordinates of the squares' centres along either axis, in samples from the disc's centre.
    radius: in samples. Returns (n, n), 0..1. Thesis (G.1)-(G.3), in closed form.
    Raises ValueError for offsets of another shape or not finite, and for no radius.
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    low, high = offsets - 0.5, offsets + 0.5

    def corner(rows: Floats, columns: Floats) -> Floats:
        return _quadrant_area(columns[None, :], rows[:, None], radius)

    area = corner(high, high) - corner(low, high) - corner(high, low) + corner(low, low)
    return np.clip(area, 0.0, 1.0)
