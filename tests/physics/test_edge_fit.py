"""Edges fitted in pictures of a camera that shares nothing with the model: gradient, errors, both sides of best focus."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labkit.edges.edge_fit import EdgeFit, EdgeProblem, LensPrior, fit_edges
from labkit.edges.first_fits import fit_depth, fit_jointly, halves, rough_edge, twin
from labkit.edges.region import Edge, Region
from labkit.edges.response import fitted_response
from labkit.estimation.climb import NoisePrior
from labkit.experiments.edge_camera import EdgeCamera
from labkit.imaging.optics import Optics
from labkit.types import Floats

NOLL = tuple(range(4, 12))
OPTICS = Optics(
    wavelength_nm=500.0,
    reference_nm=500.0,
    f_number=4.0,
    pitch_um=4.78,
    active_um=4.78,
    noll=NOLL,
)
CAMERA = EdgeCamera(0.5, 4.0, 4.78, frame=28, finer=6, reach_px=40)
MODES = np.array([0.03, -0.04, 0.02, 0.03, -0.02, 0.01, 0.05])
GAIN, READ = 0.5, 2.0
NOISE = NoisePrior(GAIN, 2.0, READ**2, 2.0)
KNOWN, UNKNOWN = (
    LensPrior(MODES, 0.002**2 * np.eye(len(MODES))),
    LensPrior.unknown(len(MODES)),
)
ANGLES = (0.2, 1.75)


@cache
def mean(defocus: float, angle: float) -> Floats:
    return CAMERA.mean(
        angle, 0.6, (1000.0, 6000.0), np.concatenate([[defocus], MODES]), NOLL
    )


def region(
    defocus: float, angle: float, rng: np.random.Generator, depth: int = 0
) -> Region:
    counts = GAIN * rng.poisson(mean(defocus, angle) / GAIN) + rng.normal(0, READ, (28, 28))
    rows, columns = (a.ravel() for a in np.mgrid[0:28.0, 0:28.0])
    return Region(rows, columns, counts.ravel(), (13.5, 13.5), 0, depth)


def problem(*regions: Region, lens: LensPrior = KNOWN) -> EdgeProblem:
    return EdgeProblem((OPTICS,), regions, (NOISE,), lens)


def searched(*regions: Region, lens: LensPrior = KNOWN) -> tuple[EdgeFit, ...]:
    return fit_depth(problem(*regions, lens=lens), [rough_edge(of) for of in regions])


def test_the_gradient_over_all_unknowns_is_that_of_differences() -> None:
    rng = np.random.default_rng(1)
    of = problem(
        *(
            replace(region(d, a, rng, k), order=5, even=False)
            for k, (d, a) in enumerate(zip((0.3, 0.9), ANGLES, strict=True))
        )
    )
    shape = (0.8, -0.5, 0.3, 0.2, 0.05, -0.1, 0.04)
    state = of.start(
        [0.27, 0.95],
        [
            Edge(0.21, 0.5, 1100.0, 5900.0, *shape),
            Edge(1.74, 0.7, 900.0, 6100.0, *shape[::-1]),
        ],
    )
    _, gradient, information = of.score(state)
    at, unit = state.vector, np.eye(state.vector.size)
    steps = 1e-5 * np.maximum(1.0, np.abs(at))
    slopes = [
        (of.score(state.at(at + h * u))[0] - of.score(state.at(at - h * u))[0]) / (2 * h)
        for h, u in zip(steps, unit, strict=True)
    ]
    np.testing.assert_allclose(
        (slopes - gradient) / np.sqrt(np.diag(information)), 0, atol=3e-4
    )


def test_the_information_is_the_covariance_of_the_gradient() -> None:
    # Fisher's identity at the truth, over pictures of chance of the model itself: 400 have 7 % error of a variance
    rng = np.random.default_rng(2)
    of = problem(region(0.4, 0.2, rng))
    state = of.start([0.4], [Edge(0.2, 0.6, 1000.0, 6000.0)])
    slopes, places = of.slopes(state, 0)
    _, _, information = of.score(state)
    inside = np.ix_(places, places)
    information[inside] -= np.pad(of.lens.precision, ((1, 6), (1, 6)))
    noise = of.noise[0].precision
    information[inside][-2:, -2:] -= np.diag(noise)
    scores = []
    for _ in range(400):
        by_mean, by_variance = slopes.pulls(
            rng.normal(slopes.mean, np.sqrt(slopes.variance))
        )
        scores.append(
            np.concatenate([slopes.of_mean @ by_mean, slopes.of_variance @ by_variance])
        )
    ratio = np.var(scores, axis=0) / np.diag(information)[places][: len(places)]
    assert np.all(np.abs(ratio[:-2] - 1) < 0.28)


@pytest.mark.slow
def test_errors_of_defocus_angle_and_radiances_are_as_reported() -> None:
    rng = np.random.default_rng(3)
    pulls = []
    for _ in range(16):
        fit = fit_edges(
            of := problem(region(0.4, 0.2, rng)),
            of.start([0.38], [Edge(0.2, 0.6, 1000.0, 6000.0)]),
        )
        value, std = fit.defocus()
        error = (fit.state.edges[0, :4] - [0.2, 0.6, 1000.0, 6000.0]) / fit.std.edges[0, :4]
        pulls.append([(value - 0.4) / std, *error])
    # 80 unit normals: the RMS of them is known to 8 %
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3


def test_a_known_wavefront_tells_the_sides_of_best_focus_apart() -> None:
    best, other = searched(region(-0.5, 0.2, np.random.default_rng(4)))
    assert best.defocus()[0] == pytest.approx(-0.5, abs=4 * best.defocus()[1])
    assert other.defocus()[0] > 0.3
    assert best.objective - other.objective > 10


def test_an_unknown_wavefront_does_not() -> None:
    best, other = searched(region(-0.5, 0.2, np.random.default_rng(4)), lens=UNKNOWN)
    assert best.defocus()[0] == -other.defocus()[0]
    assert best.objective == other.objective
    assert best.problem.score(other.state)[0] == pytest.approx(
        best.objective, abs=1e-6
    )  # the twin of thesis 3.6
    assert twin(other).state.defoci[0] == best.state.defoci[0]


def test_no_defocus_is_a_saddle_that_no_climb_starts_at() -> None:
    of = problem(region(0.4, 0.2, np.random.default_rng(5)), lens=UNKNOWN)
    edge = Edge(0.2, 0.6, 1000.0, 6000.0)
    with pytest.raises(ValueError, match="flat there by symmetry"):
        fit_edges(of, of.start([0.0], [edge]))
    near, far = (of.score(of.start([at], [edge]))[1][len(MODES) + 2] for at in (1e-9, 0.1))
    assert abs(near) < 1e-6 * abs(far)


@pytest.mark.slow
def test_edges_of_several_angles_tell_the_wavefront_that_is_fitted_along() -> None:
    rng = np.random.default_rng(6)
    defoci = (0.5, -0.35, 0.8, -0.6)
    places = [*zip(defoci, (0.2, 1.0, 1.75, 2.6), strict=True)]
    regions = [region(d, a, rng, k) for k, (d, a) in enumerate(places)]
    apart = [searched(replace(of, depth=0), lens=UNKNOWN)[0] for of in regions]
    edges = np.array([fit.state.edges[0] for fit in apart])
    regions = [replace(f.problem.regions[0], depth=k) for k, f in enumerate(apart)]
    noise = np.median([fit.state.log_noise for fit in apart], axis=0)
    of = problem(*regions, lens=UNKNOWN)
    start = of.start([f.defocus()[0] for f in apart], edges, noise)
    joint = fit_jointly(of, start, range(len(regions)))
    joint = joint if joint.state.defoci[0] > 0 else twin(joint)
    pulls = (joint.state.defoci - defoci) / [joint.defocus(k)[1] for k in range(4)]
    assert np.abs(pulls).max() < 3
    std = joint.std.modes
    assert np.abs((joint.state.modes - MODES) / std).max() < 3.5
    assert std.min() < 0.01  # of the prior's 0.05


def test_a_step_without_information_goes_half_a_wave_and_no_farther() -> None:
    of = problem(region(0.4, 0.2, np.random.default_rng(1)))
    state = of.start([0.01], [Edge(0.2, 0.6, 1000.0, 6000.0)])
    moved = state.moved(np.full(state.vector.size, 1e4))
    assert moved.defoci == pytest.approx([0.51])
    assert np.abs(moved.modes - state.modes).max() == pytest.approx(0.5)


def test_halves_of_one_edge_agree_and_of_two_do_not() -> None:
    rng = np.random.default_rng(7)
    one = region(0.4, 0.2, rng)
    mixed = np.where(one.rows < 14, one.counts, region(1.1, 0.2, rng).counts)
    for counts, alike in ((one.counts, True), (mixed, False)):
        parts = halves(searched(replace(one, counts=counts))[0])
        assert parts
        (a, a_std), (b, b_std) = (part.defocus() for part in parts)
        assert (abs(a - b) < 4 * np.hypot(a_std, b_std)) == alike


def test_the_fitted_response_is_the_cameras_mtf_across_the_edge() -> None:
    fit = searched(region(0.4, 0.2, np.random.default_rng(8)))[0]
    response = fitted_response(fit)
    psf = CAMERA.psf(np.concatenate([[0.4], MODES]), NOLL)
    at_um = np.arange(-240, 241) * 4.78 / 6
    frequency = np.array([20.0, 50.0, 80.0]) * 1e-3
    phase = [
        np.exp(-2j * np.pi * f * (np.cos(0.2) * at_um + np.sin(0.2) * at_um[:, None]))
        for f in frequency
    ]
    pixel = np.sinc(frequency * np.cos(0.2) * 4.78) * np.sinc(
        frequency * np.sin(0.2) * 4.78
    )
    truth = [abs(np.sum(psf * turn)) for turn in phase] * pixel
    found = np.interp(1e3 * frequency, response.frequency_per_mm, response.value)
    std = np.interp(1e3 * frequency, response.frequency_per_mm, response.std)
    assert np.all(np.abs(found - truth) < 4 * std + 1e-3)  # the window's 1e-3 of the light
