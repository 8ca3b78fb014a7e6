"""Noise that neighbouring pixels share: a trace of noise reduction in raw data.

Photons and electronics give each pixel noise of its own. A filter, in the sensor or in the camera's software, makes a pixel's
variance small and its neighbours alike. A filter whose weights sum to one keeps the noise at frequency 0, which is the
variance times one plus the sum of all correlations.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labkit.types import Bools, Floats
from labkit.uncertain import Uncertain

FILTER_REACH_PX = 3
"""Largest distance, in pixels of one colour, at which a filter makes two pixels share noise."""

FAR_PX = range(8, 12)
"""Distances at which two pixels share the noise of a row or of a column, and none of a filter."""

SHARED_SIDE_PX = 600
"""Side of the middle of a frame, in pixels of one colour, that is looked at: enough for 1 %."""

Lag = tuple[int, int]


def shared_noise(
    stack: NDArray[np.uint16],
    used: Bools,
) -> tuple[Uncertain, int]:
    """Return the sum of the correlations of a pixel's noise with its neighbours', and the number of pixels.

    Parameters
    ----------
    stack : (frames, rows, columns) counts of one plane, two frames or more of equal light
    used : (rows, columns) pixels to take

    Notes
    -----
    Differences of successive frames have no fixed pattern. What rows and columns share at
    any distance is subtracted.
    """
    middle = tuple(
        slice(max(0, (n - SHARED_SIDE_PX) // 2), (n + SHARED_SIDE_PX) // 2)
        for n in used.shape
    )
    used = used[middle]
    pixels = int(np.count_nonzero(used))
    pairs = list(pairwise(stack))
    sums = [_correlations(_difference(a[middle], b[middle], used), used) for a, b in pairs]
    reach = range(-FILTER_REACH_PX, FILTER_REACH_PX + 1)
    half = [(0, k) for k in reach if k > 0]
    half += [(row, k) for row in reach if row > 0 for k in reach]
    far = len(FAR_PX)
    lags = np.array([1.0] * len(half) + [-FILTER_REACH_PX / far] * 2 * far)
    value = 2 * float(
        np.mean([[of[lag] for lag in half + _far()] for of in sums], 0) @ lags
    )
    std = 2 * np.sqrt(np.sum(lags**2) / max(pixels * len(pairs) / 2, 1))
    return Uncertain(value, (1 + abs(value)) * std), pixels


def _far() -> list[Lag]:
    """Return distances along a row, then along a column."""
    return [(0, k) for k in FAR_PX] + [(k, 0) for k in FAR_PX]


def _difference(
    one: Floats,
    other: Floats,
    used: Bools,
) -> Floats:
    """Return the noise of two frames, of unit variance, 0 elsewhere."""
    one = one.astype(np.float64)
    other = other.astype(np.float64)
    apart = np.where(used, one - other, 0.0)
    apart -= np.where(used, apart[used].mean(), 0.0) if used.any() else 0.0
    size = float(np.sqrt(np.mean(apart[used] ** 2))) if used.any() else 0.0
    return apart / size if size > 0 else apart


def _correlations(
    noise: Floats,
    used: Bools,
) -> dict[Lag, float]:
    """Return the mean product of the noise at two pixels, by their distance down and right."""
    rows, columns = noise.shape
    reach = range(-FILTER_REACH_PX, FILTER_REACH_PX + 1)
    found = {}
    for down in range(FILTER_REACH_PX + 1):
        for right in reach:
            found[down, right] = _mean_product(noise, used, (down, right))
    for lag in _far():
        found[lag] = _mean_product(noise, used, lag) if max(lag) < min(rows, columns) else 0
    return found


def _mean_product(
    noise: Floats,
    used: Bools,
    lag: Lag,
) -> float:
    """Return the mean product over pairs of used pixels at a distance."""
    down, right = lag
    rows, columns = noise.shape
    low = np.s_[: rows - down, max(0, -right) : columns - max(0, right)]
    high = np.s_[down:, max(0, right) : columns - max(0, -right)]
    pairs = int(np.count_nonzero(used[low] & used[high]))
    return float(np.vdot(noise[low], noise[high])) / max(pairs, 1)


def pooled(sums: Sequence[tuple[Uncertain, int]]) -> Uncertain:
    """Return the mean of sums of correlations, weighted by pixels."""
    weight = np.array([pixels for _, pixels in sums], float)
    weight /= max(weight.sum(), 1.0)
    value = sum(w * of.value for w, (of, _) in zip(weight, sums, strict=True))
    return Uncertain(
        value,
        np.sqrt(sum((w * of.std) ** 2 for w, (of, _) in zip(weight, sums, strict=True))),
    )
