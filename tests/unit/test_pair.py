"""A vector with its covariance: magnitude, direction, and the probability of chance."""

import numpy as np
import pytest

from labkit.field.pair import UNKNOWN_ANGLE_DEG, Pair


def test_magnitude_and_direction_have_the_errors_along_and_across() -> None:
    # 5 long, three down and four right; along (0.6, 0.8) 0.1, across 0.2
    along, across = np.array([0.6, 0.8]), np.array([0.8, -0.6])
    covariance = 0.1**2 * np.outer(along, along) + 0.2**2 * np.outer(across, across)
    pair = Pair(np.array([3.0, 4.0]), covariance, "um/mm")
    assert pair.magnitude.value == pytest.approx(5)
    assert pair.magnitude.std == pytest.approx(0.1)
    assert pair.direction_deg.value == pytest.approx(np.rad2deg(np.arctan2(3, 4)))
    assert pair.direction_deg.std == pytest.approx(np.rad2deg(0.2 / 5))
    assert pair.along(across).std == pytest.approx(0.2)


def test_the_direction_of_nothing_may_be_any() -> None:
    pair = Pair(np.zeros(2), np.eye(2))
    assert np.isnan(pair.direction_deg.value)
    assert pair.direction_deg.std == UNKNOWN_ANGLE_DEG
    assert Pair(np.array([0.0, 0.01]), np.eye(2)).direction_deg.std == UNKNOWN_ANGLE_DEG
    assert pair.magnitude.std == 1


def test_chance_alone_is_found_at_one_percent_and_ten_errors_always() -> None:
    rng = np.random.default_rng(1)
    covariance = np.array([[4e-6, 1e-6], [1e-6, 1e-6]])
    draws = rng.multivariate_normal(np.zeros(2), covariance, 5000)
    alarms = np.mean([Pair(draw, covariance).p_value < 0.01 for draw in draws])
    # a share of 1 % of 5000 has a standard error of 0.14 %
    assert alarms == pytest.approx(0.01, abs=0.005)
    coma = draws[:1000] + np.array([0.0, 0.01])
    assert min(Pair(one, covariance).p_value < 0.01 for one in coma)


def test_another_unit_takes_its_own_error_along_the_vector() -> None:
    pair = Pair(np.array([3.0, 4.0]), np.zeros((2, 2))).times(2.0, "um", 0.01)
    assert pair.magnitude.std == pytest.approx(0.1)
    assert pair.unit == "um"
    assert pair.direction_deg.std == pytest.approx(0, abs=1e-5)


def test_a_vector_that_was_not_estimated_is_null_in_json() -> None:
    pair = Pair(np.full(2, np.nan), np.full((2, 2), np.inf), "mm")
    assert pair.as_json() == {
        "value": [None, None],
        "covariance": [[None, None], [None, None]],
        "unit": "mm",
    }
    assert np.isnan(pair.p_value)
