"""The light of a perfect lens beyond a PSF's window: along the spikes of blades, and across the long edges of a cat's eye."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from labkit.imaging.grid import Torus
from labkit.imaging.window import fading
from labkit.optics.overlap import overlap_slopes, overlaps
from labkit.optics.psf import Pupil, diffraction_mtf, smooth_edges_field
from labkit.optics.rim import Rim
from labkit.types import Floats

LOW_BAND = 0.25  # of the cutoff: frequencies that tell of light beyond a window
TABLE_ANGLES, TABLE_FREQUENCIES = 180, 64  # of a table of them
FOLDING = 4  # windows, after which this light folds: 0.3 % of it at a window's borders


@lru_cache(maxsize=4)
def far_light(torus: Torus, pupil: Pupil) -> FarLight:
    """Return the light of a perfect lens beyond a PSF's window, kept for the next call."""
    return FarLight(torus, pupil)


class FarLight:
    """The light of a perfect lens beyond a PSF's window, beside that of the disc with the same halo.

    Light far away is told by the low frequencies of the transfer function, which the overlaps of the pupil with its copies are.
    Their departure from the disc's, cut off smoothly, less what the window has of this departure's light, is what the
    window lacks. All half planes of it grow as lambda N.

    torus: of the picture; pupil: with the window
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
        disc = diffraction_mtf(self._frequencies * self.rim.halo)
        return self._beyond(self._common - disc)

    @cached_property
    def _common(self) -> Floats:
        return overlaps(self.rim, 2 * self._frequencies, self._angles)

    def slopes(self, nearby: Sequence[tuple[Rim, Rim, float]]) -> Iterator[Floats]:
        """Yield half planes of the derivatives by numbers of the rim; the disc stays.

        nearby: for each number two neighbouring rims, and their distance in this number
        """
        tables = overlap_slopes(
            self.rim, nearby, 2 * self._frequencies, self._angles, self._common
        )
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
