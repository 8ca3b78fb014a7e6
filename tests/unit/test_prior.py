"""Modes that are known before a climb: they stay where light does not tell, and measurements are without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.climb import Problem, Start, State
from labkit.estimation.expansion import Freed, free_f_number
from labkit.estimation.local import Guesses, Views, find_optima
from labkit.estimation.prior import Prior
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.parts import CatsEye
from labkit.types import Floats
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH, photographed

NOLL = tuple(range(4, 23))
CUT = replace(OPTICS, noll=NOLL, parts=(CatsEye(0.6, 0.2, 0.0),))
WAVES = 0.02 * np.random.default_rng(3).normal(size=len(NOLL))


def behind_the_eye() -> tuple[Problem, State]:
    """Frames behind a circle that is shifted by 0.63 of the radius, and their true state."""
    model = ForwardModel.build(
        CUT, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    truth = replace(TRUTH, waves=WAVES + np.where(np.array(NOLL) == 4, 0.3, 0.0))
    return photographed(model, truth), truth


def weakest(freed: Freed) -> Floats:
    """The combination (modes,) of which the frames tell least, defocus left out."""
    values, vectors = np.linalg.eigh(
        freed.measured.covariance[1 : len(NOLL), 1 : len(NOLL)]
    )
    assert values[-1] > 100 * values[len(NOLL) // 2]
    return np.append(0.0, vectors[:, -1])


def test_a_prior_adds_the_slopes_and_the_curvature_of_what_modes_lose() -> None:
    prior, step = Prior.of_lens((4, 7, 11), np.array([0.4, 0.02, -0.03])), 1e-4
    waves = np.array([0.1, 0.05, 0.01])
    gradient, information = prior.joined(np.zeros(5), np.zeros((5, 5)), waves)
    moves = step * np.eye(3)
    up, down = ([prior.loss(waves + s * move) for move in moves] for s in (1, -1))
    slopes = (np.array(down) - np.array(up)) / (2 * step)
    np.testing.assert_allclose(gradient, [*slopes, 0, 0], rtol=1e-8)
    curvature = (np.array(up) + down - 2 * prior.loss(waves)) / step**2
    np.testing.assert_allclose(np.diag(information), [*curvature, 0, 0], rtol=1e-5)
    assert gradient[0] == 0  # no fit tells the defocus of another range


def test_what_light_does_not_tell_stays_where_it_is_known() -> None:
    """A free climb moves half a standard error and gains 1.0; measured errors are those without the prior."""
    problem, truth = behind_the_eye()
    along = weakest(free_f_number(problem, Start(truth), 0.01))
    waves = truth.waves + 0.3 * along
    start = Start(replace(truth, waves=waves))
    known = free_f_number(problem, start, 0.01, Prior.of_lens(NOLL, waves))
    free = free_f_number(problem, start, 0.01)
    moved = [abs((end.solution.state.waves - waves) @ along) for end in (known, free)]
    assert moved[0] < 0.006
    assert moved[1] > 0.08
    gained = free.solution.objective - known.solution.objective
    assert 0 < gained < 2
    of_modes = slice(len(NOLL))
    variances = [
        along @ end.measured.covariance[of_modes, of_modes] @ along for end in (known, free)
    ]
    assert np.sqrt(variances[0]) == pytest.approx(np.sqrt(variances[1]), rel=0.35)


@pytest.mark.parametrize(("known", "expected"), [(True, 0.00086), (False, 0.25)])
def test_a_refit_behind_a_cats_eye_stays_near_a_known_wavefront(
    known: bool, expected: float
) -> None:
    """A wavefront that is not known, 0.3 waves off, is drawn back to 0 by the prior."""
    problem, truth = behind_the_eye()
    along = weakest(free_f_number(problem, Start(truth), 0.01))
    begun = replace(truth, waves=truth.waves + 0.3 * along)
    views = Views(problem.frames, truth.poses, problem.noise)
    guess = Guesses(0.01, state=begun, known=known, deep=False)
    end = find_optima(CUT, CARPET, views, guess).best
    moved = abs((end.waves - begun.waves) @ along)
    assert expected / 2 < moved < 2 * expected


@pytest.mark.parametrize(("known", "starts"), [(True, 2), (False, 1)])
def test_a_search_behind_a_cats_eye_goes_on_until_known_modes_are_found(
    known: bool, starts: int
) -> None:
    """The frames tell coma: from the first start the climb leaves its modes for an optimum that explains them."""
    problem, truth = behind_the_eye()
    off = truth.waves + np.where(np.array(NOLL) == 7, 0.1, 0.0)
    views = Views(problem.frames, truth.poses, problem.noise)
    guess = Guesses(0.01, starts=(off, truth.waves), known=known, deep=False)
    found = find_optima(CUT, CARPET, views, guess)
    assert found.best.verdict.accepted
    assert found.starts == starts
