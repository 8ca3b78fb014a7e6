"""The halo on a torus: the guard band that a PSF's window needs, and the light that comes around."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from labkit.imaging.grid import Torus
from labkit.imaging.scene import Scene
from labkit.imaging.warp import Pose
from labkit.imaging.window import fading
from labkit.optics.overlap import overlap_slopes, overlaps
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
def far_light(torus: Torus, pupil: Pupil) -> FarLight:
    """Return the light of a perfect lens beyond a PSF's window, kept for the next call."""
    return FarLight(torus, pupil)


class FarLight:
    """The light of a perfect lens beyond a PSF's window, beside that of the disc with the same halo.

    Light far away is told by the low frequencies of the transfer function, which the overlaps of the pupil with its copies are.
    Their departure from the disc's, cut off smoothly, less what the window has of this departure's light, is what the
    window lacks. All half planes of it grow as lambda N.
    """

    def __init__(self, torus: Torus, pupil: Pupil) -> None:
        self.torus, self.rim = torus, pupil.rim
        airy_um = pupil.wavelength_um * pupil.f_number
        even = np.linspace(0, np.pi, TABLE_ANGLES + 1)
        self._angles = np.union1d(even, _along_edges(pupil.rim))
        self._frequencies = np.linspace(0, LOW_BAND, TABLE_FREQUENCIES + 1)

        width = pupil.size * pupil.spacing_um / airy_um
        side = 2 * math.ceil(FOLDING * width * LOW_BAND)
        self._fine = self._places(
            scipy.fft.rfftfreq(side, 0.5 / LOW_BAND),
            scipy.fft.fftfreq(side, 0.5 / LOW_BAND)[:, None],
        )
        at = scipy.fft.fftfreq(side, 2 * LOW_BAND / side)
        self._inside = np.abs(at) < 0.5 * width
        at = at[self._inside]
        kept = fading(pupil.size) * smooth_edges_field(pupil.size) ** 2
        self._kept = np.interp(at / width + 0.5, np.arange(pupil.size) / pupil.size, kept)

        rows, columns = torus.row_frequency * airy_um, torus.column_frequency * airy_um
        self._low = np.ix_(np.abs(rows[:, 0]) < LOW_BAND, np.abs(columns[0]) < LOW_BAND)
        rows, columns = rows[self._low[0].ravel()], columns[:, self._low[1].ravel()]
        self._of_torus = self._places(columns, rows)
        self._turns = (
            np.exp(-2j * np.pi * rows * at),
            np.exp(-2j * np.pi * at[:, None] * columns),
        )

    @cached_property
    def beyond(self) -> Floats:
        """Half plane of what this light adds to that of the disc."""
        table = overlaps(self.rim, 2 * self._frequencies, self._angles)
        return self._beyond(table - diffraction_mtf(self._frequencies * self.rim.halo))

    def slopes(self, nearby: Sequence[tuple[Rim, Rim, float]]) -> Iterator[Floats]:
        """Yield half planes of the derivatives by numbers of the rim; the disc stays.

        nearby: for each number two neighbouring rims, and their distance in this number
        """
        tables = overlap_slopes(self.rim, nearby, 2 * self._frequencies, self._angles)
        return map(self._beyond, tables)

    def _beyond(self, table: Floats) -> Floats:
        """Return the half plane of the light beyond the window of a table (angles, frequencies) of its transfer function."""
        high = 0.5 - 0.5 * np.cos(np.pi * self._frequencies / LOW_BAND)
        table = table * (1 - high**2)
        half = map_coordinates(table, self._fine, order=1)
        light = scipy.fft.irfft2(half, (len(half), len(half)))
        within = (
            light[np.ix_(self._inside, self._inside)] * self._kept * self._kept[:, None]
        )
        beyond = np.zeros((self.torus.row_frequency.size, self.torus.column_frequency.size))
        beyond[self._low] = map_coordinates(table, self._of_torus, order=1)
        beyond[self._low] -= (self._turns[0] @ within @ self._turns[1]).real
        return beyond

    def _places(self, x: Floats, y: Floats) -> Floats:
        """Return places in tables, (2, ...), of frequencies x, y of 1/(lambda N), which broadcast."""
        x, y = np.broadcast_arrays(x, y)
        angle = np.interp(
            np.arctan2(y, x) % np.pi, self._angles, np.arange(len(self._angles))
        )
        return np.stack([angle, np.hypot(x, y) * (TABLE_FREQUENCIES / LOW_BAND)])


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
