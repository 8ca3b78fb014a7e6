"""The thesis's aperture on a grid: each sample holds the area of the disc inside it (thesis, Appendix G)."""

import numpy as np

from labkit.arrays import positive, real_array
from labkit.types import Floats


def disc_area(offsets: Floats, radius: float) -> Floats:
    """Return the area of a disc inside each unit square of a grid, in closed form.

    Parameters
    ----------
    offsets : (n,), coordinates of the squares' centres along either axis from the disc's
        centre, samples
    radius : samples

    Returns
    -------
    (n, n), 0 to 1

    Raises
    ------
    ValueError
        for offsets of another shape or not finite, and for a radius that is not positive

    Notes
    -----
    Thesis (G.1)-(G.3).
    """
    offsets = real_array("offsets", offsets, (None,), "samples")
    positive("radius", radius, "samples")
    low = offsets - 0.5
    high = offsets + 0.5

    def corner(rows: Floats, columns: Floats) -> Floats:
        return _quadrant_area(columns[None, :], rows[:, None], radius)

    area = corner(high, high) - corner(low, high)
    area += corner(low, low) - corner(high, low)
    return np.clip(area, 0.0, 1.0)


def _quadrant_area(x: Floats, y: Floats, radius: float) -> Floats:
    """Return the area of the disc inside the rectangle from the centre to (x, y), odd in both x and y."""
    sign = np.sign(x) * np.sign(y)
    x = np.minimum(np.abs(x), radius)
    y = np.minimum(np.abs(y), radius)

    def half_chord(t: Floats) -> Floats:
        # the difference of the squares may round to below 0
        return np.asarray(np.sqrt((radius - t) * (radius + t)))

    def under_arc(t: Floats) -> Floats:
        return 0.5 * (t * half_chord(t) + radius**2 * np.arcsin(t / radius))

    flat = np.minimum(
        x, half_chord(y)
    )  # up to here the top of the rectangle is inside the disc
    return sign * (y * flat + under_arc(x) - under_arc(flat))
