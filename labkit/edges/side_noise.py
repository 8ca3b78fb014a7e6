"""The camera's noise by the even sides of an edge, which no model of its blur enters."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from labkit.edges.first_fits import RoughEdge
from labkit.estimation.climb import NoisePrior
from labkit.types import Floats

CLEAR_WIDTHS, CLEAR_PX = 3.0, 2.0  # from the edge: of its blur, and further pixels
FEWEST_IN_SIDE = 40  # pixels of a side
SURFACE_ORDER = 2  # of the surface through a side
MOST_RESIDUAL_STDS = 4.0  # of a residual: others are dust or hot pixels
AS_SURE = 1e-2
"""Relative error that the noise keeps in a fit: residuals of a poor model must not enlarge it."""

LEAST_START = 0.01  # of the prior's numbers
LEAST_SIDE_VARIANCE = 1 / 24  # counts squared: half of what rounding makes


def noise_of_sides(rough: RoughEdge, prior: NoisePrior) -> NoisePrior:
    """Return the noise by both sides of an edge and by the prior; the prior alone where the sides are small."""
    means: list[float] = []
    variances: list[float] = []
    counts: list[int] = []
    region = rough.region
    across, along = region.across_and_along(rough.edge)
    clear = CLEAR_WIDTHS * rough.width_px + CLEAR_PX
    for side in (across < -clear, across > clear):
        if side.sum() < FEWEST_IN_SIDE:
            return prior
        level, variance, count = _scatter(across[side], along[side], region.counts[side])
        means.append(level)
        variances.append(max(variance, LEAST_SIDE_VARIANCE))
        counts.append(count)
    mean = np.array(means).clip(0)
    wanted = np.log(variances)
    weight = np.sqrt(np.array(counts) / 2)

    def off(logs: Floats) -> Floats:
        gain, read = np.exp(logs)
        own = weight * (np.log(gain * mean + read) - wanted)
        return np.concatenate([own, (logs - prior.centre) * np.sqrt(prior.precision)])

    # from the line through both: far from it the read noise is too small to matter
    dark, bright = np.argsort(mean)
    rise = (variances[bright] - variances[dark]) / max(mean[bright] - mean[dark], 1.0)
    start = [rise, variances[dark] - rise * mean[dark]]
    floor = np.exp(prior.centre) * LEAST_START
    gain, read = np.exp(least_squares(off, np.log(np.maximum(start, floor))).x)
    return NoisePrior(float(gain), AS_SURE, float(read), AS_SURE)


def _scatter(x: Floats, y: Floats, counts: Floats) -> tuple[float, float, int]:
    """Return mean and variance of counts (n,) about a smooth surface over places, and how many degrees of freedom it has."""
    x, y = (each - each.mean() for each in (x, y))
    terms = [
        x**i * y**j for i in range(SURFACE_ORDER + 1) for j in range(SURFACE_ORDER + 1 - i)
    ]
    basis = np.stack(terms, axis=1)
    least = basis.shape[1]
    used = np.ones(counts.size, bool)
    for _ in range(2):
        numbers = np.linalg.lstsq(basis[used], counts[used], rcond=None)[0]
        left = counts - basis @ numbers
        freedom = int(used.sum()) - least
        squares = float(np.sum(left[used] ** 2))
        variance = squares / freedom
        used = left**2 <= MOST_RESIDUAL_STDS**2 * variance
    return float(counts.mean()), variance, freedom
