"""Tests for a local optimum on independently formed pictures, and on data drawn from the model itself."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from labkit.estimation.climb import Problem, State, maximize
from labkit.experiments.conditions import Trial, draw_trial, random_waves
from labkit.experiments.methods.optimum_tests import (
    SignificanceTest,
    bootstrap,
    bootstrapped,
    embedding,
    one_sided,
    rao_score,
    two_sided,
)
from labkit.experiments.methods.psf_basis import (
    find_psf_basis,
    noise_free,
    shipped_psf_basis,
)
from labkit.types import Floats


@pytest.fixture(scope="module")
def trial() -> Trial:
    return draw_trial(np.random.default_rng(30), snr=50.0)


@pytest.fixture(scope="module")
def right(trial: Trial) -> State:
    return maximize(trial.problem, trial.state(trial.waves)).state


@pytest.fixture(scope="module")
def wrong(trial: Trial) -> State:
    for seed in range(10):
        start = trial.state(random_waves(np.random.default_rng(seed), 12, 0.2))
        found = maximize(trial.problem, start).state
        if np.linalg.norm(trial.error(found.waves)) > 0.03:
            return found
    raise AssertionError("ten random starts all ended in the right optimum")


def test_the_right_optimum_passes_and_a_wrong_one_does_not(
    trial: Trial, right: State, wrong: State
) -> None:
    problem, basis = trial.problem, shipped_psf_basis(4)
    for test in (two_sided, one_sided, lambda p, s: embedding(p, s, basis)):
        assert test(problem, right).p_value > 1e-3
        assert test(problem, wrong).p_value < 1e-6


def test_statistics_of_drawn_data_follow_their_fast_forms(
    trial: Trial, right: State, wrong: State
) -> None:
    def statistics(problem: Problem, state: State) -> tuple[float, float]:
        return one_sided(problem, state).statistic, embedding(
            problem, state, shipped_psf_basis(4)
        ).statistic

    drawn = bootstrap(trial.problem, right, statistics, np.random.default_rng(31), 24)
    assert kstest(drawn[:, 0], "norm").pvalue > 1e-3
    assert kstest(drawn[:, 1], chi2(4).cdf).pvalue > 1e-3
    assert bootstrapped(one_sided(trial.problem, wrong), drawn[:, 0]).p_value == 1 / 25


def test_a_bootstrapped_p_value_is_a_rank() -> None:
    drawn = np.arange(1.0, 100.0)
    for statistic, p_value in ((95.5, 0.05), (95.0, 0.06), (1e3, 0.01), (0.0, 1.0)):
        assert bootstrapped(
            SignificanceTest("any", statistic, 0.5), drawn
        ).p_value == pytest.approx(p_value)


def test_rao_of_a_linear_model_is_the_fall_of_the_misfit() -> None:
    rng = np.random.default_rng(32)
    slopes, data = rng.normal(size=(50, 3)), rng.normal(size=50)
    fitted = slopes @ np.linalg.lstsq(slopes, data, rcond=None)[0]
    assert rao_score(slopes.T @ data, slopes.T @ slopes) == pytest.approx(
        data @ data - np.sum((data - fitted) ** 2)
    )


def test_algorithm_4_9_finds_a_direction_that_is_common_to_its_cases(
    trial: Trial, wrong: State
) -> None:
    problem = trial.problem
    weights: Floats = np.full(int(trial.frame.used.sum()), 1 / trial.read_noise**2)
    basis = find_psf_basis([(problem, wrong, weights)], 1, half_width=10)
    assert basis.directions.shape == (1, 21, 21)
    assert embedding(problem, wrong, basis).p_value < 1e-6


def test_noise_free_frames_are_the_mean(trial: Trial) -> None:
    state = trial.state(trial.waves)
    mean = noise_free(trial.problem, state).frames[0].counts
    misfit = (trial.frame.counts - mean).ravel()
    assert misfit.std() == pytest.approx(
        np.sqrt(trial.read_noise**2 + mean.mean() / 2000), rel=0.03
    )
