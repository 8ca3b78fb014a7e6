"""The likelihood about a wavefront that is held: a parabola next to an optimum, and no promise far from it."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.estimation.climb import Start
from labkit.estimation.expansion import Opened, camera_prior, free_f_number
from labkit.estimation.held import expanded_about
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH, photographed

F_NUMBER_STD = 0.01


@pytest.fixture(scope="module")
def model() -> ForwardModel:
    return ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )


def moved(waves: float) -> Start:
    """The truth with another defocus."""
    step = np.zeros(3 + 10 + 2)
    step[0] = waves
    return Start(TRUTH.moved(step))


def test_next_to_an_optimum_the_parabola_has_its_height_and_its_place(
    model: ForwardModel,
) -> None:
    problem = photographed(model)
    climbed = free_f_number(problem, Start(TRUTH), F_NUMBER_STD)
    held = expanded_about(problem, moved(0.004), F_NUMBER_STD)
    assert held.solution.objective == pytest.approx(climbed.solution.objective, abs=1.2)
    std = np.sqrt(np.diag(climbed.measured.covariance))
    away = np.abs((held.measured.values - climbed.measured.values) / std)
    assert away[:3].max() < 0.2  # 0.09 measured


@pytest.mark.parametrize("waves", [-0.1, -0.2])
def test_far_from_an_optimum_the_parabola_promises_no_more_than_the_photographs_have(
    model: ForwardModel, waves: float
) -> None:
    """Its maximum would be likelier than the optimum, by 300 and by 700; its end is less likely than its begin."""
    problem, start = photographed(model), moved(waves)
    climbed = free_f_number(problem, Start(TRUTH), F_NUMBER_STD)
    held = expanded_about(problem, start, F_NUMBER_STD)
    prior = camera_prior(problem.model.optics, F_NUMBER_STD)
    begun = Opened(problem, problem.drawn(start.state), start.state, *prior)
    assert begun.objective < held.solution.objective < climbed.solution.objective
