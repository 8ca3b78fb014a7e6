"""Where a target is in a test photograph: light and sharpness are judged there, not in the room."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from labkit.acquisition.camera_check import LoneCamera, Sighting, sighted
from labkit.finder.sharpness import sharpest_edge_px
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.target.target import CellTarget, open_target
from tests.plans import PORTRAIT, plan_text
from tests.rooms import Pose, as_counts, draw_target

WINDOW = np.s_[50:450, 60:400]


def photographed(
    white: float, *, plan_is_known: bool = True
) -> tuple[Photograph, Sighting]:
    """A target in a grey room with an overexposed window, out of focus by a Gaussian of 3 pixels; the window is sharp."""
    plan = Plan.parse(plan_text(PORTRAIT), Path())
    target = open_target(plan.target)
    assert isinstance(target, CellTarget)
    room: NDArray[Any] = np.full((600, 1200), 0.1, np.float32)
    pose = Pose(200, (300, 800), 5.0)
    draw_target(room, target.cells, pose, black=0.01, white=white, blur_px=3.0)
    room[WINDOW] = 3.0
    mosaic = Photograph(
        as_counts(room, np.random.default_rng(1)),
        np.full((2, 2), 600.0),
        16383.0,
        ("RG", "GB"),
    )
    no_camera = cast("Any", None)
    return mosaic, sighted(mosaic, LoneCamera(no_camera, plan, plan_is_known))


def test_a_window_beside_the_target_is_no_overexposure() -> None:
    mosaic, seen = photographed(white=0.6)
    assert seen.light is None
    assert seen.tiles_px is not None
    assert (mosaic.cropped(seen.place).counts < mosaic.white).all()
    # a Gaussian edge's contrast over its slope is sigma √(2 π) = 7.5 px; squares that blur together rise less steeply
    edge = sharpest_edge_px(mosaic, seen.place)
    assert edge is not None
    assert edge > 7.5
    whole = sharpest_edge_px(mosaic)
    assert whole is not None
    assert whole < 5


def test_an_overexposed_target_is_told_and_so_is_a_frame_without_a_known_target() -> None:
    for _, seen in (photographed(3.0), photographed(0.6, plan_is_known=False)):
        assert seen.light is not None
        assert seen.light.startswith("is overexposed")


def test_a_live_view_of_any_width_has_a_sharpness() -> None:
    # 424 × 640 pixels in three colours: cut within a pixel, the colours would be others
    light = np.full((424, 640), 500.0)
    light[100:300, 171:405] = 50000
    grey = np.rint(gaussian_filter(light, 3.0)).astype(np.uint16)
    colours = np.repeat(grey[:, :, None], 3, axis=2).reshape(424, -1)
    seen = Photograph(colours, np.zeros((1, 3)), 65535.0, ("RGB",))
    # as wide as in one colour; measured to 0.1 %
    alone = sharpest_edge_px(Photograph(grey, np.zeros((2, 2)), 65535.0, ("M",)))
    assert sharpest_edge_px(seen) == pytest.approx(alone, rel=2e-3)
