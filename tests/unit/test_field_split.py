"""Misalignment of body and lens, told apart by turning the lens."""

import numpy as np
import pytest
from scipy.stats import kstest

from labkit.field.pair import Pair
from labkit.field.split import split, turn

BODY = np.array([2.4, -1.5])
LENS = np.array([-0.8, 0.3])
ERRORS = np.array([[0.04, 0.01], [0.01, 0.09]])


def shown(angle_deg: float) -> Pair:
    """Return what the sensor shows: a vector right + i down turns by exp(i angle)."""
    turned = complex(LENS[1], LENS[0]) * np.exp(1j * np.radians(angle_deg))
    lens = np.array([turned.imag, turned.real])
    return Pair(BODY + lens, ERRORS, "µm/mm")


@pytest.mark.parametrize("angles", [(0, 180), (0, 90), (30, -60, 200)])
def test_two_angles_or_more_determine_both_parts(angles: tuple[float, ...]) -> None:
    found = split([shown(angle) for angle in angles], angles)
    assert found.body.value == pytest.approx(BODY)
    assert found.lens.value == pytest.approx(LENS)
    assert np.isnan(found.p_value) == (len(angles) == 2)


def test_a_half_turn_has_mean_and_half_difference() -> None:
    found = split([shown(0), shown(180)], (0, 180))
    assert found.body.covariance == pytest.approx(ERRORS / 2)
    assert found.lens.covariance == pytest.approx(ERRORS / 2)
    assert found.covariance[:2, 2:] == pytest.approx(np.zeros((2, 2)))


def test_a_quarter_turn_is_from_right_towards_down() -> None:
    assert turn(90) @ [0, 1] == pytest.approx([1, 0])


def test_pulls_are_unit_normal_and_contradictions_rare() -> None:
    rng = np.random.default_rng(3)
    angles = (0, 90, 180)
    pulls, chances = [], []
    for _ in range(300):
        measured = [
            Pair(rng.multivariate_normal(shown(a).value, ERRORS), ERRORS) for a in angles
        ]
        found = split(measured, angles)
        away = np.concatenate([found.body.value - BODY, found.lens.value - LENS])
        root = np.linalg.cholesky(found.covariance)
        pulls.append(np.linalg.solve(root, away))
        chances.append(found.p_value)
    assert kstest(np.ravel(pulls), "norm").pvalue > 0.05
    assert kstest(chances, "uniform").pvalue > 0.05


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ((0, 0), "turned by 0, 0°: two different angles"),
        ((0, 360), "two different angles"),
        ((90,), "1 angles"),
        ((0, np.nan), "finite angles"),
    ],
)
def test_angles_that_split_nothing_are_refused(
    angles: tuple[float, ...], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        split([shown(0), shown(180)], angles)
