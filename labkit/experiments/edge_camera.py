"""Simulate images of edges without the estimator's methods: no slice of a transfer function, no line-spread
function.

The two sides of a line are drawn as areas on samples several to a pixel, far beyond the
frame, convolved with a PSF from a finely sampled pupil whose window includes the halo, and
summed over each pixel's active square.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft

from labkit.optics.zernike import zernike
from labkit.types import Complexes, Floats

SAMPLES_OF_RIM = 3  # subsamples along a side of a pupil sample: its edge's grey
PERIODS = 2.5  # of the sampled pupil's field, in windows: what comes around is dark


@dataclass(frozen=True)
class EdgeCamera:
    """A camera with square pixels of full fill factor, and a frame of one plane of its filter array.

    wavelength_um, f_number: of light and lens; pitch_um: of the raw's pixels; step: raw
    pixels between neighbours of the plane; frame: the plane's samples along a side. finer:
    samples to a raw pixel, beyond the lens's Nyquist rate; reach_px: of the PSF's window
    and of the scene beyond the frame.
    """

    wavelength_um: float
    f_number: float
    pitch_um: float
    step: int = 1
    frame: int = 48
    finer: int = 8
    reach_px: int = 60

    @property
    def samples(self) -> int:
        """Along a side of the scene."""
        return (self.frame * self.step + 2 * self.reach_px) * self.finer

    def mean(
        self,
        angle: float,
        distance_px: float,
        sides: tuple[float, float],
        waves: Floats,
        noll: tuple[int, ...],
    ) -> Floats:
        """Return (frame, frame) radiance in the plane's pixels, the plane beginning at the raw's first pixel.

        angle: of the line's normal, radians from x (right) towards y (down); distance_px:
        of the line along the normal from the raw frame's middle; sides: radiance before and
        beyond. waves: (modes,) RMS at this wavelength.
        """
        at = (np.arange(self.samples) + 0.5) / self.finer - self.samples / self.finer / 2
        across = at[None, :] * np.cos(angle) + at[:, None] * np.sin(angle) - distance_px
        share = _covered(across * self.finer, abs(np.cos(angle)), abs(np.sin(angle)))
        spectrum = scipy.fft.rfft2(share - 0.5)
        seen = scipy.fft.irfft2(
            spectrum * _transfer(self, tuple(map(float, waves)), noll), share.shape
        )
        # what comes around the borders reaches up to the frame; the PSF's middle lies `reach` samples into its window
        first = 2 * self.reach_px * self.finer
        whole = self.frame * self.step
        place = (np.arange(whole * self.finer) + first) % self.samples
        cut = seen[np.ix_(place, place)]
        pixels = cut.reshape(whole, self.finer, whole, self.finer).mean(axis=(1, 3)) + 0.5
        return np.asarray(
            sides[0] + (sides[1] - sides[0]) * pixels[:: self.step, :: self.step]
        )

    def psf(self, waves: Floats, noll: tuple[int, ...]) -> Floats:
        """Return (2 reach + 1, same) samples: each sample's share of all light.

        Light beyond the window comes equally from both sides, and adds nothing to an image
        of zero mean radiance.
        """
        spacing = self.pitch_um / self.finer
        reach = self.reach_px * self.finer
        period = scipy.fft.next_fast_len(int(PERIODS * (2 * reach + 1)))
        radius = period * spacing / (2 * self.wavelength_um * self.f_number)
        half = int(radius) + 2
        fine = (
            (
                np.arange((2 * half + 1) * SAMPLES_OF_RIM)
                - ((2 * half + 1) * SAMPLES_OF_RIM - 1) / 2
            )
            / SAMPLES_OF_RIM
            / radius
        )
        fine = fine.astype(np.float32)
        inside = np.hypot(fine[:, None], fine[None, :]) < 1
        disc = inside.reshape(
            2 * half + 1, SAMPLES_OF_RIM, 2 * half + 1, SAMPLES_OF_RIM
        ).mean(axis=(1, 3))
        axis = np.arange(-half, half + 1) / radius
        rho = np.hypot(axis[:, None], axis)
        theta = np.arctan2(axis[:, None], axis)
        path = sum(
            (w * zernike(j, rho, theta) for w, j in zip(waves, noll, strict=True)),
            np.zeros_like(rho),
        )
        window = np.arange(-reach, reach + 1)
        rows = scipy.fft.fft(disc * np.exp(2j * np.pi * path), period, axis=0)[window]
        light = np.abs(scipy.fft.fft(rows, period, axis=1)[:, window]) ** 2
        return np.asarray(light / (period**2 * disc.sum()))


@lru_cache(maxsize=4)
def _transfer(
    camera: EdgeCamera, waves: tuple[float, ...], noll: tuple[int, ...]
) -> Complexes:
    """Return the transfer function of the PSF on the scene's samples."""
    return np.asarray(
        scipy.fft.rfft2(camera.psf(np.array(waves), noll), (camera.samples, camera.samples))
    )


def _covered(across: Floats, wide: float, high: float) -> Floats:
    """Return the share of unit squares beyond a line at distances `across` from their centres.

    The square's shadow along the normal is a trapezoid, the sum of two widths; the share is
    its integral.
    """
    long = max(wide, high)
    short = max(min(wide, high), 1e-9)

    def ramp(x: Floats) -> Floats:
        return np.maximum(x, 0.0) ** 2 / 2

    outer = (long + short) / 2
    inner = (long - short) / 2
    whole = (
        ramp(across + outer)
        - ramp(across + inner)
        - ramp(across - inner)
        + ramp(across - outer)
    )
    return np.asarray(whole / (long * short))
