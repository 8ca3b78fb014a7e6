"""Coarse photographs: means over squares of pixels, poses that keep their places, and when a search from random starts ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation import together
from labkit.estimation.climb import NoisePrior
from labkit.estimation.coarse import Coarse
from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import Views
from labkit.estimation.settings import SETTINGS
from labkit.imaging.optics import Optics
from labkit.imaging.parts import CatsEye
from labkit.imaging.warp import Pose
from labkit.jobs.sharing import share
from labkit.target.target import CellTarget
from labkit.types import Floats

OPTICS = Optics(
    wavelength_nm=500.0, reference_nm=500.0, f_number=4.0, pitch_um=4.0, active_um=3.6
)
WIDE_AIRY = 6.0
"""Three pixels."""
DEAD = 3, 4
CORNERS = np.array([[8.0, 9.0], [8.0, 30.0], [29.0, 30.0], [29.0, 9.0]])


def frame() -> FrameData:
    """A frame with a gradient, whose sides are no multiples of three, and a dead pixel."""
    rows, columns = np.indices((38, 40))
    used = np.ones((38, 40), bool)
    used[DEAD] = False
    counts = np.where(used, 100.0 + 2 * rows + columns, np.nan)
    return FrameData(counts, used, np.ones((38, 40)), np.full((38, 40), 0.01))


@pytest.fixture
def coarse() -> Coarse:
    target = CellTarget(np.eye(3), (30.0, 30.0), 0.0)
    pose = Pose.from_corners(CORNERS, target.size_mm)
    views = Views((frame(),), (pose,), NoisePrior(0.9, 0.01, 9.0, 0.02))
    return Coarse.of(OPTICS, target, views, WIDE_AIRY)


def test_a_coarse_pixel_has_the_mean_of_its_used_pixels(coarse: Coarse) -> None:
    counts = coarse.sketch.frame.counts
    assert counts.shape == (12, 13)
    # the middle of the square in rows 6 to 8 and columns 9 to 11
    assert counts[2, 3] == pytest.approx(100 + 2 * 7 + 10)
    # less the dead pixel, 110 of nine that are 112 in the mean
    assert counts[1, 1] == pytest.approx((9 * 112 - 110) / 8)


def test_its_noise_is_that_of_a_mean(coarse: Coarse) -> None:
    noise = coarse.sketch.noise
    assert (noise.gain, noise.read_variance) == pytest.approx((0.1, 1.0))
    np.testing.assert_allclose(coarse.sketch.frame.relative_std, 0.01 / 3)


def test_it_is_as_wide_as_its_pixels_and_their_gaps(coarse: Coarse) -> None:
    optics = coarse.sketch.optics
    assert (optics.pitch_um, optics.active_um) == pytest.approx((12.0, 11.6))
    assert optics.wavelength_nm == 500.0  # six lambda N need no longer wavelength


def test_a_pose_in_coarse_pixels_keeps_its_place(coarse: Coarse) -> None:
    # the middle of the first coarse pixel is that of pixel (1, 1)
    corners = (CORNERS - 1) / 3
    np.testing.assert_allclose(coarse.sketch.pose.corners_px(), corners, atol=1e-9)
    state = coarse.state(np.full(12, 0.01))
    np.testing.assert_allclose(coarse.pose(state).corners_px(), CORNERS, atol=1e-9)


TASK = together.TogetherTask(
    OPTICS, (OPTICS,), share(CellTarget(np.eye(3), (30.0, 30.0), 0.0)), (), (0.0, 1.0)
)
"""A search over two stations, whose climbs are played."""


def test_starts_end_with_the_second_that_reaches_the_best_optimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reached = iter([(0.3, -9.0), (0.0, -1.0), (0.6, -5.0), (0.6, -5.0), (0.01, -1.1)])

    def climbed(task: object, width: object, begun: object) -> together._End:
        at, height = next(reached)
        return together._End(OPTICS, (np.full(1, at),), height=height)

    monkeypatch.setattr(together, "_climbed", climbed)
    ends = together._from_random_starts(TASK, WIDE_AIRY)
    assert len(ends) == 5
    assert [end.height for end in together._distinct(ends)] == [-1.0, -5.0, -9.0]


def test_starts_are_no_more_than_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    starts = list[Floats]()

    def elsewhere(task: object, width: object, begun: together._End) -> together._End:
        starts.append(begun.waves[0])
        at = np.full(1, float(len(starts)))
        return together._End(OPTICS, (at,), height=len(starts))

    monkeypatch.setattr(together, "_climbed", elsewhere)
    together._from_random_starts(TASK, WIDE_AIRY)
    assert len(starts) == SETTINGS.strong_starts
    assert all(start[0] and start[1:].any() for start in starts)


def test_other_pupils_go_on_from_the_best_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each climbs once in the coarsest pictures; of all, the likeliest climb in the finer ones."""
    eyes = tuple(replace(OPTICS, parts=(one,)) for one in CatsEye().starts(()))
    begun = list[tuple[float, together._End]]()

    def climbed(task: object, width: float, start: together._End) -> together._End:
        begun.append((width, start))
        height = 1.0 + eyes.index(start.optics) if start.optics in eyes else 0.0
        return replace(start, height=height)

    monkeypatch.setattr(together, "_climbed", climbed)
    ends = together.search_together(replace(TASK, pupils=eyes))
    coarsest, finer = SETTINGS.coarse_airy
    (first,) = {tuple(s.waves[0]) for w, s in begun if s.optics in eyes}
    random = [s for w, s in begun if s.optics == OPTICS]
    assert first in {tuple(start.waves[0]) for start in random}
    assert [s.optics for w, s in begun if w == coarsest][len(random) :] == [*eyes]
    assert [s.optics for w, s in begun if w == finer] == [*eyes[:-4:-1]]
    assert [optics for optics, _ in ends] == [*eyes[:-4:-1]]
