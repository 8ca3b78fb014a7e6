"""The thesis's small problem of distinguishing local from global optima: the frequency of a sinusoid, (4.5)-(4.8), (4.23)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labkit.types import Floats

X = np.arange(100) / 99
TRUE = 3 * np.pi
HIGHEST = 4 * np.pi
GRID = np.linspace(0, HIGHEST, 401)
SIGNALS = np.sin(GRID[:, None] * X)


@dataclass(frozen=True)
class Optima:
    """Optima of one draw of data (100,), refined: the global minimum of the misfit over frequencies and the
    next.
    """

    best: float
    other: float


def find_optima(data: Floats) -> Optima | None:
    """Return the global and the deepest other local minimum inside [0, 4 pi]; None without another."""
    misfit = np.sum((data - SIGNALS) ** 2, axis=1)
    inside = np.flatnonzero((misfit[1:-1] < misfit[:-2]) & (misfit[1:-1] < misfit[2:])) + 1
    if inside.size < 2:
        return None
    deepest = inside[np.argsort(misfit[inside])[:2]]
    best, other = (_refined(data, GRID[k]) for k in deepest)
    return Optima(best, other)


def _refined(data: Floats, frequency: float) -> float:
    for _ in range(6):
        slope = X * np.cos(frequency * X)
        frequency += float(slope @ (data - np.sin(frequency * X)) / (slope @ slope))
    return frequency


def log_likelihood(data: Floats, frequency: float) -> float:
    """Return the log-likelihood of unit noise, less its constant.

    Its expectation under the frequency itself is -50, its deviation sqrt(50).
    """
    return float(-0.5 * np.sum((data - np.sin(frequency * X)) ** 2))


def two_sided(data: Floats, frequency: float) -> float:
    """Return the statistic of Biernacki's test (4.10), large for a local optimum."""
    return (log_likelihood(data, frequency) + 50) ** 2 / 50


def one_sided(data: Floats, frequency: float) -> float:
    """Return the statistic of the one-sided test (4.12), with the sign that makes local optima large."""
    return float(-(log_likelihood(data, frequency) + 50) / np.sqrt(50))


def chirp_gap(degrees: int) -> Callable[[Floats, float], float]:
    """Return the gap (4.21) of the plain relaxation sin(t0 x + t1 x^2 + ...), with more degrees of freedom."""
    powers = X ** np.arange(1, degrees + 2)[:, None]

    def gap(data: Floats, frequency: float) -> float:
        theta = np.zeros(degrees + 1)
        theta[0] = frequency
        value = log_likelihood(data, frequency)
        damping = 1e-3
        first = value
        for _ in range(30):
            phase = theta @ powers
            slopes = powers * np.cos(phase)
            normal = slopes @ slopes.T
            step = np.linalg.solve(
                normal + damping * np.diag(np.diag(normal)), slopes @ (data - np.sin(phase))
            )
            trial = float(-0.5 * np.sum((data - np.sin((theta + step) @ powers)) ** 2))
            if trial > value:
                theta = theta + step
                value = trial
                damping = damping / 5
            else:
                damping *= 8
        return value - first

    return gap


def relaxation(count: int = 1) -> Floats:
    """Return (count, 100) directions of Algorithm 4.9: the embedding is all of R^100, its information the
    identity.

    Noise-free data of 100 frequencies; the whitened score at every wrong optimum is the
    residual; the directions are the first left singular vectors of all residuals.
    """
    scores = []
    for frequency in np.linspace(0, HIGHEST, 100):
        data = np.sin(frequency * X)
        misfit = np.sum((data - SIGNALS) ** 2, axis=1)
        inside = (
            np.flatnonzero((misfit[1:-1] < misfit[:-2]) & (misfit[1:-1] < misfit[2:])) + 1
        )
        wrong = [
            w
            for w in (_refined(data, GRID[k]) for k in inside)
            if 0 < w < HIGHEST and abs(w - frequency) > 0.05
        ]
        scores += [data - np.sin(w * X) for w in wrong]
    return np.asarray(
        np.linalg.svd(np.array(scores).T, full_matrices=False)[0][:, :count].T
    )


def linear_gap(directions: Floats) -> Callable[[Floats, float], float]:
    """Return the gap of the relaxation sin(t x) + sum_k c_k r_k from the optimum, by Gauss-Newton steps."""

    def gap(data: Floats, frequency: float) -> float:
        first = log_likelihood(data, frequency)
        theta = frequency
        best = first
        for _ in range(8):
            slopes = np.vstack([X * np.cos(theta * X), directions])
            solved = np.linalg.lstsq(slopes.T, data - np.sin(theta * X), rcond=None)[0]
            theta += float(np.clip(solved[0], -0.3, 0.3))
            left = data - np.sin(theta * X)
            left = left - directions.T @ np.linalg.lstsq(directions.T, left, rcond=None)[0]
            best = max(best, float(-0.5 * left @ left))
        return best - first

    return gap
