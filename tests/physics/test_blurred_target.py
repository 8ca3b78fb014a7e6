"""A target so blurred that a wrong pose is believed at first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.random_sessions import draw_with_parts, make
from labkit.finder.find_target import find_target
from labkit.photographs.decoding import read_photograph
from labkit.target.target import open_target


@pytest.mark.slow
def test_a_pose_out_of_the_frame_is_not_the_last_that_is_looked_at(tmp_path: Path) -> None:
    drawn = draw_with_parts(
        1, 62
    )  # smeared as well; the quadrilateral found first reached 14 pixels out of the frame
    make(drawn, tmp_path / "session")
    mosaic = read_photograph(
        next((tmp_path / "session/frames").glob("target_687.3_0.*")), drawn.plan.sensor
    )
    corners = find_target(mosaic, open_target(drawn.plan.target))
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(
        sides, 61.3, rtol=0.03
    )  # what lens, range and size of the target make it; 62.1 was found
