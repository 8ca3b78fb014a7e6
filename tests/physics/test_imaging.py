"""Grid, warp, scene, blur and forward model against direct sums, a brute-force simulation and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.imaging.blur import Blur
from labkit.imaging.grid import Torus
from labkit.imaging.model import ForwardModel
from labkit.imaging.scene import Scene
from labkit.imaging.warp import Pose
from labkit.optics.psf import Pupil
from labkit.target.target import CellTarget
from labkit.types import Floats

from .brute_force import (
    CARPET,
    CORNERS,
    FRAME,
    OPTICS,
    WAVES,
    brute_force_mean,
    points_seen,
)

USED = np.ones(FRAME, bool)
POSE = Pose.from_corners(CORNERS, CARPET.size_mm)


@pytest.fixture(scope="module")
def model() -> ForwardModel:
    return ForwardModel.build(OPTICS, CARPET, FRAME, POSE)


@pytest.fixture
def pose() -> Pose:
    return POSE


def test_sampling_is_point_evaluation_of_a_band_limited_image() -> None:
    torus = Torus((12, 15), (2, 3), (7, 9), 4, 5.0, 0.3)
    rng = np.random.default_rng(3)

    def waves(
        row: Floats, column: Floats
    ) -> Floats:  # up to 0.29 cycles/um: far beyond the pixels' Nyquist frequency
        total = np.full(np.broadcast_shapes(row.shape, column.shape), 2.0)
        for u, v, a, b in zip(rng_u, rng_v, rng_a, rng_b, strict=True):
            total = total + a * np.cos(2 * np.pi * (u * row / 12 + v * column / 15) + b)
        return total

    rng_u, rng_v = rng.integers(0, 17, 8), rng.integers(-21, 22, 8)
    rng_a, rng_b = rng.normal(size=8), rng.uniform(0, 6, 8)
    fine = waves(np.arange(48)[:, None] / 4, np.arange(60)[None] / 4)
    expected = waves(np.arange(2.0, 9)[:, None], np.arange(3.0, 12)[None])
    np.testing.assert_allclose(
        torus.sample(torus.half_spectrum(fine)), expected, atol=1e-12
    )


def test_a_torus_too_coarse_for_its_band_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot hold"):
        Torus((12, 15), (2, 3), (7, 9), 2, 5.0, 0.3)


def test_corners_come_in_the_targets_own_order_as_row_and_column(pose: Pose) -> None:
    np.testing.assert_allclose(pose.corners_px(), CORNERS, atol=1e-12)
    right_edge = pose.to_pixels(np.array(0.0), np.array(1.0))
    assert right_edge[1] > 40  # x runs along columns
    assert 11 < right_edge[0] < 41


def test_pixels_and_target_lead_back_to_each_other(pose: Pose) -> None:
    y, x = np.random.default_rng(4).uniform(-1, 1, (2, 50))
    where = pose.to_pixels(y, x)
    np.testing.assert_allclose(pose.to_target(where[:, 0], where[:, 1]), (y, x), atol=1e-12)
    np.testing.assert_allclose(
        pose.shifted(3, -5).to_pixels(y, x), where - [3, -5], atol=1e-11
    )


def pinhole(tilts_deg: tuple[float, float], aside_mm: float) -> Pose:
    """A target of 30 mm by 20, 400 mm before a camera of 12000 pixels' focal length, tilted, and beside its axis."""
    a, b = np.radians(tilts_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    y, x = np.array([-10.0, -10, 10, 10]), np.array([-15.0, 15, 15, -15])
    right, down, away = about_y @ about_x @ np.stack([x, y, 0 * x]) + np.array(
        [[aside_mm], [0], [400]]
    )
    return Pose.from_corners(
        12000 * np.stack([down / away, right / away], axis=1), (20.0, 30.0)
    )


@pytest.mark.parametrize("tilts_deg", [(0.0, 0.0), (8.0, 0.0), (0.0, -5.0), (6.0, 9.0)])
@pytest.mark.parametrize("aside_mm", [0.0, 25.0])
def test_the_scale_along_the_line_that_does_not_recede_is_that_of_a_target_that_does_not_lean(
    tilts_deg: tuple[float, float], aside_mm: float
) -> None:
    pose = pinhole(tilts_deg, aside_mm)
    assert pose.log_scale()[0] + pose.log_foreshortening() == pytest.approx(
        np.log(12000 / 400), abs=1e-12
    )


def test_the_mean_scale_is_less_by_half_of_ln_cos_of_a_tilt_and_its_slopes_are_differences() -> (
    None
):
    pose = pinhole((8.0, 0.0), 0.0)
    assert pose.log_foreshortening() == pytest.approx(
        -0.5 * np.log(np.cos(np.radians(8.0))), abs=1e-12
    )
    size = np.array([1e-3] * 6 + [1e-6] * 2)
    for slope, step in zip(pose.log_scale()[1], np.diag(size), strict=True):
        high, low = (pose.moved(s).log_scale()[0] for s in (step, -step))
        assert slope == pytest.approx((high - low) / (2 * step.sum()), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("tilts_deg", "along_rows"), [((8.0, 0.0), 1.0), ((0.0, -5.0), -1.0)]
)
def test_a_leaning_target_is_longest_along_the_line_that_does_not_recede(
    tilts_deg: tuple[float, float], along_rows: float
) -> None:
    cosine = np.cos(np.radians(np.sum(tilts_deg)))
    wanted = (-0.5 * np.log(cosine) * along_rows, 0.0)
    assert pinhole(tilts_deg, 0.0).log_stretch() == pytest.approx(wanted, abs=1e-12)


def test_the_motion_of_points_is_its_finite_difference(pose: Pose) -> None:
    row, col = np.random.default_rng(5).uniform(12, 40, (2, 20))
    y, x = pose.to_target(row, col)
    rows, cols = pose.jacobian(row, col)
    for k, step in enumerate(1e-6 * np.eye(8)):
        change = (
            pose.moved(step).to_pixels(y, x) - pose.moved(-step).to_pixels(y, x)
        ) / 2e-6
        np.testing.assert_allclose(np.stack([rows[k], cols[k]], -1), change, atol=1e-6)


def test_a_drawn_target_has_the_means_of_a_raster_of_points(
    model: ForwardModel, pose: Pose
) -> None:
    scene = model.scene
    many, (top, left) = scene.torus.oversampling, scene.torus.margin
    fine = np.roll(
        scene.image(pose), (-top * many + many // 2, -left * many + many // 2), axis=(0, 1)
    )
    ours = fine[: 54 * many, : 56 * many].reshape(54, many, 56, many).mean(axis=(1, 3))
    # the raster of points errs by a step of 0.05 pixels along some edges, with either sign
    assert ours.sum() == pytest.approx(area_of_white(), rel=2e-3)


def area_of_white() -> float:
    step = 0.05
    rows, cols = np.meshgrid(np.arange(0, 54, step), np.arange(0, 56, step), indexing="ij")
    return float(points_seen(rows, cols).sum()) * step**2


def test_the_mean_is_that_of_a_brute_force_simulation(
    model: ForwardModel, pose: Pose
) -> None:
    ours = model.means(WAVES, model.draw([pose]), [USED])[0].reshape(FRAME)
    difference = ours - brute_force_mean()
    # its raster of points errs by up to 1/48 of a pixel along an edge, and its window folds the halo beyond 73 lambda N
    # back: 0.0027 at most and 0.00024 RMS were measured
    assert np.abs(difference).max() < 3.5e-3
    assert np.sqrt(np.mean(difference**2)) < 4e-4


def test_a_uniform_scene_stays_uniform(pose: Pose) -> None:
    white = CellTarget(np.ones((1, 1)), (30.0, 30.0), 1.0)
    one = ForwardModel.build(OPTICS, white, (20, 24), pose)
    np.testing.assert_allclose(
        one.means(WAVES, one.draw([pose]), [np.ones((20, 24), bool)])[0], 1.0, atol=1e-9
    )
    # the PSF's light beyond its window is what both wavefronts share; the rest must cancel
    assert one.blur.transfer(WAVES)[0, 0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("nu", "mtf"), [(0.1, 0.872889), (0.25, 0.685038), (0.5, 0.391002), (0.75, 0.144294)]
)
def test_the_blur_of_a_perfect_lens_has_the_published_mtf(nu: float, mtf: float) -> None:
    torus = Torus(
        (400, 400), (0, 0), (9, 9), 3, 4.4, 1 / 4.4
    )  # row k is at k/400 of the cutoff 1/(lambda N)
    blur = Blur(torus, Pupil(0.55, 0.45, 8.0, 4.4 / 3, 600, (4,)), 0.0)
    assert blur.transfer(np.zeros(1))[round(400 * nu), 0].real == pytest.approx(
        mtf, abs=1e-6
    )


def test_what_comes_around_the_torus_is_taken_off(model: ForwardModel, pose: Pose) -> None:
    torus = model.blur.torus
    wider = replace(
        torus,
        pixels=(torus.pixels[0] * 3, torus.pixels[1] * 3),
        margin=(torus.margin[0] + torus.pixels[0], torus.margin[1] + torus.pixels[1]),
    )
    scene = Scene(wider, CARPET, model.scene.cutoff_per_um, pose)
    blur = Blur(wider, model.blur.pupil, OPTICS.active_um)
    wide = ForwardModel(OPTICS, scene, blur, blur, np.zeros(FRAME))
    (ours,), (theirs,) = (m.means(WAVES, m.draw([pose]), [USED]) for m in (model, wide))
    # it varies by 1.6e-5 about 8.4e-5; left are 7e-8 RMS about 8e-6, which is ambient light
    assert np.ptp(model.wrapped) > 1e-5
    assert np.std(ours - theirs) < 1.4e-7
    assert np.abs(ours - theirs).max() < 1.6e-5


def test_derivatives_by_the_wavefront_are_finite_differences(
    model: ForwardModel, pose: Pose
) -> None:
    slopes = model.evaluate(WAVES, model.draw([pose]), [USED])[0].by_waves
    for k, step in enumerate(1e-4 * np.eye(WAVES.size)):
        high, low = (
            model.means(WAVES + s, model.draw([pose]), [USED])[0] for s in (step, -step)
        )
        # the third derivative, about (4 pi)^3, over 6, times 1e-8
        assert np.abs(slopes[k] - (high - low) / 2e-4).max() < 1e-5 * np.abs(slopes).max()


def test_derivatives_by_the_pose_are_finite_differences(
    model: ForwardModel, pose: Pose
) -> None:
    slopes = model.evaluate(WAVES, model.draw([pose]), [USED], by_waves=False)[0].by_pose
    size = np.array(
        [1e-3] * 6 + [1e-3 / 30] * 2
    )  # v6 and v7 move a corner by as many pixels times 40
    for k, step in enumerate(np.diag(size)):
        high, low = (
            model.means(WAVES, model.draw([pose.moved(s)]), [USED])[0]
            for s in (step, -step)
        )
        difference = (high - low) / (2 * size[k])
        # perspective is exact up to the square of blur over distance, about 1e-3
        assert np.abs(slopes[k] - difference).max() < 3e-3 * np.abs(slopes[k]).max()
