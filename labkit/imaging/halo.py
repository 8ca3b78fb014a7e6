"""The halo on a torus: the guard band that a PSF's window needs, and the light that comes around."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from labkit.imaging.grid import Torus
from labkit.imaging.scene import Scene
from labkit.imaging.warp import Pose
from labkit.optics.psf import diffraction_mtf
from labkit.target.target import Target, on_dots
from labkit.types import Floats

POSE_MARGIN = (
    0.05  # of the target's size, by which it may stand or end elsewhere than the reference
)
DOT_PX = 10.0  # side of the points of light that stand for a target beyond the torus
HALO_PLACES = 5  # along each side of the frame, at which light from beyond is summed
HALO_FREQUENCY = 0.12  # cycles a pixel, at 1/e of a Gaussian: light from so far away is smooth, over tens of pixels
HALO_BAND = 0.45  # cycles a pixel: there the Gaussian has fallen to 1e-6


def perfect_lens(torus: Torus, airy_um: float) -> Floats:
    """Return the half plane of the transfer function of a perfect lens.

    airy_um: lambda N
    """
    return _symmetric(torus, lambda frequency: diffraction_mtf(frequency * airy_um))


def perfect_lens_slope(torus: Torus, airy_um: float) -> Floats:
    """Return the half plane of the derivative of `perfect_lens` by ln of lambda N."""

    def slope(frequency: Floats) -> Floats:
        nu = np.minimum(frequency * airy_um, 1.0)
        return np.asarray(-4 / np.pi * nu * np.sqrt(1 - nu**2))

    return _symmetric(torus, slope)


def _symmetric(torus: Torus, function: Callable[[Floats], Floats]) -> Floats:
    """Return the half plane of a function of the distance from frequency 0.

    Columns of opposite frequency share values.
    """
    columns, places = np.unique(np.abs(torus.column_frequency), return_inverse=True)
    return np.take(function(np.hypot(torus.row_frequency, columns)), places.ravel(), axis=1)


def guards(frame: tuple[int, int], reference: Pose, reach_px: float) -> tuple[int, int]:
    """Return the guard band along rows and columns, pixels, that keeps light within a reach from coming around.

    frame: (rows, columns). reference: approximate pose of the whole target; the dark area around
    the target may come around.
    """
    corners = reference.corners_px()
    stray = POSE_MARGIN * np.ptp(corners, axis=0)
    low = np.maximum(corners.min(axis=0) - stray, -reach_px)
    high = np.minimum(corners.max(axis=0) + stray, np.array(frame) + reach_px)
    rows, columns = np.maximum(np.maximum(-low, high - frame) + reach_px, 0.0)
    return math.ceil(rows), math.ceil(columns)


def light_beyond(torus: Torus, target: Target, whole: Pose) -> Floats | None:
    """Return the light (rows, columns) of the parts of a large target that are beyond a torus twice as large.

    It is that for a lambda N of one pixel, less that of the torus's own copies around it, which stand for these parts in
    `wrapped_light`; None for a target within. Far from its middle every PSF, averaged over its rings, is
    lambda N / (pi r)^3, as that of a perfect lens.

    Parameters
    ----------
    whole : pose of the whole target
    """
    sides = 2.0 * np.array(torus.pixels)
    first = -np.array(torus.margin) - sides / 4
    corners = whole.corners_px()
    if np.all(corners >= first) and np.all(corners <= first + sides):
        return None
    dots = np.ceil(2 * np.array(whole.pixel_per_unit()) / DOT_PX).astype(int)
    radiance = on_dots(target, (int(dots[0]), int(dots[1]))).ravel()
    y, x = (2 * (np.arange(n) + 0.5) / n - 1 for n in dots)
    there = whole.to_pixels(np.repeat(y, dots[1]), np.tile(x, dots[0]))
    dot_px = 4 * float(np.prod(whole.pixel_per_unit())) / float(np.prod(dots))
    within = np.all((there >= first) & (there < first + sides), axis=1)
    steps = [np.array(s) * sides for s in np.ndindex(3, 3) if s != (1, 1)]
    copies = [there[within] + step - sides for step in steps]
    sources = np.concatenate([there[~within], *copies])
    light = np.concatenate([radiance[~within], np.tile(-radiance[within], len(copies))])
    rows, columns = (np.linspace(0, side - 1, HALO_PLACES) for side in torus.frame)
    down = (rows[:, None] - sources[:, 0]) ** 2
    right = (columns[:, None] - sources[:, 1]) ** 2
    seen = [(d + right) ** -1.5 @ light for d in down]
    spline = RectBivariateSpline(rows, columns, dot_px / np.pi**3 * np.array(seen))
    every = [np.arange(side, dtype=np.float64) for side in torus.frame]
    return np.asarray(spline(every[0], every[1]))


def wrapped_light(
    torus: Torus, target: Target, reference: Pose, airy_um: float, active_um: float
) -> Floats:
    """Return the light of a perfect lens that comes around a torus to the frame (rows, columns).

    The unit is the target's radiance. This light is smooth and hardly depends on pose and
    wavefront. It is computed as the difference between two rough images, one on the torus, one on a
    torus twice as large.
    """
    rough = replace(torus, oversampling=1, band_limit_per_um=HALO_BAND / torus.pitch_um)
    twice = replace(
        rough,
        pixels=(2 * torus.pixels[0], 2 * torus.pixels[1]),
        margin=(
            torus.margin[0] + torus.pixels[0] // 2,
            torus.margin[1] + torus.pixels[1] // 2,
        ),
    )
    scene = Scene(twice, target, rough.band_limit_per_um, reference)
    pictures = []
    image = scene.image(reference)
    for each in (rough, twice):
        low = [wide - own for wide, own in zip(twice.margin, each.margin, strict=True)]
        shown = image[low[0] : low[0] + each.pixels[0], low[1] : low[1] + each.pixels[1]]
        smooth = np.exp(
            -(np.hypot(each.row_frequency, each.column_frequency) ** 2)
            * (torus.pitch_um / HALO_FREQUENCY) ** 2
        )
        pixel = np.sinc(each.row_frequency * active_um) * np.sinc(
            each.column_frequency * active_um
        )
        transfer = perfect_lens(each, airy_um) * pixel * smooth
        pictures.append(each.sample(each.half_spectrum(shown) * transfer))
    return np.asarray(pictures[0] - pictures[1])
