"""Simulate images of a carpet without the estimator's methods: no raster, no splines, no closed form of the
halo.

The carpet's Fourier transform is a product of cosines for every affine pose. The lens's
transfer function is the autocorrelation of a finely sampled pupil, halo included. Pixels
pick their samples from the inverse transform.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from labkit.optics.zernike import zernike
from labkit.types import Floats

PUPIL_FINER = 4  # pupil samples to a frequency of the picture: its staircase edge moves the transfer function by 1e-4


@dataclass(frozen=True)
class Camera:
    """A mono camera with square pixels whose whole area is active.

    wavelength_um, f_number: of light and lens. pitch_um: of the pixels. pixels: along a side of the periodic picture, of
    which the frame, along a side, is the middle. oversampling: samples to a pixel, enough for the lens's band.
    """

    wavelength_um: float
    f_number: float
    pitch_um: float
    pixels: int
    frame: int
    oversampling: int

    def mean(
        self,
        order: int,
        centre: Floats,
        sides: Floats,
        waves: Floats,
        noll: tuple[int, ...],
    ) -> Floats:
        """Return (frame, frame) each pixel's share of the target's white.

        order: of the carpet, white squares on black. centre: (2,) pixel (row, col) of its
        middle, in the frame. sides: (2, 2) its sides in pixels, columns the carpet's own y
        and x. waves: (modes,) RMS at this wavelength.
        """
        fine = self.pixels * self.oversampling
        rows, columns = scipy.fft.rfftfreq(fine)[:, None], scipy.fft.fftfreq(fine)[None, :]
        rows, columns = columns.T, rows.T  # the half axis is the last one
        affine = np.asarray(sides, float) * self.oversampling
        where = (np.asarray(centre) + (self.pixels - self.frame) // 2) * self.oversampling
        along_y, along_x = (affine[0, k] * rows + affine[1, k] * columns for k in (0, 1))
        carpet = abs(np.linalg.det(affine)) * white_transform(order, along_y, along_x)
        carpet = carpet * np.exp(-2j * np.pi * (where[0] * rows + where[1] * columns))
        pixel = np.sinc(rows * self.oversampling) * np.sinc(columns * self.oversampling)
        image = scipy.fft.irfft2(
            carpet * pixel * self.transfer(waves, noll), s=(fine, fine)
        )
        first = (self.pixels - self.frame) // 2 * self.oversampling
        last = first + self.frame * self.oversampling
        return np.asarray(
            image[first : last : self.oversampling, first : last : self.oversampling]
        )

    def transfer(self, waves: Floats, noll: tuple[int, ...]) -> Floats:
        """Return the (fine, fine // 2 + 1) transfer function of the lens at the image's frequencies."""
        fine = self.pixels * self.oversampling
        radius = (
            PUPIL_FINER
            * self.pixels
            * self.pitch_um
            / (2 * self.wavelength_um * self.f_number)
        )
        half = int(radius)
        axis = np.arange(-half, half + 1) / radius
        rho = np.hypot(axis[:, None], axis)
        theta = np.arctan2(axis[:, None], axis)
        path = sum(
            (w * zernike(j, rho, theta) for w, j in zip(waves, noll, strict=True)),
            np.zeros_like(rho),
        )
        pupil = (rho <= 1) * np.exp(2j * np.pi * path)
        size = scipy.fft.next_fast_len(2 * len(axis))
        # the field is the forward transform of the pupil, the transfer function that of its intensity
        intensity = np.abs(scipy.fft.fft2(pupil, (size, size))) ** 2
        lags = scipy.fft.rfft2(intensity) / intensity.sum()
        row, column = np.arange(fine), np.arange(fine // 2 + 1)
        row = np.where(row > fine // 2, row - fine, row) * PUPIL_FINER
        known = np.abs(row) <= 2 * half, column * PUPIL_FINER <= 2 * half
        transfer = np.zeros((fine, fine // 2 + 1), complex)
        transfer[np.ix_(*known)] = lags[
            np.ix_(row[known[0]] % size, column[known[1]] * PUPIL_FINER)
        ]
        return transfer


def white_transform(order: int, y: Floats, x: Floats) -> Floats:
    """Return the Fourier transform of a carpet's white squares, the carpet one unit wide about the origin.

    The black cells are eight of nine thirds, again and again; the white ones are the rest.
    y, x: frequencies, broadcast together.
    """
    whole = np.sinc(y) * np.sinc(x)
    black = np.sinc(y / 3**order) * np.sinc(x / 3**order) / 9**order
    for level in range(1, order + 1):
        at_y = 2 * np.pi * y / 3**level
        at_x = 2 * np.pi * x / 3**level
        black = black * ((1 + 2 * np.cos(at_y)) * (1 + 2 * np.cos(at_x)) - 1)
    return np.asarray(whole - black)
