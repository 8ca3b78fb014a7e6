"""Steps behind a cat's eye: the wavefront moves with the clear part, and to first order nothing changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.carried import carried
from labkit.estimation.climb import State
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.parts import CatsEye
from labkit.optics.other_circle import PLANES, moved_over
from labkit.optics.zernike import modes_at
from labkit.types import Floats
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH

NOLL = tuple(range(4, 16))
LEFT = replace(OPTICS, noll=NOLL, parts=(CatsEye(-0.6, 0.2, 0.0),))
RIGHT = replace(LEFT, parts=(CatsEye(0.6, -0.2, 0.0),))
"""Circles of the pupil's size cut the same clear part from opposite sides, about opposite centres."""

WAVES = 0.05 * np.random.default_rng(5).normal(size=len(NOLL)) + np.eye(len(NOLL))[0]
BEGIN = replace(TRUTH, waves=WAVES)


def picture(optics: Optics, state: State) -> Floats:
    model = ForwardModel.build(
        optics, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    (seen,) = model.means(state.waves, model.draw(state.poses), [np.ones(FRAME, bool)])
    return seen


def about_the_other_centre() -> State:
    """The wavefront and the pose on the left, for the pupil that is cut from the right."""
    away = np.subtract(LEFT.rim.centre, RIGHT.rim.centre)
    moved = moved_over(NOLL, np.append(np.zeros(PLANES), WAVES), away, 1.0)
    pose = RIGHT.tilted(POSE, moved[1:PLANES])
    return replace(BEGIN, waves=moved[PLANES:], poses=(pose,))


def test_a_wavefront_over_another_circle_is_the_same_at_every_point() -> None:
    waves = np.random.default_rng(6).normal(size=PLANES + len(NOLL))
    away, wider = np.array([0.2, -0.3]), 0.9
    moved = moved_over(NOLL, waves, away, wider)
    x, y = np.random.default_rng(7).uniform(-0.7, 0.7, (2, 50))
    every = (1, 2, 3, *NOLL)
    there = waves @ modes_at(every, away[0] + wider * x, away[1] + wider * y)
    np.testing.assert_allclose(moved @ modes_at(every, x, y), there, rtol=1e-7)


def test_a_pupil_makes_the_same_picture_wherever_its_full_circle_lies() -> None:
    seen = picture(LEFT, BEGIN)
    there = picture(RIGHT, about_the_other_centre())
    assert np.abs(there - seen).max() < 1.5e-4  # 8e-5 measured
    untilted = replace(about_the_other_centre(), poses=(POSE,))
    assert np.abs(picture(RIGHT, untilted) - seen).max() > 0.3  # 0.48 measured


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_to_first_order_steps_are_straight(share: float) -> None:
    """Twice the step is bent four times as far."""
    change = np.array([0.3, 0.1, -0.1, 0.05])
    waves = np.linspace(-0.1, 0.1, len(NOLL))

    def bent(share: float) -> Floats:
        straight = replace(BEGIN, waves=BEGIN.waves + share * waves)
        end = carried(BEGIN, straight, LEFT, share * change)
        return np.append(
            end.waves - straight.waves, end.poses[0].corners_px() - POSE.corners_px()
        )

    short, long = np.abs(bent(share)).max(), np.abs(bent(2 * share)).max()
    assert long == pytest.approx(4 * short, rel=0.1)  # 3.8 and 4.2 measured
