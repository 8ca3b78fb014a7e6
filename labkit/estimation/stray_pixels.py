"""Pixels that no model explains: hot in the target's photographs alone, dead, or hit by a cosmic ray.

Every image is as wide as its point spread, so that a wrong optimum or an incomplete model leaves residuals on many pixels
alike. A few residuals that are far beyond all others are not the lens's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.estimation.likelihood import FrameData
from labkit.estimation.settings import SETTINGS
from labkit.types import Floats


@dataclass(frozen=True, slots=True)
class StrayPixel:
    """A pixel left out.

    Attributes
    ----------
    frame : place of the photograph in its observation
    row, column : in the cut
    residual_stds : counts above the model, in standard deviations of the pixel's noise
    """

    frame: int
    row: int
    column: int
    residual_stds: float


def stray_pixels(
    frames: Sequence[FrameData], predictions: Sequence[tuple[Floats, Floats]]
) -> tuple[StrayPixel, ...]:
    """Return the used pixels whose residuals are far beyond all others of their photograph.

    Parameters
    ----------
    frames : of one observation
    predictions : mean and standard deviation (pixels,) of each frame's used pixels, counts
    """
    strays = list[StrayPixel]()
    for place, (frame, (mean, std)) in enumerate(zip(frames, predictions, strict=True)):
        residuals = (frame.counts[frame.used] - mean) / std
        sizes = np.abs(residuals)
        few = max(SETTINGS.least_strays, int(SETTINGS.stray_share * sizes.size))
        if sizes.size <= few:
            continue
        usual = float(np.partition(sizes, -few - 1)[-few - 1])
        beyond = sizes > max(SETTINGS.stray_stds, SETTINGS.stray_ratio * usual)
        at = np.argwhere(frame.used)[beyond]
        strays += [
            StrayPixel(place, int(row), int(column), float(residual))
            for (row, column), residual in zip(at, residuals[beyond], strict=True)
        ]
    return tuple(strays)


def without_pixels(
    frames: Sequence[FrameData], strays: Sequence[StrayPixel]
) -> tuple[FrameData, ...]:
    """Return the frames with some pixels left out."""
    used = [frame.used.copy() for frame in frames]
    for stray in strays:
        used[stray.frame][stray.row, stray.column] = False
    return tuple(replace(one, used=mask) for one, mask in zip(frames, used, strict=True))
