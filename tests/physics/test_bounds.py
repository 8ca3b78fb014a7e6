"""Bounds against the solver's own information, closed forms, finite differences and drawn noise."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

from labkit.estimation.climb import Problem, maximize
from labkit.estimation.identifiability import bound_of
from labkit.estimation.likelihood import low_orders
from labkit.experiments.conditions import NOLL, Trial, draw_trial
from labkit.experiments.methods.bounds import (
    bias_sensitivity,
    fisher_information,
    uniform_bound,
)
from labkit.types import Floats


@pytest.fixture(scope="module")
def trial() -> Trial:
    return draw_trial(np.random.default_rng(3))


@pytest.fixture(scope="module")
def information(trial: Trial) -> Floats:
    return fisher_information(trial.problem, trial.state(trial.waves))


def test_the_lean_information_is_that_of_the_solver(
    trial: Trial, information: Floats
) -> None:
    whole = trial.problem.scores(trial.state(trial.waves), by_waves=True)[1]
    scale = 1 / np.sqrt(np.diag(whole))
    np.testing.assert_allclose(
        information * np.outer(scale, scale), whole * np.outer(scale, scale), atol=1e-10
    )


def test_so_it_is_with_several_frames_and_light_unknown(trial: Trial) -> None:
    shapes = low_orders(*trial.frame.counts.shape)
    lit = replace(
        trial.frame, departures=shapes, relative_std=np.full(trial.frame.counts.shape, 0.01)
    )
    other = replace(lit, counts=trial.frame.counts * 0.9)
    state = trial.state(trial.waves)
    state = replace(
        state,
        poses=(trial.pose, trial.pose.moved(np.full(8, 1e-3))),
        scales=np.repeat(state.scales, 2),
        ambients=np.array([1.0, 2.0]),
        unevenness=np.array([0.05, -0.02, 0.01, 0.0, 0.03]),
    )
    problem = Problem(trial.problem.model, (lit, other), trial.noise)
    whole = problem.scores(state, by_waves=True)[1]
    scale = 1 / np.sqrt(np.diag(whole))
    lean = fisher_information(problem, state, modes_at_once=5)
    np.testing.assert_allclose(
        lean * np.outer(scale, scale), whole * np.outer(scale, scale), atol=1e-10
    )
    assert len(state.parameter_names(NOLL)) == len(lean)


def test_it_needs_less_memory_than_all_derivatives_at_once(trial: Trial) -> None:
    many = replace(
        trial, noll=tuple(range(4, 59))
    )  # 55 modes, as the thesis fitted to an iPad's camera
    state, problem = many.state(np.full(55, 0.01)), many.problem
    problem.relative(state)

    def peak(work: Callable[[], object]) -> int:
        tracemalloc.start()
        work()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert peak(lambda: fisher_information(problem, state, 5)) < 0.5 * peak(
        lambda: problem.scores(state, by_waves=True)
    )


def test_the_bound_at_the_thesis_conditions_is_the_published_one(
    trial: Trial, information: Floats
) -> None:
    bound = bound_of(information, trial.state(trial.waves).parameter_names(NOLL))
    assert bound.undetermined == ()
    # an independent calculation gives 0.0014 to 0.0018 waves over wavefronts; read noise is 0.79 here, 0.68 there
    assert 0.0012 < bound.rms(0, 12) < 0.0022


def test_fits_err_by_the_bound() -> None:
    rng, scaled = np.random.default_rng(8), []
    for _ in range(10):
        drawn = draw_trial(rng)
        solution = maximize(drawn.problem, drawn.state(drawn.waves))
        bound = bound_of(
            fisher_information(drawn.problem, drawn.state(drawn.waves)),
            ["?"] * len(solution.information),
        )
        error = solution.state.waves - drawn.waves
        scaled.append(error @ np.linalg.solve(bound.covariance[:12, :12], error))
    # a chi-squared of 120 freedoms errs by sqrt(240); allow four of them
    assert abs(sum(scaled) - 120) < 4 * np.sqrt(240)


def test_a_singular_information_is_told_in_words() -> None:
    bound = bound_of(
        np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 4.0]]), ("a", "b", "c")
    )
    assert bound.undetermined in (("+1 a -1 b",), ("-1 a +1 b",))
    assert bound_of(np.diag([1.0, 0.0, 4.0, 0.0]), ("a", "b", "c", "d")).undetermined == (
        "b",
        "d",
    )
    np.testing.assert_allclose(bound.std, [np.inf, np.inf, 0.5])


@pytest.mark.parametrize(
    "bad", [np.ones((2, 3)), np.full((2, 2), np.nan), np.array([[1.0, 2.0], [0.0, 1.0]])]
)
def test_what_is_no_information_is_refused(bad: Floats) -> None:
    with pytest.raises(ValueError, match="information"):
        bound_of(bad, ("a", "b"))


COVARIANCE = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 2.0]]) * 1e-8


@pytest.mark.parametrize("norm", [None, np.diag([1.0, 4.0, 0.5])])
def test_the_uniform_bound_is_the_least_under_its_constraint(norm: Floats | None) -> None:
    covariance = COVARIANCE * 1e8
    weight = np.eye(3) if norm is None else norm
    (delta,), (least,) = uniform_bound(covariance, 0, np.array([3.0]), norm)

    def variance(d: Floats) -> float:
        biased = np.array([1.0, 0, 0]) + d
        return float(biased @ covariance @ biased)

    limit = NonlinearConstraint(lambda d: d @ weight @ d, -np.inf, delta**2)
    found = minimize(
        variance, np.full(3, -0.01), method="SLSQP", constraints=limit, tol=1e-14
    )
    assert found.fun == pytest.approx(least, rel=1e-6)
    (small,), (near,) = uniform_bound(covariance, 0, np.array([1e6]), norm)
    assert (near - covariance[0, 0]) / small == pytest.approx(
        bias_sensitivity(covariance, 0, norm), rel=1e-4
    )
