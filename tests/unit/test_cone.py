"""The cone freed: Newton's steps end where damped climbs do, and at the f-number that the frames call for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from labkit.estimation.climb import NoisePrior, Problem, Start, State, maximize, sane
from labkit.estimation.expansion import (
    Opened,
    camera_prior,
    expand,
    free_f_number,
    with_optics_about,
)
from labkit.estimation.likelihood import FrameData
from labkit.estimation.settings import SETTINGS
from labkit.imaging.brightness import Brightness
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.parts import CatsEye, LowPass, Obstruction
from labkit.imaging.warp import Pose
from labkit.optics.spectrum import WIDEST_SPECTRUM, Spectrum
from labkit.target.target import CellTarget
from labkit.types import Floats

OPTICS = Optics(
    wavelength_nm=550.0,
    reference_nm=450.0,
    f_number=4.0,
    pitch_um=4.8,
    active_um=4.8,
    noll=(4, 6, 8),
)
CARPET = CellTarget(
    np.kron(np.array([[0.0, 1, 0], [1, 0, 1], [0, 0, 1]]), np.ones((2, 2))),
    (20.0, 20.0),
    0.0,
)
CORNERS = np.array([[8.3, 9.1], [8.0, 49.7], [48.8, 49.9], [49.1, 9.4]])
FRAME = (58, 60)
PRIOR = NoisePrior(0.25, 0.01, 4.0, 0.02)
POSE = Pose.from_corners(CORNERS, CARPET.size_mm)
TRUTH = State(
    np.array([0.15, 0.04, -0.05]),
    (POSE,),
    np.array([1500.0]),
    np.array([40.0]),
    PRIOR.centre,
)
MODES = slice(3)


@pytest.fixture(scope="module")
def model() -> ForwardModel:
    return ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )


def photographed(model: ForwardModel, truth: State = TRUTH) -> Problem:
    rng, used, one = np.random.default_rng(11), np.ones(FRAME, bool), np.ones(FRAME)
    (seen,) = model.means(truth.waves, model.draw(truth.poses), [used])
    mean = (1500 * seen + 40).reshape(FRAME)
    data = FrameData(rng.normal(mean, np.sqrt(0.25 * mean + 4)), used, one, 0 * one)
    return Problem(model, (data,), PRIOR)


def test_with_the_cone_held_newtons_steps_end_where_a_damped_climb_does(
    model: ForwardModel,
) -> None:
    problem = photographed(model)
    step = np.zeros(3 + 10 + 2)
    step[MODES] = 0.004, -0.003, 0.003
    climbed = maximize(problem, TRUTH.moved(step), tolerance=1e-3)
    freed = free_f_number(problem, Start(TRUTH.moved(step)), 0.0)
    std = np.sqrt(np.diag(climbed.covariance()))[MODES]
    assert freed.solution.converged
    assert np.abs((freed.solution.state.waves - climbed.state.waves) / std).max() < 0.02
    assert freed.solution.objective == pytest.approx(climbed.objective, abs=1e-3)
    assert freed.optics.f_number == pytest.approx(OPTICS.f_number, rel=1e-6)


def test_a_cone_that_is_off_is_found_and_so_are_the_modes(model: ForwardModel) -> None:
    problem = photographed(model)
    off = Problem(
        with_optics_about(model, replace(OPTICS, f_number=1.03 * OPTICS.f_number), TRUTH),
        problem.frames,
        PRIOR,
    )
    freed, right = (free_f_number(p, Start(TRUTH), 0.03) for p in (off, problem))
    std = np.sqrt(freed.measured.covariance[-2, -2])
    assert std < 0.02
    assert abs(freed.measured.values[-2] - np.log(OPTICS.f_number)) < 3 * std
    # the same optimum from either cone, but for what they are told of it beforehand
    both = np.array([freed.measured.values, right.measured.values])
    assert (
        np.abs(
            np.diff(both[:, :-1], axis=0) / np.sqrt(np.diag(right.measured.covariance))[:-1]
        ).max()
        < 0.18
    )


def test_steps_go_up_the_likelihood_whatever_part_of_the_light_is_the_targets_own() -> None:
    """Measurements have that part at its likeliest value, which moves the gradient by 0.9 standard errors here."""
    rows, columns = np.indices(FRAME) / FRAME[0] - 0.5
    light = np.exp(0.6 * rows - 0.8 * columns)
    seen = Brightness.fitted(light, np.ones(FRAME, bool))
    uneven = ForwardModel.build(OPTICS, CARPET, FRAME, POSE, brightness=seen)
    problem = photographed(uneven)
    frames = tuple(replace(frame, brightness=seen) for frame in problem.frames)
    problem = replace(problem, frames=frames)
    modes = np.array([0.004, -0.003, 0.003])
    expansion = expand(problem, Start(replace(TRUTH, waves=TRUTH.waves + modes)))

    def objective(step: Floats) -> float:
        state = replace(expansion.state, waves=expansion.state.waves + step)
        return problem.objective(state, problem.relative(state))

    size = 1e-5
    slopes = [
        (objective(step) - objective(-step)) / (2 * size) for step in size * np.eye(3)
    ]
    std = np.diag(expansion.information)[MODES] ** -0.5
    assert np.abs(expansion.uphill[0][MODES] - slopes) * std == pytest.approx(0.0, abs=3e-6)
    assert np.abs((expansion.gradient[MODES] - slopes) * std).max() > 0.5


@pytest.mark.parametrize("light", [Spectrum(), Spectrum.of_width(0.04**2)])
def test_a_cone_wider_than_a_model_spares_is_modelled_anew(light: Spectrum) -> None:
    """In the shortest of its light, whose PSFs are the finest, too."""
    broad = replace(OPTICS, spectrum=light)
    model = ForwardModel.build(
        broad, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    finest_um = 0.5 * OPTICS.airy_um * min(light.nodes)
    least = model.blur.pupil.spacing_um / finest_um  # of the cone, that its grid is for
    for cone, same in ((1.001 * least, True), (0.999 * least, False)):
        other = with_optics_about(
            model, replace(broad, f_number=cone * OPTICS.f_number), TRUTH
        )
        assert (other.blur.torus == model.blur.torus) == same
        slopes = [*other.blur.psf_slopes(TRUTH.waves)]
        assert np.isfinite(slopes).all()


def test_a_number_that_would_leave_its_bounds_stays_there_and_all_else_settles(
    model: ForwardModel,
) -> None:
    """No light is as broad as would blur like this filter."""
    filtered = ForwardModel.build(
        replace(OPTICS, given=(LowPass(0.8, 0.8),)),
        CARPET,
        FRAME,
        POSE,
        f_number_margin=SETTINGS.f_number_margin,
    )
    broad = with_optics_about(model, OPTICS.with_parts(["spectrum"]), TRUTH)
    freed = free_f_number(replace(photographed(filtered), model=broad), Start(TRUTH), 0.03)
    assert freed.solution.converged
    assert freed.solution.steps < 8  # 5; 10 where they led to widths that do nothing more
    assert freed.optics.parts[0].values == pytest.approx((WIDEST_SPECTRUM**2,))
    assert freed.measured.values[3] == pytest.approx(WIDEST_SPECTRUM**2)


def test_a_start_from_which_newtons_steps_run_away_says_so(model: ForwardModel) -> None:
    far = State(
        np.array([1.5, -0.3, 0.4]),
        TRUTH.poses,
        TRUTH.scales,
        TRUTH.ambients,
        TRUTH.log_noise,
    )
    assert not free_f_number(photographed(model), Start(far), 0.03).solution.converged


def test_a_wavefront_that_throws_light_far_gets_a_wider_window(model: ForwardModel) -> None:
    thrown = replace(TRUTH, waves=np.array([0.5, 0.8, 0.8]))
    wide = model.rebuilt(
        OPTICS, POSE, waves=thrown.waves, f_number_margin=SETTINGS.f_number_margin
    )
    assert wide.window_airy > 1.5 * model.window_airy
    problem = photographed(wide, thrown)
    ends = [
        free_f_number(replace(problem, model=each), Start(thrown), 0.03)
        for each in (model, wide)
    ]
    assert ends[0].expansion.problem.model.window_airy == pytest.approx(wide.window_airy)
    narrow = maximize(replace(problem, model=model), thrown).state.waves
    right, widened, std = (
        ends[1].solution.state.waves,
        ends[0].solution.state.waves,
        np.sqrt(np.diag(ends[1].covariance)),
    )
    np.testing.assert_allclose(widened, right, atol=1e-9)
    assert (
        0.2 < np.abs((narrow - right) / std).max() < 0.7
    )  # what a window of 120 lambda N loses here


def test_rough_slopes_are_nearly_the_exact_ones(model: ForwardModel) -> None:
    problem = photographed(model)
    rough, exact = (expand(problem, Start(TRUTH), exact=exact) for exact in (False, True))
    for one, other in zip(rough.evaluations, exact.evaluations, strict=True):
        np.testing.assert_array_equal(one.mean, other.mean)
        for got, wanted in ((one.by_waves, other.by_waves), (one.by_pose, other.by_pose)):
            off = np.linalg.norm(got - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
            assert 0.01 < off.min() < off.max() < 0.09


def scatter_and_errors(
    model: ForwardModel, alike_px: float
) -> tuple[Floats, Floats, Floats]:
    """Of modes over forty photographs whose noise is alike over some pixels: standard deviations, errors as of noise alone,
    and those of a poor model."""
    rng, used, one = np.random.default_rng(5), np.ones(FRAME, bool), np.ones(FRAME)
    (seen,) = model.means(TRUTH.waves, model.draw(TRUTH.poses), [used])
    mean = (1500 * seen + 40).reshape(FRAME)
    ends, stds, sandwich = [], [], []
    for _ in range(40):
        noise = rng.normal(size=FRAME)
        if alike_px:
            noise = gaussian_filter(noise, alike_px, mode="wrap")
            noise /= noise.std()
        data = FrameData(mean + noise * np.sqrt(0.25 * mean + 4), used, one, 0 * one)
        expansion = expand(Problem(model, (data,), PRIOR), Start(TRUTH))
        good = expansion.measured()
        bad = expansion.sandwich(good)
        ends.append(good.values[MODES])
        stds.append(np.sqrt(np.diag(good.covariance))[MODES])
        sandwich.append(np.sqrt(np.diag(bad.covariance))[MODES])
        np.testing.assert_allclose(bad.covariance - bad.model, good.covariance)
    return np.std(ends, axis=0), np.mean(stds, axis=0), np.mean(sandwich, axis=0)


def test_errors_of_a_model_that_lacks_something_cover_what_residuals_do_to_the_modes(
    model: ForwardModel,
) -> None:
    scatter, stds, sandwich = scatter_and_errors(model, 1.5)
    assert np.all(scatter > 1.6 * stds)
    assert np.all(np.abs(np.log(sandwich / scatter)) < 0.2)


def test_they_grow_little_where_it_lacks_nothing(model: ForwardModel) -> None:
    scatter, stds, sandwich = scatter_and_errors(model, 0.0)
    assert np.all(sandwich < 1.2 * stds)
    assert np.all(np.abs(scatter / stds - 1) < 0.1)


@pytest.mark.parametrize(("shift", "clear"), [(0.6, True), (1.0, False)])
def test_no_step_leads_to_a_pupil_that_is_clear_nowhere(
    model: ForwardModel, shift: float, clear: bool
) -> None:
    """Half of the pupil is obstructed, and a cat's eye leaves the other half at most."""
    begun = 0.3
    optics = replace(OPTICS, parts=(Obstruction(0.5), CatsEye(begun, 0.0, 0.0)))
    expansion = expand(photographed(with_optics_about(model, optics, TRUTH)), Start(TRUTH))
    step = np.zeros_like(expansion.gradient)
    step[expansion.camera.start + 1] = shift - begun
    assert (expansion.optics_after(step).rim.area > 0) == clear
    assert expansion.sane_after(step, TRUTH) == clear


def test_a_step_to_a_pupil_without_a_clear_part_is_refused_without_a_warning(
    model: ForwardModel,
) -> None:
    cut = replace(OPTICS, parts=(CatsEye(0.5, 0.0, 0.0), Obstruction(0.3)))
    problem = Problem(
        with_optics_about(model, cut, TRUTH), photographed(model).frames, PRIOR
    )
    position = Opened(problem, problem.drawn(TRUTH), TRUTH, *camera_prior(cut, 0.03))
    change = np.zeros_like(position.expansion.gradient)
    change[position.expansion.camera] = 1.0, 0.0, -0.7, 0.45, 0.0
    assert position.moved(change).objective == -np.inf
    assert position.foreseen(change) is None


@pytest.mark.parametrize(
    ("scale", "ambient", "unevenness"), [(1e160, 0, 0), (1, -1e200, 0), (1, 0, 1e160)]
)
def test_light_beyond_all_photographs_is_implausible(
    scale: float, ambient: float, unevenness: float
) -> None:
    begin = replace(TRUTH, unevenness=np.zeros(1))
    far = replace(
        begin,
        scales=scale * begin.scales,
        ambients=ambient + begin.ambients,
        unevenness=np.array([unevenness]),
    )
    assert sane(begin, begin)
    assert not sane(far, begin)
