"""Spread a point of light on the simulated sensor: diffraction at all wavelengths, filter, diffusion, smear,
glare.

All steps work in space: wavelengths are summed as PSFs, and each displacement of light is a
few places on the fine samples. A windowed sinc places light between samples, exactly for a
PSF sampled at Nyquist's rate or finer. Bilinear shares would act as a filter of their own,
by 1 - cos(pi w / samples) at w cycles per pixel, which is 13 % at one cycle and six
samples.

Written without labkit.optics and labkit.imaging, which it tests.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import scipy.signal

from labkit.drivers.simulated.optics import (
    REFERENCE_NM,
    halo_beyond,
    point_spread,
    working_f_number,
)
from labkit.drivers.simulated.parts import LowPassFilter, Smear, Veil
from labkit.drivers.simulated.scene import FineGrid, SceneTransform, from_pixel_to_pixel
from labkit.drivers.simulated.world import BenchSettings, TrueLens
from labkit.types import Floats, Floats32

SINC_REACH, SINC_BETA = 32, 9.0
"""Half the width of the windowed sinc, samples, and Kaiser's beta: the response is within 4e-5 of unity up to nine
tenths of Nyquist's frequency, where the contrast of a PSF is 0.01 and with the pixel 0.0005."""

FARTHEST_PX = 640
"""Light is not followed farther than this: of an f/2.8 lens on pixels of 5 um less than 1e-4 goes beyond."""

GAUSSIAN_REACH = 6.0
"""In sigmas: 2e-9 of a Gaussian is beyond."""


def psf_and_halo(
    settings: BenchSettings, colour: str, waves: Mapping[int, float], grid: FineGrid
) -> tuple[Floats32, Floats32]:
    """Return a colour's PSF on the fine samples, (2 reach + 1, 2 reach + 1), and the light beyond from pixel to
    pixel.

    waves: {Noll mode: waves RMS at REFERENCE_NM} at the colour's wavelength_nm. Shares of
    all light without glare.
    """
    lens = settings.lens
    sensor = settings.sensor
    # the halo grows as the wavelength does: a mean of halos is that of the mean wavelength
    mean_nm = sum(nm * share for nm, share in lens.lines_in(colour))
    halo = halo_beyond(
        mean_nm,
        _cone(lens, colour),
        sensor.pitch_um / grid.samples,
        grid.reach,
        grid.samples,
        min(max(sensor.rows, sensor.cols), FARTHEST_PX),
        lens.pupil,
    )
    return near_psf(settings, colour, waves, grid), halo


def near_psf(
    settings: BenchSettings, colour: str, waves: Mapping[int, float], grid: FineGrid
) -> Floats32:
    """Return a colour's PSF on the fine samples alone, as `psf_and_halo`."""
    lens = settings.lens
    sensor = settings.sensor
    psf: Floats32 = np.zeros(2 * (2 * grid.reach + 1,), dtype=np.float32)
    for nm, share in lens.lines_in(colour):
        here = {**waves, 4: waves.get(4, 0.0) + lens.defocus_within(colour, nm)}
        psf += np.float32(share) * point_spread(
            here,
            nm,
            _cone(lens, colour),
            sensor.pitch_um / grid.samples,
            grid.reach,
            REFERENCE_NM,
            lens.pupil,
        )
    kernel = aside(sensor.low_pass, sensor.diffusion_px, settings.rail.smear, grid.samples)
    if kernel.size > 1:
        psf = scipy.signal.fftconvolve(psf, kernel, mode="same").astype(np.float32)
    return psf


def _cone(lens: TrueLens, colour: str) -> float:
    """Return the f-number of a colour's cone at the sensor."""
    return working_f_number(
        lens.f_number_in(colour),
        lens.best_focus_mm[colour],
        lens.focal_length_in(colour),
        lens.pupil_magnification,
    )


@lru_cache(maxsize=8)
def aside(
    low_pass: LowPassFilter, diffusion_px: float, smear: Smear, samples: int
) -> Floats32:
    """Return the shares of a point's light on the fine samples around, (n, n), n odd, centred, of unit sum;
    [[1]] if all stays.

    diffusion_px: sigma of a Gaussian; samples: to a pixel. Read-only. Raises ValueError for
    a negative sigma.
    """
    if diffusion_px < 0:
        raise ValueError(f"charge diffuses by 0 pixels or more, not {diffusion_px:g}")
    places, shares = _along_the_smear(smear, samples)
    spots = np.unique(low_pass.spots_px, axis=0)
    down, right = ((spots[:, None, :] + places) * samples).reshape(-1, 2).T
    if not (diffusion_px or down.any() or right.any()):
        return np.ones((1, 1), dtype=np.float32)
    weights = np.tile(shares, len(spots)) / len(spots)
    farthest = (
        max(np.abs(down).max(), np.abs(right).max())
        + GAUSSIAN_REACH * diffusion_px * samples
    )
    around = np.arange(-(reach := SINC_REACH + int(np.ceil(farthest))), reach + 1)
    marks = [_marks(around, places, diffusion_px * samples) for places in (down, right)]
    kernel: Floats32 = ((marks[0].T * weights) @ marks[1]).astype(np.float32)
    kernel.flags.writeable = False
    return kernel


def _along_the_smear(smear: Smear, samples: int) -> tuple[Floats, Floats]:
    """Return places (n, 2) down and right, pixels, and their Gauss shares, enough for the samples' frequencies."""
    if not smear.length_px:
        return np.zeros((1, 2)), np.ones(1)
    nodes, weights = np.polynomial.legendre.leggauss(
        16 + int(np.ceil(2 * smear.length_px * samples))
    )
    angle = np.radians(smear.direction_deg)
    return nodes[:, None] * smear.length_px / 2 * np.array(
        [np.sin(angle), np.cos(angle)]
    ), weights / 2


def _marks(
    around: np.ndarray[tuple[int], np.dtype[np.int_]], places: Floats, sigma: float
) -> Floats:
    """Return the light of each place on samples, (places, samples), blurred by a Gaussian of sigma samples; of
    unit sums.

    The sum is over points of the Gaussian, not over cells: the PSF's samples hold no cell's
    mean, and a cell's width would add a twelfth of its square to sigma's.
    """
    if not sigma:
        return _sinc(around - places[:, None])
    step = min(sigma / 3, 0.5)
    points = np.arange(-(n := int(np.ceil(GAUSSIAN_REACH * sigma / step))), n + 1) * step
    weights = np.exp(-((points / sigma) ** 2) / 2)
    alike, which = np.unique(places, return_inverse=True)
    laid = _sinc(around - alike[:, None, None] - points[:, None])
    marks: Floats = (np.einsum("q,pqi->pi", weights, laid) / weights.sum())[which]
    return marks


def _sinc(x: Floats) -> Floats:
    """Return Kaiser's windowed sinc at samples' distances, its last axis of unit sum."""
    inside = np.sqrt(np.clip(1 - (x / SINC_REACH) ** 2, 0, None))
    sinc = np.where(
        inside > 0, np.sinc(x) * np.i0(SINC_BETA * inside) / np.i0(SINC_BETA), 0.0
    )
    return np.asarray(sinc / sinc.sum(axis=-1, keepdims=True))


def veiled(seen: Floats32, scene: SceneTransform, veil: Veil) -> Floats32:
    """Return an image of a scene, (rows, cols), with some of its light spread as veiling glare."""
    if not veil.fraction:
        return seen
    share = np.float32(veil.fraction)
    return (1 - share) * seen + share * from_pixel_to_pixel(
        scene, _veil(veil, max(seen.shape))
    )


def _veil(veil: Veil, pixels: int) -> Floats32:
    """Return (2 pixels + 1, 2 pixels + 1) shares of the glare, centred, of unit sum."""
    offset = np.arange(-pixels, pixels + 1) / veil.scale_px
    radius = np.hypot(offset[:, None], offset)
    shares = np.exp(-radius if veil.shape == "exponential" else -(radius**2) / 2)
    return np.asarray(shares / shares.sum(), dtype=np.float32)
