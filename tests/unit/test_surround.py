"""How light it is around a target, and a plan that says something else of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from labkit.finder.cut import is_surround_even, surround_level
from labkit.imaging.warp import Pose
from labkit.types import Floats

CORNERS = np.array([[30.0, 30.0], [30.0, 109.0], [109.0, 109.0], [109.0, 30.0]])
POSE = Pose.from_corners(CORNERS, (10.0, 10.0))
USED = np.ones((140, 140), bool)


def photographed(level: float, blur_px: float = 1.0) -> Floats:
    """Squares of 100 and 900 counts in a surround of 100 + 800 level, blurred."""
    light = np.full((140, 140), 100 + 800 * level)
    squares = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((10, 10)))
    light[30:110, 30:110] = 100 + 800 * squares
    return gaussian_filter(light, blur_px)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_the_surround_is_measured_by_the_targets_black_and_white(level: float) -> None:
    # a tenth of a square's pixels is 3.5 pixels from its edges and more: erfc(3.5 / sqrt 2) / 2 of the contrast is lost
    seen = surround_level(photographed(level), USED, POSE)
    assert seen == pytest.approx(level, abs=2.3e-4)


def test_of_what_is_not_seen_nothing_is_said() -> None:
    nothing = np.zeros_like(USED)
    nothing[40:100, 40:100] = True
    assert surround_level(photographed(1.0), nothing, POSE) is None
    assert surround_level(np.full((140, 140), 500.0), USED, POSE) is None


def is_even(light: Floats, surround: float) -> bool:
    return is_surround_even(light, USED, POSE, surround, np.full(light.shape, 9.0))


@pytest.mark.parametrize("surround", [0.0, 1.0])
@pytest.mark.parametrize("blur_px", [1.0, 2.0])
def test_a_clean_surround_is_even_in_uneven_light_out_of_focus_and_with_noise(
    surround: float, blur_px: float
) -> None:
    down, right = np.mgrid[-1:1:140j, -1:1:140j]
    light = photographed(surround, blur_px) * (1 - 0.2 * right - 0.1 * down**2)
    noise = np.random.default_rng(1).normal(0, 3.0, light.shape)
    assert is_even(light + noise, surround)


@pytest.mark.parametrize("surround", [0.0, 1.0])
@pytest.mark.parametrize("step", [-0.02, 0.02, 0.5])
def test_a_room_that_begins_beside_the_target_is_not_even(
    surround: float, step: float
) -> None:
    noise = np.random.default_rng(1).normal(0, 3.0, USED.shape)
    one_side = photographed(surround) + noise
    one_side[20:90, 117:] += 800 * step
    assert not is_even(one_side, surround)


def test_a_bezel_all_around_is_lighter_than_the_targets_black() -> None:
    light = photographed(0.0)
    framed = np.where(light < 101, 260.0, light)
    framed[31:109, 31:109] = light[31:109, 31:109]
    assert not is_even(framed, 0.0)
