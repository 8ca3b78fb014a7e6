"""Usual restorations to compare with: each colour interpolated to the scene's grid, then taken as blurred with even noise.

Richardson and Lucy, Wiener and total variation's denoising are scikit-image's, which does not know of mosaics, aliases, clipped
pixels, or light from beyond the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve

from labkit.errors import InputError
from labkit.restoration.grid import SceneGrid
from labkit.restoration.job import Job, transfer_on
from labkit.types import Floats, Floats32

RL_STEPS = 100
BLIND_ROUNDS, BLIND_STEPS, BLIND_PX = (
    8,
    12,
    3.0,
)  # rounds of picture and PSF; the first PSF's standard deviation, pixels
BALANCE = 1e-3  # of Wiener's roughness, for pictures of 0 to 1
TV_WEIGHT = 5e-4
TV_STEPS = 50
LEAST_RADIANCE = 1e-4  # of white: a multiplicative step never leaves 0


def baseline(job: Job, method: str) -> Floats32:
    """(colours, rows, columns) samples of the photograph, counts above black. Raises InputError without scikit-image."""
    restored = BASELINES[method]
    scenes = []
    for k in range(len(job.colours)):
        blurred = interpolated(job, k)
        white = _white(job, k)
        scenes.append(
            white
            * _framed(
                partial(restored, psf=psf_of(job, k)),
                blurred / white,
                job.guard_px * job.samples,
            )
        )
    return np.asarray(scenes, np.float32)


def interpolated(job: Job, component: int) -> Floats:
    """(rows, columns) samples of a colour of the first photograph: cubic splines through each plane, their mean."""
    photograph = job.photographs[0]
    colour = job.colours[component]
    fine = [np.arange(side * job.samples) / job.samples for side in job.shape]
    total = np.zeros(tuple(side.size for side in fine))
    for row, column in colour.places:
        plane = slice(row, None, job.period), slice(column, None, job.period)
        counts = _filled(
            photograph.counts[plane] / photograph.light[plane], photograph.used[plane]
        )
        at = np.meshgrid(
            (fine[0] - row) / job.period, (fine[1] - column) / job.period, indexing="ij"
        )
        total += ndimage.map_coordinates(counts, at, order=3, mode="nearest")
    return total / len(colour.places)


def psf_of(job: Job, component: int) -> Floats:
    """(n, n) of lens and pixel on the scene's samples, n odd, unit sum."""
    colour = job.colours[component]
    side = 2 * job.period * (2 * job.guard_px // job.period // 2 + 2)
    grid = SceneGrid((side, side), 0, job.pitch_um, job.samples, job.period)
    whole = np.fft.fftshift(grid.image(transfer_on(grid, colour.optics, colour.waves)))
    middle = [n // 2 for n in whole.shape]
    reach = job.guard_px * job.samples
    psf = whole[
        middle[0] - reach : middle[0] + reach + 1, middle[1] - reach : middle[1] + reach + 1
    ].clip(0)
    return np.asarray(psf / psf.sum(), float)


def richardson_lucy(blurred: Floats, psf: Floats, steps: int = RL_STEPS) -> Floats:
    """W. Richardson, J. Opt. Soc. Am. 62, 55 (1972)."""
    return np.asarray(
        _skimage("restoration").richardson_lucy(
            blurred.clip(LEAST_RADIANCE), psf, num_iter=steps, clip=False
        )
    )


def blind(blurred: Floats, psf: Floats, rounds: int = BLIND_ROUNDS) -> Floats:
    """Without the PSF but its size: picture and PSF in turn. D. Fish et al., J. Opt. Soc. Am. A 12, 58 (1995)."""
    side = np.arange(len(psf)) - len(psf) // 2
    guess = np.exp(-(side**2) / (2 * (len(psf) / 16) ** 2))
    guess = np.outer(guess, guess) / guess.sum() ** 2
    picture = np.full(blurred.shape, blurred.mean())
    data = blurred.clip(LEAST_RADIANCE)
    for _ in range(rounds):
        for _ in range(BLIND_STEPS):
            ratio = data / np.maximum(
                fftconvolve(picture, guess, mode="same"), LEAST_RADIANCE
            )
            picture *= fftconvolve(ratio, guess[::-1, ::-1], mode="same").clip(0)
        ratio = (
            data / np.maximum(fftconvolve(picture, guess, mode="same"), LEAST_RADIANCE) - 1
        )
        turned = fftconvolve(ratio, picture[::-1, ::-1], mode="same") / picture.sum()
        middle = [n // 2 for n in turned.shape]
        reach = len(psf) // 2
        shown = turned[
            middle[0] - reach : middle[0] + reach + 1,
            middle[1] - reach : middle[1] + reach + 1,
        ]
        guess = guess * (1 + shown).clip(0)
        guess /= guess.sum()
    return picture


def wiener(blurred: Floats, psf: Floats, balance: float = BALANCE) -> Floats:
    """scikit-image's, with its Laplacian."""
    return np.asarray(_skimage("restoration").wiener(blurred, psf, balance, clip=False))


def total_variation(blurred: Floats, psf: Floats, weight: float = TV_WEIGHT) -> Floats:
    """Least squares with total variation: gradient steps, each denoised by A. Chambolle's algorithm; accelerated.

    A. Beck and M. Teboulle, IEEE Trans. Image Process. 18, 2419 (2009).
    """
    denoise = _skimage("restoration").denoise_tv_chambolle
    scene = blurred.copy()
    ahead = blurred.copy()
    pace = 1.0
    for _ in range(TV_STEPS):
        apart = fftconvolve(ahead, psf, mode="same") - blurred
        moved = denoise(
            ahead - fftconvolve(apart, psf[::-1, ::-1], mode="same"),
            weight=weight,
            max_num_iter=30,
        )
        moved = np.asarray(moved).clip(0)
        faster = 0.5 * (1 + np.sqrt(1 + 4 * pace**2))
        ahead = moved + (pace - 1) / faster * (moved - scene)
        scene = moved
        pace = faster
    return scene


BASELINES: dict[str, Callable[..., Floats]] = {
    "richardson-lucy": richardson_lucy,
    "richardson-lucy-blind": blind,
    "wiener": wiener,
    "total-variation": total_variation,
}


def _framed(restored: Callable[[Floats], Floats], blurred: Floats, reach: int) -> Floats:
    """Restored with what lies beyond the frame mirrored."""
    reach = min(reach, min(blurred.shape) - 1)
    wide = restored(np.pad(blurred, reach, mode="reflect"))
    return wide[reach : reach + blurred.shape[0], reach : reach + blurred.shape[1]]


def _filled(counts: Floats, used: np.ndarray[Any, np.dtype[np.bool_]]) -> Floats:
    """Counts, those not used taken from the nearest that are."""
    if used.all():
        return counts.astype(float)
    nearest = ndimage.distance_transform_edt(
        ~used, return_distances=False, return_indices=True
    )
    return np.asarray(counts[tuple(nearest)], float)


def _white(job: Job, component: int) -> float:
    """A colour's brightest counts."""
    row, column = job.colours[component].places[0]
    counts = job.photographs[0].counts[row :: job.period, column :: job.period]
    return max(float(np.percentile(counts, 99.9)), 1.0)


def _skimage(part: str) -> Any:
    try:
        import skimage
    except ImportError as error:
        raise InputError(
            "other methods than labkit's own need scikit-image: pip install 'labkit[study]'"
        ) from error
    return getattr(skimage, part)
