"""A target that shines unevenly: against brute force, closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.calibration.flats import Falloff
from labkit.imaging.brightness import SHARE_STD, Brightness
from labkit.imaging.model import ForwardModel
from labkit.imaging.warp import Pose
from labkit.types import Floats

from .brute_force import CARPET, CORNERS, FRAME, OPTICS, WAVES, brute_force_mean

USED = np.ones(FRAME, bool)
POSE = Pose.from_corners(CORNERS, CARPET.size_mm)
ROWS, COLUMNS = np.indices(FRAME, float)


def light(rows: Floats, columns: Floats) -> Floats:
    """Brighter to one corner, by 1 % a pixel at most, and bent."""
    y, x = np.clip(rows / 27 - 1, -1, 1), np.clip(columns / 28 - 1, -1, 1)
    return np.asarray(np.exp(0.15 * y - 0.2 * x + 0.04 * x**2 - 0.03 * x * y))


def model(share: float) -> ForwardModel:
    seen = Brightness.fitted(light(ROWS, COLUMNS) ** share, USED)
    return ForwardModel.build(OPTICS, CARPET, FRAME, POSE, brightness=seen)


def mean(of: ForwardModel) -> Floats:
    (seen,) = of.means(WAVES, of.draw([POSE]), [USED])
    return np.asarray(seen.reshape(FRAME))


def test_light_is_blurred_with_the_target_that_shines() -> None:
    truth = brute_force_mean(light) / light(ROWS, COLUMNS) - brute_force_mean()
    inside = np.s_[8:-8, 8:-8]  # beyond the frame the two lights are not the same
    ours = mean(model(1.0)) - mean(model(0.0))
    assert np.std(truth[inside]) == pytest.approx(0.00168, rel=0.02)
    assert np.std((ours - truth)[inside]) < 0.02 * np.std(truth[inside])


def test_its_share_has_the_slope_that_differences_have() -> None:
    uneven = model(0.05)
    (evaluation,) = uneven.evaluate(WAVES, uneven.draw([POSE]), [USED], by_camera=True)
    difference = mean(model(0.1)) - mean(model(0.0))
    ours = 0.1 / (0.05 * SHARE_STD) * evaluation.by_brightness[0].reshape(FRAME)
    assert np.std(ours - difference) < 0.05 * np.std(difference)


def test_a_curvature_round_about_the_middle_has_the_slope_that_differences_have() -> None:
    bent_std = np.hypot(
        0.04 / 28**2, 0.03 / (27 * 28)
    )  # as large as those of xx - yy and of xy
    bent = np.exp(0.1 * bent_std * ((ROWS - 27) ** 2 + (COLUMNS - 28) ** 2) / 2)
    one, other = (
        ForwardModel.build(
            OPTICS,
            CARPET,
            FRAME,
            POSE,
            brightness=Brightness.fitted(light(ROWS, COLUMNS) * by, USED),
        )
        for by in (1 / bent, bent)
    )
    (evaluation,) = (flat := model(1.0)).evaluate(
        WAVES, flat.draw([POSE]), [USED], by_camera=True
    )
    inside = np.s_[8:-8, 8:-8]  # beyond the frame light is that of its edge
    difference = (mean(other) - mean(one))[inside].ravel()
    # brighter in all, which is the light's level, and a faint veil of second order
    terms = (
        np.stack([0.2 * evaluation.by_brightness[1], evaluation.mean], axis=-1)
        .reshape(*FRAME, 2)[inside]
        .reshape(-1, 2)
    )
    (share, _), (left,) = np.linalg.lstsq(terms, difference, rcond=None)[:2]
    assert share == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(left / difference.size) < 0.25 * np.std(difference)


def test_slopes_by_modes_and_pose_are_those_of_the_uneven_target() -> None:
    uneven, step = model(1.0), 1e-4
    drawing = uneven.draw([POSE])
    (evaluation,) = uneven.evaluate(WAVES, drawing, [USED])
    for k in range(WAVES.size):
        moved = step * np.eye(WAVES.size)[k]
        (up,), (down,) = (
            uneven.means(WAVES + by, drawing, [USED]) for by in (moved, -moved)
        )
        slope = (up - down) / (2 * step)
        assert np.abs(evaluation.by_waves[k] - slope).max() < 7e-7 * np.abs(slope).max()
    for k in range(8):
        moved = step * np.eye(8)[k]
        (up,), (down,) = (
            uneven.means(WAVES, uneven.draw([POSE.moved(by)]), [USED])
            for by in (moved, -moved)
        )
        slope = (up - down) / (2 * step)
        # slopes leave out that the light does not move with the target; this one is thirty times as steep as a panel's
        assert np.abs(evaluation.by_pose[k] - slope).max() < 0.035 * np.abs(slope).max()


def test_beyond_the_frame_light_is_that_of_its_edge() -> None:
    seen = Brightness.fitted(light(ROWS, COLUMNS), USED)
    far, edge = (
        seen.at(np.array(rows), np.array([5.0])) for rows in ([-30.0, 80.0], [0.0, 53.0])
    )
    np.testing.assert_allclose(far, edge)


def test_the_lens_has_what_lies_round_about_the_middle() -> None:
    y, x = np.indices((90, 120), float)
    away = np.hypot(y - 44.5, x - 59.5) / 200
    natural, panel = np.cos(np.arctan(away)) ** 4, 1 + 2e-4 * (x - 59.5) - 1e-4 * (y - 44.5)
    falloff = Falloff.of((natural * panel).astype(np.float32), (90, 120))
    rest = natural * panel / falloff.at((slice(0, 90), slice(0, 120)))
    np.testing.assert_allclose(rest, panel * np.mean(rest / panel), rtol=2e-4)
    assert np.ptp(natural) > 0.2


def test_the_middle_is_that_of_a_picture_in_colours_too() -> None:
    y, x = np.indices((90, 120), float)
    natural = np.exp(-0.3 * ((y - 44.5) ** 2 + (x - 59.5) ** 2) / (44.5**2 + 59.5**2))
    grey, colours = (
        Falloff.of(part.astype(np.float32), (90, 120))
        for part in (natural, np.repeat(natural, 3, axis=1))
    )
    assert grey.powers == pytest.approx((-0.3, 0.0), abs=1e-5)
    assert colours.powers == pytest.approx(grey.powers, abs=1e-6)
