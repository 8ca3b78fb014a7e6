"""Photon transfer: counts per electron and read noise from differences between repeated frames.

A pixel of mean signal S counts has variance g S + σ² + 1/12: photon noise of gain g (counts
per electron), read noise σ (counts), and the rounding to whole counts. Differences between
frames of the same scene show this variance without the fixed pattern (Janesick, *Photon
Transfer*, SPIE 2007; the Σ of thesis (3.5)).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from labkit.types import Floats

ROUNDING_VARIANCE = 1.0 / 12.0
"""Variance of rounding to whole counts; it is part of every frame's noise and of no `read_noise`."""

UNKNOWN_NOISE_STD = 2.0
"""Relative standard error of a gain or read variance that no flat or dark shows."""

ELECTRONS_AT_WHITE = 40_000
"""Full well of a usual pixel: the gain where no flat shows it."""

WHITE_PER_READ_NOISE = 4000
"""Dynamic range of a usual pixel: the read noise where no dark shows it."""

OUTLIER_PROBABILITY = 1e-6
"""Pixels noisier than this leaves to chance are left out: particles, telegraph noise, a light switched."""

FLOOR_SHARE = 0.03
"""Without darks: prior standard deviation of the variance at no light, as a share of that in the brightest flats. One
level of light alone does not separate the two."""


def usual_gain(white: float) -> float:
    """Return the gain of a usual sensor, counts per electron.

    white: counts above black at saturation
    """
    return white / ELECTRONS_AT_WHITE


def usual_read_variance(white: float) -> float:
    """Return the variance of a usual sensor's read noise, counts squared, rounding included.

    white: as of `usual_gain`
    """
    return max(1.0, (white / WHITE_PER_READ_NOISE) ** 2)


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of pixels from frame to frame: mean signal and variance of each (m,), and frames minus one."""

    signal: Floats
    variance: Floats
    freedom: int


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Gain (counts per electron) and read noise (counts, without the rounding to whole counts, whose variance is 1/12).

    gain_std, read_noise_std: standard errors in the same units, absolute. None = unknown.
    """

    gain: float | None
    gain_std: float | None
    read_noise: float | None
    read_noise_std: float | None


def scatter_of(stack: ArrayLike, *, lit: bool) -> Scatter:
    """Return per-pixel mean and variance of at least two frames of the same scene.

    Changes that all pixels of a frame share are not noise: in lit frames the light varies
    by a few per cent, in dark frames the offset drifts. stack: (frames, m) counts with
    black removed, usable pixels of one channel. Raises ValueError for fewer than two
    frames.
    """
    frames = np.asarray(stack, dtype=np.float64)
    if frames.ndim != 2 or len(frames) < 2:
        raise ValueError(
            f"photon transfer needs two frames or more, (frames, pixels), not {frames.shape}"
        )
    levels = frames.mean(axis=1, keepdims=True)
    steady = frames * (levels.mean() / levels) if lit else frames - levels + levels.mean()
    signal = steady.mean(axis=0)
    variance = steady.var(axis=0, ddof=1)
    # The mean's own noise goes with the variance's, and would tilt a line through them: shrink it by what is real.
    real = max(
        0.0, 1 - float(variance.mean()) / len(frames) / max(float(signal.var()), 1e-300)
    )
    return Scatter(
        signal.mean() + real * (signal - signal.mean()), variance, len(frames) - 1
    )


def photon_transfer(
    flats: Iterable[Scatter], darks: Iterable[Scatter] = ()
) -> NoiseEstimate:
    """Return gain and read noise from flats of one channel, at any number of levels, and from darks.

    Weighted least squares of variance on signal, each pixel by its own expected scatter,
    pooled over all groups. Without flats the gain is None. Without darks the read noise
    follows from the flats' different levels, and is None below three standard errors.
    """
    light = [*flats]
    dark = [*darks]
    groups = light + [_at_zero(group) for group in dark]
    if not groups:
        return NoiseEstimate(None, None, None, None)
    variance = np.concatenate([group.variance for group in groups])
    signal = np.concatenate([group.signal for group in groups])
    freedom = np.concatenate(
        [np.full(group.signal.size, float(group.freedom)) for group in groups]
    )
    if not light:
        floor, floor_std = _mean_variance(variance, freedom)
        return NoiseEstimate(None, None, *_root(floor, floor_std))
    slope, floor, covariance = _line(signal, variance, freedom, floor_known=bool(dark))
    gain_std = float(np.sqrt(covariance[0, 0]))
    floor_std = float(np.sqrt(covariance[1, 1]))
    gain = (slope, gain_std) if slope > 0 else (None, None)
    known = bool(dark) or floor - ROUNDING_VARIANCE > 3 * floor_std
    return NoiseEstimate(*gain, *(_root(floor, floor_std) if known else (None, None)))


def _at_zero(group: Scatter) -> Scatter:
    """Return the darks' scatter at zero signal: any mean they have is offset."""
    return Scatter(np.zeros_like(group.signal), group.variance, group.freedom)


def _root(floor: float, floor_std: float) -> tuple[float, float]:
    """Read noise and its standard error from the variance at no light."""
    read_noise = float(np.sqrt(max(floor - ROUNDING_VARIANCE, 0.0)))
    return read_noise, floor_std / (2 * max(read_noise, float(np.sqrt(floor_std))))


def _mean_variance(variance: Floats, freedom: Floats) -> tuple[float, float]:
    """Return the pooled variance without outliers, and its standard error."""
    pooled = max(float(np.median(variance / _median_factor(freedom))), 1e-3)
    limit = _limit(freedom)
    for _ in range(5):
        kept = variance < limit * pooled
        pooled = float(np.average(variance[kept], weights=freedom[kept]))
    return pooled, pooled * float(np.sqrt(2 / freedom[kept].sum()))


def _line(
    signal: Floats, variance: Floats, freedom: Floats, *, floor_known: bool
) -> tuple[float, float, Floats]:
    """Fit variance on signal, reweighted until convergence; return (slope, floor, covariance)."""
    typical = variance / _median_factor(freedom)
    middle = signal >= np.median(signal)
    slope = max(float(np.median(typical[middle] / np.maximum(signal[middle], 1e-9))), 1e-9)
    floor = 1.0
    limit = _limit(freedom)
    for _ in range(20):
        expected = np.maximum(slope * signal + floor, 1e-3)
        weight = np.where(variance < limit * expected, freedom / (2 * expected**2), 0.0)
        moments = [float(np.sum(weight * signal**power)) for power in range(3)]
        information = np.array([[moments[2], moments[1]], [moments[1], moments[0]]])
        if not floor_known:
            information[1, 1] += 1 / (FLOOR_SHARE * expected.max()) ** 2
        covariance = np.linalg.inv(information)
        score = np.array([np.sum(weight * variance * signal), np.sum(weight * variance)])
        before = slope
        slope, floor = (float(value) for value in covariance @ score)
        if abs(slope - before) < 1e-9 * abs(before):
            break
    return slope, floor, covariance


def _median_factor(freedom: Floats) -> Floats:
    """Return the median of a sample variance over its mean."""
    few, which = np.unique(freedom, return_inverse=True)
    return np.asarray((chdtri(few, 0.5) / few)[which])


def _limit(freedom: Floats) -> Floats:
    """Return the ratio of sample variance to mean exceeded with OUTLIER_PROBABILITY."""
    few, which = np.unique(freedom, return_inverse=True)
    return np.asarray((chdtri(few, OUTLIER_PROBABILITY) / few)[which])
