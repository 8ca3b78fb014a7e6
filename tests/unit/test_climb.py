"""Climbs, in a valley of two numbers and on a small chip: they end at the maximum, and say how well it is known."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from labkit.estimation.climb import (
    PER_FRAME,
    NoisePrior,
    Problem,
    Solution,
    Start,
    State,
    maximize,
)
from labkit.estimation.expansion import free_f_number
from labkit.estimation.levenberg_marquardt import Position, Step, climb, damped_step
from labkit.estimation.likelihood import FrameData
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import Pose
from labkit.target.target import CellTarget
from labkit.types import Floats

OPTICS = Optics(
    wavelength_nm=550.0,
    reference_nm=450.0,
    f_number=8.0,
    pitch_um=4.8,
    active_um=4.8,
    noll=(4, 6, 8),
)
CARPET = CellTarget(
    np.kron(np.array([[0.0, 1, 0], [1, 0, 1], [0, 0, 1]]), np.ones((2, 2))),
    (20.0, 20.0),
    0.0,
)
CORNERS = np.array([[8.3, 9.1], [8.0, 29.7], [28.8, 29.9], [29.1, 9.4]])
FRAME = (38, 40)
PRIOR = NoisePrior(0.25, 0.01, 4.0, 0.02)


def truth(frames: int = 1) -> State:
    poses = tuple(
        Pose.from_corners(CORNERS + 0.3 * k, CARPET.size_mm) for k in range(frames)
    )
    waves = np.array([0.15, 0.04, -0.05])
    return State(waves, poses, np.full(frames, 1500.0), np.full(frames, 40.0), PRIOR.centre)


@pytest.fixture(scope="module")
def model() -> ForwardModel:
    return ForwardModel.build(OPTICS, CARPET, FRAME, truth().poses[0], window_airy=48.0)


@pytest.fixture(scope="module")
def problem(model: ForwardModel) -> Problem:
    return photographed(model, 1)


def photographed(model: ForwardModel, frames: int) -> Problem:
    rng, used, one = np.random.default_rng(11), np.ones(FRAME, bool), np.ones(FRAME)
    seen = model.means(
        truth(frames).waves, model.draw(truth(frames).poses), [used] * frames
    )
    means = [(1500 * u + 40).reshape(FRAME) for u in seen]
    data = tuple(
        FrameData(rng.normal(m, np.sqrt(0.25 * m + 4)), used, one, 0 * one) for m in means
    )
    return Problem(model, data, PRIOR)


def beside(state: State, rng: np.random.Generator) -> State:
    """A start a little off in everything."""
    common = np.append(rng.normal(0, 0.03, 3), np.zeros(PER_FRAME * len(state.poses) + 2))
    poses = tuple(
        p.moved(np.append(rng.uniform(-0.4, 0.4, 6), [0, 0])) for p in state.poses
    )
    scales, ambients = (
        state.scales * rng.uniform(0.9, 1.1),
        state.ambients + rng.uniform(-20, 20),
    )
    return replace(state.moved(common), poses=poses, scales=scales, ambients=ambients)


@pytest.fixture(scope="module")
def solution(problem: Problem) -> Solution:
    return maximize(problem, beside(truth(), np.random.default_rng(1)))


def standard_errors(step: Floats, solution: Solution) -> float:
    """Length of a step in all parameters."""
    return float(np.sqrt(step @ solution.information @ step))


def test_a_climb_ends_where_the_gradient_is_small_in_standard_errors(
    problem: Problem, solution: Solution
) -> None:
    gradient = problem.scores(solution.state, by_waves=True)[0]
    assert solution.converged
    step = np.asarray(np.linalg.solve(solution.information, gradient), float)
    assert standard_errors(step, solution) < 0.05  # its tolerance


def test_one_drawing_is_held_at_a_time(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw, drawn = Problem.draw, list[weakref.ref[object]]()

    def noted(self: Problem, state: State) -> Drawing:
        assert not any(
            one() is not None for one in drawn
        )  # of a large target each is hundreds of megabytes
        drawing = draw(self, state)
        drawn.append(weakref.ref(drawing.spectra[0]))
        return drawing

    monkeypatch.setattr(Problem, "draw", noted)
    climbed = maximize(problem, beside(truth(), np.random.default_rng(1)))
    free_f_number(problem, Start(climbed.state), 0.01)
    assert len(drawn) > 5


def test_what_is_foreseen_of_its_end_is_what_is_seen_there(
    problem: Problem, solution: Solution
) -> None:
    (seen,) = problem.relative(solution.state)
    # a step of a standard error at most, whose square it leaves out: measured are 3.3e-7
    assert np.abs(seen - solution.relative[0]).max() < 6.6e-7
    assert problem.objective(solution.state, [seen]) == pytest.approx(
        solution.objective, abs=1e-3
    )
    again = problem.chi2_per_pixel(solution.state, [seen])
    assert again == pytest.approx(solution.chi2_per_pixel, rel=1e-5)


def test_the_information_is_that_of_the_end(problem: Problem, solution: Solution) -> None:
    there = replace(solution, information=problem.scores(solution.state, by_waves=True)[1])
    ratio = np.diag(there.covariance()) / np.diag(solution.covariance())
    np.testing.assert_allclose(np.sqrt(ratio), 1, atol=1.7e-3)  # measured: 9e-4


def test_a_likelihood_does_not_depend_on_what_was_evaluated_before(
    problem: Problem, model: ForwardModel
) -> None:
    here = truth()
    pose = Pose.from_corners((CORNERS - 19) * 1.07 + 19, CARPET.size_mm)
    elsewhere = replace(here, poses=(pose,), waves=here.waves + 0.1)
    first, _, again = (
        problem.objective(s, problem.relative(s)) for s in (here, elsewhere, here)
    )
    assert again == first
    fresh = ForwardModel.build(OPTICS, CARPET, FRAME, here.poses[0], window_airy=48.0)
    fresh_problem = replace(problem, model=fresh)
    for state in (elsewhere, here):
        assert fresh_problem.objective(
            state, fresh_problem.relative(state)
        ) == problem.objective(state, problem.relative(state))


def test_nothing_about_its_end_is_likelier(problem: Problem, solution: Solution) -> None:
    rng, std = np.random.default_rng(2), np.sqrt(np.diag(solution.covariance()))
    for _ in range(30):
        trial = solution.state.moved(std * rng.normal(0, 0.3, std.size))
        assert problem.objective(trial, problem.relative(trial)) < solution.objective


def test_its_objective_never_decreases(problem: Problem) -> None:
    start = beside(truth(), np.random.default_rng(3))
    heights = [
        maximize(problem, start, max_steps=steps).objective for steps in range(1, 12)
    ]
    assert heights[0] == problem.objective(start, problem.relative(start))
    assert np.all(np.diff(heights) >= 0)
    assert heights[0] < heights[-1] - 100


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_climbs_from_different_near_starts_end_in_one_place(
    problem: Problem, solution: Solution, seed: int
) -> None:
    other = maximize(problem, beside(truth(), np.random.default_rng(seed)))
    std = np.sqrt(np.diag(solution.covariance()))
    # each stops within 0.05 standard errors, all parameters together: half the square of that below the maximum
    assert other.objective == pytest.approx(solution.objective, abs=2 * 0.05**2 / 2)
    assert np.all(np.abs(other.state.waves - solution.state.waves) < 0.1 * std[:3])


def test_the_truth_is_found_within_its_standard_errors(solution: Solution) -> None:
    std = np.sqrt(np.diag(solution.covariance()))
    assert np.all(np.abs(solution.state.waves - truth().waves) < 4 * std[:3])
    assert np.all(np.abs(solution.state.poses[0].v - truth().poses[0].v) < 4 * std[3:11])
    # of n normals squared the mean has a standard deviation of sqrt(2/n); allow four
    assert solution.chi2_per_pixel == pytest.approx(1, abs=4 * np.sqrt(2 / (38 * 40)))


def test_frames_with_poses_of_their_own_tell_one_wavefront_together(
    model: ForwardModel, solution: Solution
) -> None:
    both = maximize(photographed(model, 2), beside(truth(2), np.random.default_rng(7)))
    std = np.sqrt(np.diag(both.covariance()))
    assert both.information.shape == (3 + 2 * PER_FRAME + 2,) * 2
    assert np.all(np.abs(both.state.poses[1].v - truth(2).poses[1].v) < 4 * std[13:21])
    # twice the photons; a little of each frame goes into its own pose
    np.testing.assert_allclose(
        std[:3] / np.sqrt(np.diag(solution.covariance())[:3]), np.sqrt(0.5), rtol=0.05
    )


def test_fixed_modes_stay_where_they_are(problem: Problem) -> None:
    start = beside(truth(), np.random.default_rng(8))
    found = maximize(problem, start, free_waves=False)
    np.testing.assert_array_equal(found.state.waves, start.waves)
    assert np.all(found.information[:3] == 0)
    assert found.objective > problem.objective(start, problem.relative(start))


def test_a_pose_that_would_run_away_is_not_followed(problem: Problem) -> None:
    far = replace(truth(), waves=np.array([4.0, 0.0, 0.0]))
    found = maximize(problem, far, free_waves=False, max_steps=12)
    assert np.abs(found.state.poses[0].corners_px() - CORNERS).max() < 0.5 * 21.2


def test_the_covariance_is_the_inverse_of_the_information(solution: Solution) -> None:
    size = len(solution.information)
    np.testing.assert_allclose(
        solution.covariance() @ solution.information, np.eye(size), atol=1e-8
    )


@pytest.mark.parametrize("flaw", ["no information", "two parameters alike"])
def test_what_is_not_determined_has_huge_errors_and_nothing_else_has(
    solution: Solution, flaw: str
) -> None:
    information = solution.information.copy()
    if flaw == "no information":
        information[1], information[:, 1] = 0, 0
    else:
        information[1], information[:, 1] = information[0], information[:, 0]
        information[1, 1] = information[0, 0]
    std = np.sqrt(np.diag(replace(solution, information=information).covariance()))
    larger = std / np.sqrt(np.diag(solution.covariance())) > 100
    assert np.flatnonzero(larger).tolist() == ([1] if flaw == "no information" else [0, 1])
    assert np.all(np.isfinite(std))


def test_a_step_moves_each_parameter_in_its_own_place() -> None:
    state = replace(truth(2), unevenness=np.zeros(2))
    moved = state.moved(np.arange(3.0 + 2 * PER_FRAME + 2 + 2) / 100)
    np.testing.assert_allclose(moved.waves - state.waves, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(
        moved.poses[0].v - state.poses[0].v, np.arange(3, 11) / 100, atol=1e-12
    )
    np.testing.assert_allclose(
        moved.poses[1].v - state.poses[1].v, np.arange(13, 21) / 100, atol=1e-12
    )
    np.testing.assert_allclose(moved.scales - state.scales, [0.11, 0.21])
    np.testing.assert_allclose(moved.ambients - state.ambients, [0.12, 0.22])
    np.testing.assert_allclose(moved.unevenness, [0.23, 0.24])
    np.testing.assert_allclose(moved.log_noise - state.log_noise, [0.25, 0.26])


def test_noise_changes_by_no_more_than_a_factor_of_e_in_a_step() -> None:
    step = np.append(np.zeros(3 + PER_FRAME), [9.0, -9.0])
    np.testing.assert_allclose(truth().moved(step).log_noise - PRIOR.centre, [1.0, -1.0])


def test_noise_is_given_as_it_is_measured() -> None:
    state = truth()
    assert state.gain == pytest.approx(0.25)
    assert state.read_noise == pytest.approx(2.0)
    assert [d.gain for d in truth(2).detectors()] == pytest.approx([0.25, 0.25])


@dataclass(frozen=True)
class Valley(Position):
    """The bent valley of Rosenbrock (1960), a sum of two squares, maximum 0 at (1, 1). wall: where no climb may go."""

    at: Floats
    wall: float = np.inf
    visited: list[Floats] = field(default_factory=list)

    @property
    def rest(self) -> Floats:
        x, y = self.at
        return np.array([10 * (y - x**2), 1 - x])

    @property
    def objective(self) -> float:
        return -0.5 * float(self.rest @ self.rest) if self.at[0] < self.wall else -np.inf

    def step(self, damping: float) -> Step:
        self.visited.append(self.at)
        slopes = np.array([[20 * self.at[0], -10.0], [1.0, 0.0]])
        return damped_step(slopes.T @ self.rest, slopes.T @ slopes, damping)

    def moved(self, change: Floats) -> Valley:
        return replace(self, at=self.at + change)


def test_a_climb_follows_a_bent_valley_to_its_end() -> None:
    end, steps, converged = climb(
        Valley(np.array([-1.2, 1.0])), max_steps=60, tolerance=1e-6
    )
    assert converged
    assert steps < 60
    np.testing.assert_allclose(end.at, 1, atol=1e-6)


def test_a_climb_that_runs_out_of_steps_has_not_settled() -> None:
    end, steps, converged = climb(
        Valley(np.array([-1.2, 1.0])), max_steps=3, tolerance=1e-6
    )
    assert (steps, converged) == (3, False)
    assert len({tuple(at) for at in end.visited}) <= 3


def test_a_climb_goes_nowhere_beyond_a_wall_and_ends_at_it() -> None:
    end, _, _ = climb(Valley(np.array([-1.2, 1.0]), wall=0.5), max_steps=60, tolerance=1e-6)
    assert all(at[0] < 0.5 for at in end.visited)
    assert end.at[0] == pytest.approx(0.5, abs=0.05)


def test_a_step_without_damping_solves_the_normal_equations() -> None:
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(9, 4)) * [1e-3, 1.0, 1.0, 1e3]
    gradient, information = rng.normal(size=4), slopes.T @ slopes
    step = damped_step(gradient, information, 0.0)
    np.testing.assert_allclose(information @ step.change, gradient, rtol=1e-8)
    assert step.length**2 == pytest.approx(gradient @ step.change)
    assert step.gain == pytest.approx(step.length**2 / 2)


def test_parameters_without_information_stay() -> None:
    step = damped_step(np.array([1.0, 0.0, 2.0]), np.diag([4.0, 0.0, 1.0]), 0.0)
    np.testing.assert_allclose(step.change, [0.25, 0.0, 2.0])
