"""Wavefronts from nothing, on photographs that labkit's model did not form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData
from labkit.imaging.parts import LowPass
from labkit.imaging.warp import Pose
from labkit.inference.fit import WavefrontFit, canonical, fit_wavefront, residuals
from labkit.optics.zernike import twin_signs
from labkit.types import Floats

from .brute_force import CARPET, CORNERS, FRAME, OPTICS, WAVES, brute_force_mean

GAIN, READ_VARIANCE, SCALE, AMBIENT = 0.25, 4.0, 1500.0, 40.0
PRIOR = NoisePrior(GAIN, 0.01, READ_VARIANCE, 0.02)


def photograph(rng: np.random.Generator) -> FrameData:
    """6000 electrons at white: noise fifty times the 0.00024 RMS by which the brute force differs from the model."""
    mean = SCALE * brute_force_mean() + AMBIENT
    counts = rng.normal(mean, np.sqrt(GAIN * mean + READ_VARIANCE))
    return FrameData(counts, np.ones(FRAME, bool), np.ones(FRAME), np.zeros(FRAME))


def rough_pose(rng: np.random.Generator) -> Pose:
    """Corners as the finder has them: within a pixel."""
    return Pose.from_corners(CORNERS + rng.uniform(-0.8, 0.8, (4, 2)), CARPET.size_mm)


def fitted(seed: int, frames: int = 1, starts: tuple[Floats, ...] = ()) -> WavefrontFit:
    rng = np.random.default_rng(seed)
    seen, poses = [photograph(rng) for _ in range(frames)], [rough_pose(rng) for _ in range(frames)]
    return fit_wavefront(OPTICS, CARPET, seen, poses, PRIOR, rng=rng, starts=starts)


@pytest.fixture(scope="module")
def fit() -> WavefrontFit:
    return fitted(1)


@pytest.mark.parametrize("seed", [2, 3])
def test_from_nothing_every_mode_ends_within_four_standard_errors(seed: int) -> None:
    found = canonical(fitted(seed))
    assert np.all(np.abs(found.waves - WAVES) < 4 * found.std)
    assert found.std.max() < 1e-3
    assert found.verdict.accepted
    # of n normals squared the mean has a standard deviation of sqrt(2/n); allow four
    assert found.chi2_per_pixel == pytest.approx(1, abs=4 * np.sqrt(2 / (FRAME[0] * FRAME[1])))


def test_the_light_and_the_pose_come_with_it(fit: WavefrontFit) -> None:
    # four of their standard errors, 1.2 and 0.09 counts; corners are known to about 0.01 pixels
    assert fit.state.scales[0] == pytest.approx(SCALE, abs=4 * 1.2)
    assert fit.state.ambients[0] == pytest.approx(AMBIENT, abs=4 * 0.09)
    assert np.abs(fit.state.poses[0].corners_px() - CORNERS).max() < 0.05


def test_two_frames_tell_more_than_one(fit: WavefrontFit) -> None:
    both = canonical(fitted(4, frames=2))
    assert np.all(np.abs(both.waves - WAVES) < 4 * both.std)
    np.testing.assert_allclose(both.std / fit.std, np.sqrt(0.5), rtol=0.05)


def test_from_a_start_that_is_given_the_same_optimum_is_found(fit: WavefrontFit) -> None:
    near = fitted(1, starts=(WAVES + 0.03,))
    assert np.all(np.abs(near.waves - WAVES) < 4 * near.std)
    assert near.objective == pytest.approx(fit.objective, abs=0.1)


WRONG = np.array([-0.27, -0.06, -0.04, 0.15, 0.06])
"""A start that ends in another optimum."""


def test_of_several_starts_the_likeliest_end_is_kept(fit: WavefrontFit) -> None:
    found = fitted(1, starts=(WRONG, WAVES - 0.03))
    assert found.starts == 2
    assert found.objective == pytest.approx(fit.objective, abs=0.1)


def test_a_wrong_start_alone_is_rejected_and_others_are_tried(fit: WavefrontFit) -> None:
    found = fitted(1, starts=(WRONG,))
    assert found.starts > 1
    assert found.verdict.accepted
    assert found.objective == pytest.approx(fit.objective, abs=0.1)


def test_a_part_that_the_model_has_is_not_missing(fit: WavefrontFit) -> None:
    rng = np.random.default_rng(1)
    seen, poses, camera = [photograph(rng)], [rough_pose(rng)], (LowPass(),)
    found = fit_wavefront(
        replace(OPTICS, parts=camera), CARPET, seen, poses, PRIOR, rng=rng, starts=(WRONG,), missing=camera
    )
    assert found.verdict.accepted
    assert [part.name for part in found.optics.parts] == ["low_pass_filter"]
    assert np.all(np.abs(found.waves - WAVES) < 4 * found.std)


def test_the_same_frames_and_seed_give_the_same_numbers(fit: WavefrontFit) -> None:
    again = fitted(1)
    np.testing.assert_array_equal(again.waves, fit.waves)
    np.testing.assert_array_equal(again.covariance, fit.covariance)


def test_a_fit_and_its_twin_are_alike_in_all_but_even_modes(fit: WavefrontFit) -> None:
    twin = fit.twin()
    np.testing.assert_array_equal(twin_signs(OPTICS.noll), [-1, -1, 1, 1, -1])  # Noll 4, 6 and 11 are even
    np.testing.assert_array_equal(twin.waves, fit.waves * [-1, -1, 1, 1, -1])
    np.testing.assert_array_equal(twin.std, fit.std)
    assert twin.covariance[0, 2] == -fit.covariance[0, 2]
    assert twin.covariance[0, 1] == fit.covariance[0, 1]
    np.testing.assert_array_equal(twin.twin().covariance, fit.covariance)


def test_of_twins_the_one_with_its_largest_even_mode_positive_is_canonical(fit: WavefrontFit) -> None:
    for one in (fit, fit.twin()):
        assert canonical(one).waves[0] > 0
    odd = replace(fit, noll=(7, 8), state=replace(fit.state, waves=np.array([-0.3, 0.1])))
    assert canonical(odd) is odd


def test_residuals_are_the_frames_less_the_fit_in_its_own_noise(fit: WavefrontFit) -> None:
    rng = np.random.default_rng(1)
    frame = photograph(rng)  # the first thing that the fit of this seed drew
    ((mean, std),) = residuals(fit, [frame])
    z = (frame.counts.ravel() - mean) / std
    assert np.mean(z**2) == pytest.approx(fit.chi2_per_pixel, rel=1e-9)
    np.testing.assert_allclose(std, np.sqrt(fit.state.gain * mean + fit.state.read_noise**2), rtol=1e-12)
