"""Photographs formed without labkit's model: points of the target, linear convolution, no torus and no spectra of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.signal import fftconvolve

from labkit.imaging.optics import Optics
from labkit.target.target import CellTarget
from labkit.types import Floats

CARPET = CellTarget(
    np.kron(np.array([[0.0, 1, 0], [1, 0, 1], [0, 0, 1]]), np.ones((3, 3))),
    (30.0, 30.0),
    0.0,
)
CORNERS = np.array([[11.3, 12.1], [10.2, 41.7], [40.8, 42.9], [42.1, 11.4]])
OPTICS = Optics(
    wavelength_nm=550.0,
    reference_nm=450.0,
    f_number=8.0,
    pitch_um=4.8,
    active_um=4.5,
    noll=(4, 6, 7, 8, 11),
)
WAVES = np.array([0.22, -0.05, 0.06, -0.04, 0.03])
FRAME = (54, 56)


def points_seen(rows: Floats, cols: Floats) -> Floats:
    """Radiance at pixel coordinates: a homography solved from the corners here, without labkit's."""
    own = np.array([[-15.0, -15], [-15, 15], [15, 15], [15, -15]])
    system, right = [], []
    for (r, c), (y, x) in zip(CORNERS, own, strict=True):
        system += [[r, c, 1, 0, 0, 0, -r * y, -c * y], [0, 0, 0, r, c, 1, -r * x, -c * x]]
        right += [y, x]
    h = np.append(np.linalg.solve(np.array(system), np.array(right)), 1.0)
    w = h[6] * rows + h[7] * cols + 1
    return CARPET.radiance(
        (h[0] * rows + h[1] * cols + h[2]) / w, (h[3] * rows + h[4] * cols + h[5]) / w
    )


def direct_psf(spacing_um: float, size: int, waves: Floats = WAVES) -> Floats:
    """(size, size) PSF from a pupil of its own, modes written out as Noll has them."""
    radius = size * spacing_um / (2 * 0.55 * 8.0)
    half, many = int(radius) + 2, 5
    fine = (
        (np.arange((2 * half + 1) * many) - (2 * half * many + many - 1) / 2)
        / many
        / radius
    )
    disc = (
        (np.hypot(fine[:, None], fine) < 1)
        .reshape(2 * half + 1, many, 2 * half + 1, many)
        .mean(axis=(1, 3))
    )
    y, x = (
        np.arange(-half, half + 1)[:, None] / radius,
        np.arange(-half, half + 1)[None] / radius,
    )
    s = x**2 + y**2
    path = (
        waves[0] * np.sqrt(3) * (2 * s - 1)
        + waves[1] * np.sqrt(6) * (x**2 - y**2)
        + waves[2] * np.sqrt(8) * (3 * s - 2) * y
        + waves[3] * np.sqrt(8) * (3 * s - 2) * x
        + waves[4] * np.sqrt(5) * (6 * s**2 - 6 * s + 1)
    )
    pupil = np.zeros((size, size), complex)
    pupil[: 2 * half + 1, : 2 * half + 1] = disc * np.exp(2j * np.pi * 0.45 / 0.55 * path)
    psf = np.fft.fftshift(np.abs(np.fft.fft2(pupil)) ** 2)
    # by the light through the disc: its grey edge squared sums to less, 1/(3 radius) of it, which by the PSF's own sum
    # would brighten whatever is finer than the window
    return np.asarray(psf / (size**2 * disc.sum()))


@cache
def brute_force_mean(
    light: Callable[[Floats, Floats], Floats] | None = None, many: int = 12, finer: int = 4
) -> Floats:
    """Supersampled radiance, linear convolution with PSF and pixel box, no torus and no spectra.

    light: by which the target's places shine, of rows and columns in pixels.
    """
    spacing_um, guard = 4.8 / many, 40
    step = 1 / (many * finer)
    rows, cols = (
        np.asarray(-0.5 + (np.arange(n * many * finer) + 0.5) * step) for n in FRAME
    )
    down, right = rows[:, None], cols[None]
    seen = points_seen(down, right)
    if light is not None:
        seen *= light(down, right)
    shape = FRAME[0] * many, FRAME[1] * many
    inside = seen.reshape(shape[0], finer, shape[1], finer).mean(axis=(1, 3))
    # the target ends within the frame, and nothing shines around it
    scene = np.pad(inside, guard * many)
    psf = direct_psf(spacing_um, 1600)
    blurred = fftconvolve(scene, psf[1:, 1:], mode="same")  # odd, its centre in the middle
    # the active square, 4.5 of 4.8 um: whole samples and a share of the next on either side
    share = (4.5 / spacing_um - 11) / 1
    box = (
        np.pad(np.ones(many - 1), 1)
        if share <= 0
        else np.pad(np.ones(11), 1, constant_values=share / 2)
    )
    box /= box.sum()
    # samples lie at (k + 1/2)/many - 1/2 of a pixel: a pixel's centre is between two of them
    level = fftconvolve(
        fftconvolve(blurred, box[:, None], mode="same"), box[None], mode="same"
    )
    centre = guard * many + many // 2
    at = [np.arange(n) * many + centre for n in FRAME]
    a, b = np.ix_(at[0], at[1])
    return np.asarray(
        (level[a, b] + level[a - 1, b] + level[a, b - 1] + level[a - 1, b - 1]) / 4
    )
