"""How large a fit is before it begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from labkit.analysis.fit_size import USUAL_TARGET_PX, fit_size, target_px
from labkit.plan import Plan
from labkit.session.frame import Frame
from tests.plans import PORTRAIT, RED_AND_GREEN

PLAN = Plan.from_tables({**PORTRAIT, **RED_AND_GREEN})


def target(range_mm: float | None) -> Frame:
    name = f"{range_mm}.dng"
    return Frame(name, "target", range_mm, name, None, "2026-01-01T00:00:00", Path(name))


def test_the_targets_picture_is_as_large_as_a_thin_lens_makes_it() -> None:
    lens, sensor = PLAN.lens, PLAN.sensor
    magnification = lens.focal_length_mm / (3000.0 - lens.focal_length_mm)
    side = 1000 * PLAN.target.size_mm * magnification / sensor.pixel_pitch_um
    assert target_px(PLAN, 3000.0) == pytest.approx(side)
    assert target_px(PLAN, None) == USUAL_TARGET_PX
    assert target_px(PLAN, 1.0) == USUAL_TARGET_PX


def test_a_fit_grows_with_ranges_channels_and_photographs_and_is_shared_by_processes() -> (
    None
):
    near, far = [target(3000.0)], [target(3000.0), target(3200.0)]
    one = fit_size(near, PLAN, None, "G", 1)
    assert 1 < one < 3
    assert fit_size(near, PLAN, None, None, 1) == pytest.approx(2 * one)
    assert fit_size(near * 3, PLAN, None, "G", 1) > one
    assert fit_size(far, PLAN, None, None, 1) > 3 * one
    assert fit_size(far, PLAN, 3000.0, "G", 1) == pytest.approx(one)
    assert fit_size(far, PLAN, None, None, 2) == fit_size(far, PLAN, None, None, 1) / 2
    # no more processes than fits
    assert fit_size(near, PLAN, None, "G", 64) == pytest.approx(one)
