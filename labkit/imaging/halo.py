"""The halo on a torus: the guard band that a PSF's window needs, and the light that comes around."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from labkit.imaging.grid import Torus
from labkit.imaging.scene import Scene
from labkit.imaging.warp import Pose
from labkit.imaging.window import fading
from labkit.optics.overlap import overlaps
from labkit.optics.psf import Pupil, diffraction_mtf, smooth_edges_field
from labkit.optics.rim import Rim
from labkit.target import Target
from labkit.types import Floats

POSE_MARGIN = (
    0.05  # of the target's size, by which it may stand or end elsewhere than the reference
)
HALO_FREQUENCY = 0.12  # cycles a pixel, at 1/e of a Gaussian: light from so far away is smooth, over tens of pixels
LOW_BAND = 0.25  # of the cutoff: frequencies that tell of light beyond a window
TABLE_ANGLES, TABLE_FREQUENCIES = 180, 64  # of a table of them
FOLDING = 4  # windows, after which this light folds: 0.3 % of it at a window's borders
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


@lru_cache(maxsize=4)
def halo_beyond(torus: Torus, pupil: Pupil) -> Floats:
    """Return the half plane of what a perfect lens's light beyond the window adds to that of the disc with the same halo.

    It grows as lambda N. Light far away is told by the low frequencies of the transfer function, which the overlaps of the
    pupil with its copies are: its departure from the disc's, less what a window has of this departure's light.
    """
    airy_um = pupil.wavelength_um * pupil.f_number
    departure = _LowDeparture(pupil.rim)
    width = pupil.size * pupil.spacing_um / airy_um
    side = 2 * math.ceil(FOLDING * width * LOW_BAND)
    rows = scipy.fft.fftfreq(side, 0.5 / LOW_BAND)[:, None]
    columns = scipy.fft.rfftfreq(side, 0.5 / LOW_BAND)
    light = scipy.fft.irfft2(departure(columns, rows), (side, side))
    at = scipy.fft.fftfreq(side, 2 * LOW_BAND / side)
    inside = np.abs(at) < 0.5 * width
    at = at[inside]
    kept = fading(pupil.size) * smooth_edges_field(pupil.size) ** 2
    kept = np.interp(at / width + 0.5, np.arange(pupil.size) / pupil.size, kept)
    within = light[np.ix_(inside, inside)] * kept * kept[:, None]

    rows, columns = torus.row_frequency * airy_um, torus.column_frequency * airy_um
    low = np.abs(rows[:, 0]) < LOW_BAND, np.abs(columns[0]) < LOW_BAND
    rows, columns = rows[low[0]], columns[:, low[1]]
    turns = np.exp(-2j * np.pi * rows * at), np.exp(-2j * np.pi * at[:, None] * columns)
    beyond = np.zeros((torus.row_frequency.size, torus.column_frequency.size))
    beyond[np.ix_(*low)] = departure(columns, rows) - (turns[0] @ within @ turns[1]).real
    return beyond


class _LowDeparture:
    """The departure of a perfect lens's transfer function from that of the disc with the same halo, at low frequencies.

    It is cut off smoothly. rim: of the pupil
    """

    def __init__(self, rim: Rim) -> None:
        self.angles = np.union1d(np.linspace(0, np.pi, TABLE_ANGLES + 1), _along_edges(rim))
        frequencies = np.linspace(0, LOW_BAND, TABLE_FREQUENCIES + 1)
        high = 0.5 - 0.5 * np.cos(np.pi * frequencies / LOW_BAND)
        self.table = overlaps(rim, 2 * frequencies, self.angles)
        self.table -= diffraction_mtf(frequencies * rim.halo)
        self.table *= 1 - high**2

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return the departure at frequencies x, y of 1/(lambda N), which broadcast."""
        x, y = np.broadcast_arrays(x, y)
        frequency = np.hypot(x, y) * (TABLE_FREQUENCIES / LOW_BAND)
        angle = np.interp(
            np.arctan2(y, x) % np.pi, self.angles, np.arange(len(self.angles))
        )
        return map_coordinates(self.table, (angle, frequency), order=1)


def _along_edges(rim: Rim) -> Floats:
    """Return directions along a rim's edges: the contrast along straight ones is an edge of the table."""
    outline = rim.edges(2 * TABLE_ANGLES)[0] @ (1, 1j)
    return np.unique(np.round(np.angle(np.diff(outline[::8])) % np.pi, 6))


def guards(frame: tuple[int, int], reference: Pose, reach_px: float) -> tuple[int, int]:
    """Return the guard band along rows and columns, pixels, that keeps light within a reach from coming around.

    frame: (rows, columns). reference: approximate pose of the target; the dark area around
    the target may come around.
    """
    corners = reference.corners_px()
    stray = POSE_MARGIN * np.ptp(corners, axis=0)
    low = np.maximum(corners.min(axis=0) - stray, -reach_px)
    high = np.minimum(corners.max(axis=0) + stray, np.array(frame) + reach_px)
    rows, columns = np.maximum(np.maximum(-low, high - frame) + reach_px, 0.0)
    return math.ceil(rows), math.ceil(columns)


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
