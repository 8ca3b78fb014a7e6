"""The forward model, the penalty and their derivatives; kriging and error maps against dense algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.restoration.errors import random_error, standard_errors
from labkit.restoration.job import Job
from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.roughness import Roughness
from labkit.restoration.solve import Point
from labkit.restoration.strength import DISCREPANCY
from labkit.restoration.tiles import restore_job
from labkit.restoration.views import Views
from tests.physics.restoration_samples import WHITE, exposed, job, world

RNG = np.random.default_rng(0)
COUPLING = np.array([[1.0, -0.6], [-0.6, 1.4]])


def two_colours(frame: int = 16, guard_px: int = 4) -> Views:
    """Green's two planes and red's, the latter shifted."""
    counts = RNG.uniform(200, 300, (frame, frame))
    base = job(counts, places=((0, 1), (1, 0)), guard_px=guard_px)
    red = replace(
        base.colours[0],
        name="R",
        places=((0, 0),),
        motion=np.array([[0, 0, 0.3], [0, 0, -0.2]]),
    )
    both = replace(base, colours=(base.colours[0], red), coupling=COUPLING)
    views = both.views((slice(0, frame), slice(0, frame)))
    assert views is not None
    return views


def scene_on(views: Views) -> np.ndarray:
    return np.asarray(RNG.uniform(100, 400, (views.components, *views.grid.shape)))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -1.3)])
def test_a_scene_looks_as_the_independent_camera_photographs_it(
    shift: tuple[float, float],
) -> None:
    # the camera's torus is the scene's whole period, so that nothing is cut off; squares are drawn by four samples
    whole = replace(world(), camera=replace(world().camera, frame=80))
    base = job(np.zeros((80, 80)), samples=8, guard_px=0)
    colour = replace(base.colours[0], motion=np.array([[0, 0, shift[0]], [0, 0, shift[1]]]))
    views = replace(base, colours=(colour,)).views((slice(0, 80), slice(0, 80)))
    assert views is not None
    spectra = views.grid.spectrum(whole.truth(8)[None])
    # 0.2 %: a mean over a sample is not the scene's band-limited value there, 5e-4 in measurement
    np.testing.assert_allclose(
        views.means(spectra)[0], whole.mean(shift)[::2, ::2], atol=1e-3
    )


def test_spread_is_the_transpose_of_the_means() -> None:
    views = two_colours()
    scene, planes = scene_on(views), [RNG.normal(size=view.counts.shape) for view in views]
    forward = sum(
        float(np.sum(m * p))
        for m, p in zip(views.means(views.grid.spectrum(scene)), planes, strict=True)
    )
    back = float(np.sum(scene * views.grid.image(views.spread(planes))))
    assert back == pytest.approx(forward, rel=1e-5)  # single precision


@pytest.mark.parametrize("held", [False, True])
def test_the_penaltys_derivatives_are_differences_of_it(held: bool) -> None:
    views = two_colours()
    scene, step, grid = scene_on(views), RNG.normal(size=(2, *views.grid.shape)), views.grid
    penalty = Roughness(grid, views.seen(), 50.0, COUPLING)
    if held:
        penalty = replace(penalty, held=penalty.norm(scene, grid.spectrum(scene)))

    def value(t: float) -> float:
        return penalty.value(scene + t * step, grid.spectrum(scene + t * step))

    def gradient(t: float) -> np.ndarray:
        spectral, beside = penalty.gradient(
            scene + t * step, grid.spectrum(scene + t * step)
        )
        return np.asarray(grid.image(spectral) + beside)

    assert np.sum(gradient(0) * step) == pytest.approx(
        (value(0.01) - value(-0.01)) / 0.02, rel=1e-5
    )
    spectral, beside = penalty.curvature(
        scene, grid.spectrum(scene), step, grid.spectrum(step)
    )
    by_differences = (gradient(0.01) - gradient(-0.01)) / 0.02
    np.testing.assert_allclose(
        grid.image(spectral) + beside,
        by_differences,
        atol=2e-3 * np.abs(by_differences).max(),
    )


def test_neither_scale_nor_level_nor_a_turn_around_the_torus_changes_the_roughness() -> (
    None
):
    views = two_colours()
    grid, seen = (
        views.grid,
        np.ones(views.grid.shape, bool),
    )  # (K.11) as printed: the whole torus is seen
    penalty, scene = Roughness(grid, seen, 50.0, COUPLING), scene_on(views)
    first = penalty.value(scene, grid.spectrum(scene))
    for other in (3 * scene + 700, np.roll(scene, (5, -9), axis=(1, 2)), scene[:, ::-1]):
        assert penalty.value(other, grid.spectrum(other)) == pytest.approx(first, rel=1e-5)


def test_the_penalty_of_a_wave_is_its_squared_frequency() -> None:
    views = two_colours()
    grid = views.grid
    rows = np.arange(grid.shape[0])[:, None] / grid.samples  # pixels
    pixels = grid.shape[0] / grid.samples
    wave = np.cos(2 * np.pi * 3 * rows / pixels) + np.zeros(grid.shape)
    penalty = Roughness(grid, np.ones(grid.shape, bool), 1.0)
    assert penalty.value(wave[None], grid.spectrum(wave[None])) == pytest.approx(
        (2 * np.pi * 3 / pixels) ** 2, rel=1e-5
    )


def test_the_misfits_gradient_is_a_difference_of_it() -> None:
    views = two_colours()
    penalty = Roughness(views.grid, views.seen(), 50.0, COUPLING)
    scene = scene_on(views)
    step = np.sign(
        Point.of(views, penalty, scene.astype(np.float32)).gradient(views, penalty)
    )  # where it is large
    single = [(scene + t * step).astype(np.float32) for t in (0.5, -0.5, 0.0)]
    there = [Point.of(views, penalty, at).value for at in single[:2]]
    gradient = Point.of(views, penalty, single[2]).gradient(views, penalty)
    assert np.sum(gradient * step) == pytest.approx(
        there[0] - there[1], rel=3e-4
    )  # single precision: 1.4e-4


def test_the_misfits_curvature_is_the_mean_of_its_gradients_differences_over_the_noise() -> (
    None
):
    view = two_colours().views[0]
    mean, rng = np.full(view.counts.shape, 250.0), np.random.default_rng(1)
    slopes = []
    for _ in range(4000):
        drawn = replace(
            view,
            counts=mean
            + rng.normal(size=mean.shape) * np.sqrt(view.expected(mean).variance),
        )
        slopes.append(drawn.slope(mean + 0.5) - drawn.slope(mean - 0.5))
    # 64 pixels of 4000 draws each: the mean errs by 0.05 %
    assert np.mean(slopes) == pytest.approx(view.weight(mean).mean(), rel=5e-3)


def dense(views: Views, stiffness: Stiffness, weights: np.ndarray) -> np.ndarray:
    """K + H^T W H of a small scene of one colour, (samples, samples), column by column."""
    size, columns = views.grid.shape[0] * views.grid.shape[1], []
    for k in range(size):
        unit = np.zeros((1, *views.grid.shape))
        unit.flat[k] = 1
        spectra = views.grid.spectrum(unit)
        seen = weights * views.means(spectra)
        columns.append(
            views.grid.image(views.spread(seen) + spectra / stiffness.give).ravel()
        )
    return np.array(columns)


def small(frame: int, guard_px: int, counts: float = 1000.0) -> tuple[Job, Views]:
    base = job(np.full((frame, frame), counts), places=((0, 1), (1, 0)), guard_px=guard_px)
    views = base.views((slice(0, frame), slice(0, frame)))
    assert views is not None
    return base, views


def test_kriging_solves_the_normal_equations() -> None:
    _, views = small(12, 2)
    shape = views.counts.shape
    weights = RNG.uniform(0.5, 2, shape) * (RNG.uniform(size=shape) > 0.2)
    stiffness = Stiffness(views.grid, np.eye(1), 0.02, 1e-3)
    data = RNG.normal(size=(2, 6, 6))
    kriging = Kriging(views, stiffness, weights)
    found = views.grid.image(kriging.scene(kriging.solve(data, tolerance=1e-8)))
    right = views.grid.image(views.spread(weights * data))
    wanted = np.linalg.solve(dense(views, stiffness, weights), right.ravel())
    np.testing.assert_allclose(found.ravel(), wanted, atol=1e-4 * np.abs(wanted).max())


def test_the_error_map_is_the_diagonal_of_the_inverse() -> None:
    base, views = small(16, 0)  # all of the torus is seen
    means = np.full(views.counts.shape, 1000.0)
    errors = standard_errors(views, base.small(8), np.eye(1), 1e-4, means)
    rough = 1e-4 / views.grid.samples**2
    stiffness = Stiffness(views.grid, np.eye(1), rough, rough * (2 * np.pi / 16) ** 2)
    inverse = np.linalg.inv(dense(views, stiffness, views.weights(means)))
    std = np.sqrt(np.diag(inverse)).reshape(views.grid.shape)[views.grid.inner]
    # the frame's border has neighbours on one side only: there errors are smoothed over a cell or two
    np.testing.assert_allclose(errors.std[0][8:-8, 8:-8], std[8:-8, 8:-8], rtol=0.03)


def test_a_random_error_is_as_large_as_the_error_map_says() -> None:
    base, views = small(16, 0)
    means = views.flat(views.levels())
    errors = standard_errors(views, base.small(8), np.eye(1), 1e-4, means)
    rng = np.random.default_rng(8)
    drawn = [random_error(views, np.eye(1), 1e-4, rng) for _ in range(100)]
    ratio = np.mean(np.square(drawn), axis=0) / errors.std**2
    # means of six seeds scatter by 0.8 %; allow four of that
    assert ratio[0][8:-8, 8:-8].mean() == pytest.approx(1, abs=0.032)


@pytest.mark.parametrize("seed", range(5, 11))
def test_where_the_penalty_is_weak_truth_lies_within_the_stated_errors(seed: int) -> None:
    # a scene as rough as the penalty supposes, sampled well: every pixel of a mono sensor, no defocus, much light. It has no
    # negative radiance, as one of three times this contrast has here and there: a camera does not photograph that
    rng = np.random.default_rng(seed)
    base = job(np.zeros((96, 96)), samples=1, places=((0, 0),), guard_px=8)
    sharp = replace(base.colours[0], waves=0 * base.colours[0].waves)
    base = replace(base, period=1, colours=(sharp,))
    views = base.views((slice(0, 96), slice(0, 96)))
    assert views is not None
    noise = np.fft.rfft2(rng.normal(size=views.grid.shape).T).T
    frequency = np.sqrt(views.grid.squared_frequency) + 0.05
    scene = views.grid.image((noise / frequency)[None].astype(np.complex64))
    scene = 0.2 * WHITE * scene / scene.std() + WHITE
    assert scene.min() > 0
    counts = views.means(views.grid.spectrum(scene))[0] / WHITE
    shown = replace(
        base, photographs=(replace(base.photographs[0], counts=exposed(counts, seed)),)
    )
    picture = restore_job(shown, DISCREPANCY, 96, 0)
    apart = np.abs(picture.scene[0] - scene[0][views.grid.inner]) / picture.std[0]
    weak = picture.by_penalty[0] < 0.5
    assert weak.mean() > 0.5
    assert np.mean(apart[weak] < 1) == pytest.approx(0.68, abs=0.05)
    assert np.mean(apart[weak] < 2) == pytest.approx(0.95, abs=0.05)
