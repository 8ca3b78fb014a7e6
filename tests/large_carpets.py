"""Photographs of large carpets, formed without labkit's model: points of the carpet, a pupil's own transform, a pixel's box.

Only stated rectangles are formed so; the rest of the photograph is points of the carpet, for a finder.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft

from labkit.drivers.simulated.field import Distortion
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Complexes, Floats

PITCH_UM, AIRY_UM = 5.0, 0.54 * 4.0
"""Pitch of the pixels, which are active all over, and lambda N."""

MANY, FINER = 5, 5
"""Samples along a side of a pixel, and points along a side of a sample."""

REACH_PX = 100
"""Around a rectangle: light from farther away is smooth."""

PUPIL_SUBSAMPLES = 4


def carpet_points(
    order: int,
    corners: Floats,
    rows: Floats,
    cols: Floats,
    lens: Distortion | None = None,
) -> Floats:
    """Radiance of a black-cornered carpet at pixels; its corners (4, 2) without distortion are those of a parallelogram."""
    y, x = rows[:, None], cols[None]
    if lens is not None:
        x, y = lens.straight(x, y)
    across = corners[1] - corners[0]
    down = corners[3] - corners[0]
    back = np.linalg.inv(np.stack([down, across], axis=1))
    cells = carpet_cells(order)
    at = y - corners[0][0], x - corners[0][1]
    y, x = (np.floor((a * at[0] + b * at[1]) * len(cells)).astype(int) for a, b in back)
    inside = (y >= 0) & (y < len(cells)) & (x >= 0) & (x < len(cells))
    last = len(cells) - 1
    return np.where(inside, cells[np.clip(y, 0, last), np.clip(x, 0, last)], 0.0)


def _transfer(side: int, waves: Sequence[float]) -> Complexes:
    """Half plane of the transfer function of (defocus, astigmatism, coma) in Noll's modes 4 to 8, pixel and samples."""
    spacing = PITCH_UM / MANY
    radius = side * spacing / (2 * AIRY_UM)
    half = int(radius) + 2
    count = (2 * half + 1) * PUPIL_SUBSAMPLES
    fine = (np.arange(count) - (count - 1) / 2) / PUPIL_SUBSAMPLES / radius
    disc = (np.hypot(fine[:, None], fine) < 1).astype(float)
    disc = disc.reshape(2 * half + 1, PUPIL_SUBSAMPLES, -1, PUPIL_SUBSAMPLES).mean((1, 3))
    y, x = np.arange(-half, half + 1)[:, None] / radius, np.arange(-half, half + 1) / radius
    s = x**2 + y**2
    modes = (
        np.sqrt(3) * (2 * s - 1),
        np.sqrt(6) * 2 * x * y,
        np.sqrt(6) * (x**2 - y**2),
        np.sqrt(8) * (3 * s - 2) * y,
        np.sqrt(8) * (3 * s - 2) * x,
    )
    path = sum(w * mode for w, mode in zip(waves, modes, strict=True))
    pupil = np.zeros((side, side), complex)
    pupil[: 2 * half + 1, : 2 * half + 1] = disc * np.exp(2j * np.pi * path)
    psf = np.abs(scipy.fft.fft2(pupil)) ** 2 / (side**2 * disc.sum())
    rows, cols = scipy.fft.fftfreq(side)[:, None], scipy.fft.rfftfreq(side)
    # the pixel's box, without that of a sample, which its points have; half a sample from its corner to its centre
    box = [np.sinc(f * MANY) / np.sinc(f) for f in (rows, cols)]
    turn = np.exp(1j * np.pi * (MANY - 1) * (rows + cols))
    return np.asarray(scipy.fft.rfft2(psf) * box[0] * box[1] * turn)


def large_carpet(
    order: int,
    corners: Floats,
    shape: tuple[int, int],
    rectangles: Sequence[tuple[int, int, int, int]],
    waves: Sequence[float],
    lens: Distortion | None = None,
) -> Floats:
    """Relative light of a photograph. rectangles: first row and column, last row and column of what is formed right."""
    rows, cols = (np.arange(side, dtype=float) for side in shape)
    seen = carpet_points(order, corners, rows, cols, lens)
    for top, left, bottom, right in rectangles:
        size = scipy.fft.next_fast_len(max(bottom - top, right - left) + 2 * REACH_PX)
        step = 1 / (MANY * FINER)
        rows, cols = (
            first - REACH_PX - 0.5 + (np.arange(size * MANY * FINER) + 0.5) * step
            for first in (top, left)
        )
        samples = np.concatenate(
            [
                carpet_points(order, corners, block, np.asarray(cols), lens)
                .reshape(len(block) // FINER, FINER, -1, FINER)
                .mean((1, 3))
                for block in np.split(rows, size)
            ]
        )
        spectrum = scipy.fft.rfft2(samples) * _transfer(len(samples), waves)
        pixels = scipy.fft.irfft2(spectrum, samples.shape)[::MANY, ::MANY]
        seen[top:bottom, left:right] = pixels[
            REACH_PX : REACH_PX + bottom - top, REACH_PX : REACH_PX + right - left
        ]
    return seen
