"""How light it is around a target, and a plan that says something else of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from labkit.finder.cut import surround_level
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
