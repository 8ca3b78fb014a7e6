"""Normal counts against scipy's normal distribution, finite differences, and draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from labkit.estimation.likelihood import NormalCounts

MEAN = np.array([[-3.0, 0.5, 20.0], [300.0, 4000.0, 15000.0]])
COUNTS = NormalCounts(
    MEAN,
    0.5,
    4.0,
    relative_std=np.full((2, 3), 0.01),
    rounding=np.linspace(0.0, 2.0, 6).reshape(2, 3),
)
DRAWN = MEAN + np.array([[1.0, -2.0, 6.0], [-20.0, 90.0, -300.0]])


def test_the_variance_is_of_photons_reading_illumination_and_rounding() -> None:
    by_hand = [
        4.0 + 0.03**2,
        0.25 + 4 + 0.005**2 + 0.4,
        10 + 4 + 0.2**2 + 0.8,
    ]  # no photon noise below 0
    np.testing.assert_allclose(COUNTS.variance[0], by_hand)


def test_the_log_likelihood_is_that_of_normal_distributions() -> None:
    wanted = np.sum(norm.logpdf(DRAWN, COUNTS.mean, np.sqrt(COUNTS.variance)))
    assert COUNTS.log_likelihood(DRAWN) == pytest.approx(
        wanted + 0.5 * MEAN.size * np.log(2 * np.pi), rel=1e-12
    )
    assert COUNTS.chi2(DRAWN) == pytest.approx(
        np.sum((DRAWN - MEAN) ** 2 / COUNTS.variance), rel=1e-12
    )


def test_a_pull_is_the_slope_of_the_log_likelihood_by_the_mean() -> None:
    pulls, step = COUNTS.pulls(DRAWN)[0], 1e-5 * np.maximum(1, np.abs(MEAN))
    for at in np.ndindex(MEAN.shape):
        moved = (
            np.where(np.indices(MEAN.shape) == np.reshape(at, (2, 1, 1)), 1.0, 0.0).prod(
                axis=0
            )
            * step
        )
        ends = [
            replace(COUNTS, mean=MEAN + sign * moved).log_likelihood(DRAWN)
            for sign in (1, -1)
        ]
        assert pulls[at] == pytest.approx(
            (ends[0] - ends[1]) / (2 * step[at]), rel=1e-6, abs=1e-8
        )


def test_weights_are_the_covariance_of_pulls() -> None:
    rng = np.random.default_rng(3)
    drawn = rng.normal(MEAN, np.sqrt(COUNTS.variance), (20_000, *MEAN.shape))
    by_mean, by_variance = COUNTS.pulls(drawn)
    both, cross, square = COUNTS.weights()
    # a variance of 20,000 draws errs by 1 % (of squares of normals 1.9 %); allow five of the larger
    np.testing.assert_allclose(np.var(by_mean, axis=0), both, rtol=0.1)
    np.testing.assert_allclose(np.var(by_variance, axis=0), square, rtol=0.1)
    size = np.sqrt(both * square)
    np.testing.assert_allclose(
        np.mean(by_mean * by_variance, axis=0) / size, cross / size, atol=0.05
    )
