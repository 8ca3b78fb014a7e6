"""Errors of numbers that are known to be biased: held to draws, and to the noncentral chi-squared distribution of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ncx2

from labkit.optics.known_bias import WITHIN, covariance_with_bias, error_with_bias


@pytest.mark.parametrize("bias", [0.0, 0.1, 1.0, 3.0, 6.0, 20.0, 99.0, 101.0])
def test_the_width_is_that_of_a_squared_normal_beside_its_mean(bias: float) -> None:
    expected = 0.3 * np.sqrt(ncx2.ppf(WITHIN, 1, bias**2)) if bias else 0.3
    assert error_with_bias(np.array(0.3), np.array(-0.3 * bias)) == pytest.approx(
        expected, rel=1e-6
    )


def test_as_many_draws_are_within_one_as_of_a_normal_error() -> None:
    rng = np.random.default_rng(1)
    errors = 2.0 + 0.7 * rng.normal(size=100_000)
    stated = float(error_with_bias(np.array(0.7), np.array(2.0)))
    assert np.mean(np.abs(errors) < stated) == pytest.approx(0.6827, abs=0.004)
    assert (
        np.mean(np.abs(errors) < np.hypot(0.7, 2.0)) < 0.58
    )  # the root of both squares does not hold as many


def test_numbers_without_an_error_have_that_of_their_bias() -> None:
    np.testing.assert_allclose(
        error_with_bias(np.zeros(3), np.array([-2.0, 0.0, 1e-9])), [2.0, 0.0, 1e-9]
    )


def test_what_is_biased_together_errs_together() -> None:
    covariance, bias = np.array([[4.0, 1.0], [1.0, 1.0]]), np.array([3.0, -30.0])
    whole = covariance_with_bias(covariance, bias)
    np.testing.assert_allclose(
        np.sqrt(np.diag(whole)), error_with_bias(np.array([2.0, 1.0]), bias)
    )
    assert whole[0, 1] < -90  # and with opposite signs
    assert np.linalg.eigvalsh(whole).min() > 0
    np.testing.assert_array_equal(covariance_with_bias(covariance, np.zeros(2)), covariance)
