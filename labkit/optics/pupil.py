"""The aperture on a grid: a disc whose edge the samples share so that its transform hardly depends on where they lie."""

import numpy as np

from labkit.arrays import positive, real_array
from labkit.types import Floats

NODES = 5  # Gauss-Legendre's, on each of the four intervals of Keys' kernel


def smooth_disc(offsets: Floats, radius: float) -> Floats:
    """A disc under Keys' cubic kernel (a = -1/2), sampled on a grid: (n, n), a little below 0 and above 1 along the edge.

    offsets: (n,) coordinates of the samples along either axis, from the disc's centre. radius: in samples, 2 or more.
    The transform of samples repeats with their frequency. What its copies add to a field, and what the soft edge takes from it,
    go with the third and fourth power of the distance from the centre; of `disc_area` with the first and second. R. Keys, IEEE
    Trans. Acoust. Speech Signal Process. 29, 1153 (1981). Raises ValueError for offsets of another shape or not finite, and for
    no radius.
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    rows, columns = np.abs(offsets)[:, None], np.abs(offsets)[None, :]
    along, across = np.maximum(rows, columns), np.minimum(rows, columns)  # where the edge cuts its chords steeply
    distance = np.hypot(along, across)
    disc = (distance < radius).astype(float)
    edge = np.abs(distance - radius) < 3.0
    at, weight = np.polynomial.legendre.leggauss(NODES)
    at = np.concatenate([piece + 0.5 + at / 2 for piece in (-2, -1, 0, 1)])
    weight = np.tile(weight / 2, 4) * _keys(at)
    half_chord = np.sqrt(np.maximum(radius**2 - (across[edge][:, None] - at) ** 2, 0.0))
    inside = _keys_primitive(half_chord - along[edge][:, None]) - _keys_primitive(-half_chord - along[edge][:, None])
    disc[edge] = inside @ weight
    return disc


def _keys(t: Floats) -> Floats:
    """Keys' kernel, from -2 to 2."""
    t = np.abs(t)
    return np.where(t < 1, 1 + t**2 * (1.5 * t - 2.5), 2 + t * (-4 + t * (2.5 - 0.5 * t)))


def _keys_primitive(t: Floats) -> Floats:
    """Its integral from 0 to t, 1/2 from 2 on."""
    s = np.minimum(np.abs(t), 2.0)
    near = s * (1 + s**2 * (-5 / 6 + 3 / 8 * s))
    far = -1 / 6 + s * (2 + s * (-2 + s * (5 / 6 - s / 8)))
    return np.copysign(np.where(s < 1, near, far), t)


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
