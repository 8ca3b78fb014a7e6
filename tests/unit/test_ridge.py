"""The ridge of a likelihood: pose, light and noise follow the values that a session prescribes."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.estimation.climb import Problem, Start, State
from labkit.estimation.expansion import expand, free_f_number, with_optics_about
from labkit.estimation.identifiability import inverse
from labkit.estimation.ridge import Ridge
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from tests.unit.test_cone import CARPET, FRAME, MODES, OPTICS, POSE, TRUTH, photographed

CONE = 3
"""Place of ln of the f-number, behind three modes; then come pose, light and noise."""


@pytest.fixture(scope="module")
def model() -> ForwardModel:
    return ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )


def own_away(problem: Problem, optics: Optics, state: State) -> float:
    """How far pose, light and noise are from their likeliest values given all others, in standard errors."""
    there = with_optics_about(problem.model, optics, state)
    expansion = expand(Problem(there, problem.frames, problem.noise), Start(state))
    own = slice(CONE + 1, None)
    covariance = inverse(expansion.information[own, own])
    away = covariance @ expansion.gradient[own]
    return float(np.abs(away / np.sqrt(np.diag(covariance))).max())


def test_own_parameters_follow_prescribed_values(model: ForwardModel) -> None:
    problem = photographed(model)
    freed = free_f_number(problem, Start(TRUTH), 0.03)
    root = np.linalg.cholesky(freed.measured.covariance)
    # the scale as the others have it, for it is prescribed too
    values = freed.ridge.values + root @ [1, -1, 1, 1, 0]
    step = freed.ridge.step(values)
    state = freed.solution.state
    moved = state.moved(np.delete(step, CONE))
    np.testing.assert_allclose(moved.waves, values[MODES], rtol=1e-9)
    optics = freed.optics.with_camera_parameters(values[[CONE]])
    assert step[CONE] == pytest.approx(values[CONE] - np.log(freed.optics.f_number))
    alone = np.append(step[MODES], np.zeros(len(step) - CONE - 1))
    assert own_away(problem, optics, moved) < 0.04  # 0.018 measured
    assert own_away(problem, optics, state.moved(alone)) > 0.4  # 0.72 measured


def test_about_the_twin_even_modes_follow_the_other_way() -> None:
    """Of two modes, the first even, the cone and the scale; with a further parameter of its own."""
    signs = np.array([-1.0, 1.0, 1.0, 1.0])
    slopes = np.random.default_rng(0).normal(size=(4, 5))
    ridge = Ridge(np.array([0.1, 0.02, 1.0, -3.0]), slopes)
    change = np.array([0.01, 0.02, 0.03, 0.04])
    step = ridge.step(ridge.values + change)
    other = ridge.twin(signs).step(signs * (ridge.values + change))
    np.testing.assert_allclose(other, step * [-1, 1, 1, 1, 1])
