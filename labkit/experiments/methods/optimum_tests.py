"""Tests whether the end of a maximisation is the global optimum: thesis §4.2, on the camera model.

The statistic of each test is large at a wrong optimum, and has a fast approximation of its distribution at the right
optimum. `bootstrap` gives the threshold without an approximation, by fits to data drawn from the optimum itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, ndtr

from labkit.arrays import positive, real_array
from labkit.estimation.climb import PER_FRAME, NoisePrior, Problem, State, maximize
from labkit.estimation.likelihood import predict
from labkit.experiments.methods.psf_basis import PsfBasis
from labkit.types import Complexes, Floats


@dataclass(frozen=True, slots=True)
class SignificanceTest:
    """The result of a test.

    Parameters
    ----------
    name : of the test
    statistic : large at a wrong optimum
    p_value : probability of a statistic at least as large at the right optimum
    """

    name: str
    statistic: float
    p_value: float


def excess_likelihood(problem: Problem, state: State) -> float:
    """Return the standardised log-likelihood at its optimum, (l - E l) / sqrt(Var l): negative for unlikely
    data.

    For independent normal pixels E l and Var l at the optimum have closed forms: -chi2/2 of
    a pixel has mean -1/2 and
    variance 1/2, and each fitted parameter raises l by a half. The noise is the
    calibration's, because noise fitted to
    the data would explain any misfit; the calibration's standard errors enter Var l.

    Parameters
    ----------
    problem, state : frames and the optimum of their likelihood

    Returns
    -------
    standard normal at the right optimum

    Notes
    -----
    The validation function of thesis (4.10), (4.12).
    """
    state = _calibrated(problem, state)
    misfit = 0.0
    photons = 0.0
    pixels = 0
    for frame, detector, relative in zip(
        problem.frames, state.detectors(), problem.relative(state), strict=True
    ):
        mean, variance = predict(relative, frame, detector)
        misfit += float(np.sum((frame.counts[frame.used] - mean) ** 2 / variance))
        photons += float(np.sum(detector.gain * np.maximum(mean, 0) / variance))
        pixels += mean.size
    fitted = state.waves.size + PER_FRAME * len(problem.frames) + state.unevenness.size
    shares = np.array([photons, pixels - photons])
    spread = 2 * pixels + float(np.sum(shares**2 / problem.noise.precision))
    return (pixels - fitted - misfit) / float(np.sqrt(spread))


def two_sided(problem: Problem, state: State) -> SignificanceTest:
    """Return Biernacki's test, thesis (4.10)."""
    z = excess_likelihood(problem, state)
    return SignificanceTest("Biernacki", z**2, float(chdtrc(1, z**2)))


def one_sided(problem: Problem, state: State) -> SignificanceTest:
    """Return the one-sided test, thesis (4.12): by Theorem IV.1 a wrong optimum only makes the data less
    likely.
    """
    z = excess_likelihood(problem, state)
    return SignificanceTest("one-sided", -z, float(ndtr(z)))


def embedding(problem: Problem, state: State, basis: PsfBasis) -> SignificanceTest:
    """Return the test by the gap in log-likelihood that a basis of the PSF opens, by Rao's score without a
    second fit.

    Parameters
    ----------
    problem, state : frames and the optimum of their likelihood
    basis : directions by which the model is extended

    Returns
    -------
    twice the gap of thesis (4.21): chi-squared with `basis.degrees` at the right optimum
    (Wilks)
    """
    gradient, information = _embedded_score(problem, state, basis.kernels(problem.model))
    statistic = rao_score(gradient, information)
    return SignificanceTest("embedding", statistic, float(chdtrc(basis.degrees, statistic)))


def rao_score(gradient: Floats, information: Floats) -> float:
    """Return Rao's statistic s^T F^-1 s: chi-squared with a degree of freedom for each parameter at the truth.

    Parameters
    ----------
    gradient : (p,), of the log-likelihood
    information : (p, p); parameters without any effect on the data add nothing

    Raises
    ------
    ValueError
        for other shapes, or not finite

    Notes
    -----
    Thesis (4.26).
    """
    gradient = real_array(
        "gradient", gradient, (None,), "log-likelihoods for a unit of each parameter"
    )
    information = real_array(
        "information", information, (gradient.size,) * 2, "of those units, inverse squared"
    )
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = information * np.outer(scale, scale)
    gradient = gradient * scale
    return float(gradient @ np.linalg.lstsq(scaled, gradient, rcond=1e-12)[0])


def _embedded_score(
    problem: Problem, state: State, kernels: list[Complexes]
) -> tuple[Floats, Floats]:
    """Return gradient and information over the coefficients of a basis and all fitted parameters, in this
    order.
    """
    used = [frame.used for frame in problem.frames]
    drawing = problem.draw(state)
    torus = problem.model.blur.torus
    evaluations = problem.model.evaluate(state.waves, drawing, used)
    embedded = []
    for evaluation, spectrum, u in zip(evaluations, drawing.spectra, used, strict=True):
        departures = [torus.sample(spectrum, kernel)[u] for kernel in kernels]
        # to `assembled` the coefficients are further modes
        embedded.append(
            replace(evaluation, by_waves=np.concatenate([departures, evaluation.by_waves]))
        )
    return problem.assembled(state, embedded)[:2]


def bootstrap(
    problem: Problem,
    state: State,
    statistics: Callable[[Problem, State], Sequence[float]],
    rng: np.random.Generator,
    draws: int,
) -> Floats:
    """Return statistics of data drawn from an optimum and fitted anew: their distribution if the optimum is
    right.

    The calibration of the noise is drawn anew for each set of data, within its standard
    errors.

    Parameters
    ----------
    problem, state : frames and the optimum of their likelihood
    statistics : n statistics of a problem and its optimum
    rng : draws the data and the calibration
    draws : sets of data

    Returns
    -------
    (draws, n)

    Raises
    ------
    ValueError
        for no draws
    """
    positive("draws", draws, "sets of data")
    truth = _calibrated(problem, state)
    images = problem.relative(truth)
    values = []
    for _ in range(draws):
        drawn = replace(
            _drawn(problem, truth, images, rng), noise=recalibrated(problem.noise, rng)
        )
        start = replace(truth, log_noise=drawn.noise.centre)
        values.append(statistics(drawn, maximize(drawn, start).state))
    return np.array(values)


def _drawn(
    problem: Problem, truth: State, images: Sequence[Floats], rng: np.random.Generator
) -> Problem:
    """Return the problem with counts drawn at the truth.

    images: relative radiance of each frame's used pixels
    """
    frames = []
    for frame, detector, relative in zip(
        problem.frames, truth.detectors(), images, strict=True
    ):
        mean, variance = predict(relative, frame, detector)
        counts = np.zeros(frame.counts.shape)
        counts[frame.used] = rng.normal(mean, np.sqrt(variance))
        frames.append(replace(frame, counts=counts))
    return replace(problem, frames=tuple(frames))


def bootstrapped(test: SignificanceTest, drawn: Floats) -> SignificanceTest:
    """Return the test with its p-value by bootstrap: the rank among statistics drawn at the right optimum.

    Parameters
    ----------
    test : with the statistic of the data
    drawn : (draws,), statistics by `bootstrap`

    Raises
    ------
    ValueError
        for another shape, or not finite
    """
    drawn = real_array("drawn", drawn, (None,), "the statistic's")
    larger = np.sum(drawn >= test.statistic)
    return replace(test, p_value=float((1 + larger) / (1 + drawn.size)))


def recalibrated(noise: NoisePrior, rng: np.random.Generator) -> NoisePrior:
    """Return gain and read variance of another calibration, drawn within the standard errors of a first."""
    gain, read_variance = np.exp(rng.normal(noise.centre, 1 / np.sqrt(noise.precision)))
    return replace(noise, gain=float(gain), read_variance=float(read_variance))


def _calibrated(problem: Problem, state: State) -> State:
    """Return the state with the calibration's noise."""
    return replace(state, log_noise=problem.noise.centre)
