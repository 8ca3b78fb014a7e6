"""Tests whether the end of a maximisation is the global optimum: thesis §4.2, on the camera model.

Each test has a statistic that is large at a wrong optimum, and a fast form of its distribution at the right one; `bootstrap`
gives the threshold without any theory, by fitting data drawn from the optimum itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.special import chdtrc, ndtr

from labkit.arrays import positive, real_array
from labkit.imaging.model import ForwardModel
from labkit.inference.fisher_scoring import PER_FRAME, NoisePrior, Problem, State, maximize
from labkit.inference.likelihood import predict
from labkit.types import Complexes, Floats

SPACING_AIRY = 0.4  # between samples of a PSF basis, in lambda N


@dataclass(frozen=True, slots=True)
class OptimumTest:
    """statistic: large at a wrong optimum; p_value: chance of one as large at the right one, by the test's fast form."""

    name: str
    statistic: float
    p_value: float


def excess_likelihood(problem: Problem, state: State) -> float:
    """(l - E l) / sqrt(Var l), the validation function of (4.10), (4.12); negative where data are less likely than due.

    For independent normal pixels E l and Var l under the optimum itself are closed: each pixel's -chi2/2 has mean -1/2 and
    variance 1/2. The parameters that were fitted to the data raise l by half their number. The noise is that of the
    calibration, for fitted to the data it would explain anything; the calibration's errors join Var l.
    """
    state = _calibrated(problem, state)
    misfit, photons, pixels = 0.0, 0.0, 0
    for frame, detector, relative in zip(problem.frames, state.detectors(), problem.relative(state), strict=True):
        mean, variance = predict(relative, frame, detector)
        misfit += float(np.sum((frame.counts[frame.used] - mean) ** 2 / variance))
        photons += float(np.sum(detector.gain * np.maximum(mean, 0) / variance))
        pixels += mean.size
    fitted = state.waves.size + PER_FRAME * len(problem.frames) + state.unevenness.size
    shares = np.array([photons, pixels - photons])
    spread = 2 * pixels + float(np.sum(shares**2 / problem.noise.precision))
    return (pixels - fitted - misfit) / float(np.sqrt(spread))


def two_sided(problem: Problem, state: State) -> OptimumTest:
    """Biernacki's test, (4.10)."""
    z = excess_likelihood(problem, state)
    return OptimumTest("Biernacki", z**2, float(chdtrc(1, z**2)))


def one_sided(problem: Problem, state: State) -> OptimumTest:
    """The one-sided test, (4.12): by Theorem IV.1 a wrong optimum can only make the data less likely."""
    z = excess_likelihood(problem, state)
    return OptimumTest("one-sided", -z, float(ndtr(z)))


def rao_score(gradient: Floats, information: Floats) -> float:
    """s^T F^-1 s, (4.26); chi-squared with as many degrees of freedom as parameters at the truth."""
    gradient = real_array("gradient", gradient, (None,), "log-likelihoods for a unit of each parameter")
    information = real_array("information", information, (gradient.size,) * 2, "of those units, inverse squared")
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))  # what the data do not move at all adds nothing
    scaled, gradient = information * np.outer(scale, scale), gradient * scale
    return float(gradient @ np.linalg.lstsq(scaled, gradient, rcond=1e-12)[0])


def _calibrated(problem: Problem, state: State) -> State:
    return replace(state, log_noise=problem.noise.centre)


@dataclass(frozen=True, eq=False)
class PsfBasis:
    """Directions in which a PSF may depart from any wavefront's: the reparameterised embedding of §4.2.3.

    directions: (k, n, n) changes of the PSF, n odd, centred, SPACING_AIRY lambda N apart, computed by `find_psf_basis`.
    """

    directions: Floats

    def __post_init__(self) -> None:
        side = np.shape(self.directions)[-1] if np.ndim(self.directions) else 0
        real_array("directions", self.directions, (None, side, side), "PSF")
        if not side % 2:
            raise ValueError(f"directions has shape {self.directions.shape}; an odd side is needed (PSF)")

    @property
    def degrees(self) -> int:
        return len(self.directions)

    def kernels(self, model: ForwardModel) -> list[Complexes]:
        """Half planes of their transfer functions on a model's torus, the pixel's included."""
        torus, pupil = model.blur.torus, model.blur.pupil
        step = torus.spacing_um / (pupil.wavelength_um * pupil.f_number) / SPACING_AIRY
        half = self.directions.shape[1] // 2
        reach = int(half / step)
        at = np.arange(-reach, reach + 1) * step + half
        down, right = torus.shift(reach * torus.spacing_um)
        beyond = model.blur.beyond
        return [
            torus.half_spectrum_of_window(map_coordinates(d, np.meshgrid(at, at, indexing="ij"), order=3))
            * (down * right * beyond)
            for d in self.directions
        ]


def embedding(problem: Problem, state: State, basis: PsfBasis) -> OptimumTest:
    """Twice the gap (4.21) that a basis of the PSF opens, by Rao's score: one Newton step instead of another maximisation.

    It is chi-squared with `basis.degrees` at the right optimum (Wilks); `wilson_hilferty` is nearly as
    good and needs no tables.
    """
    gradient, information = _embedded_score(problem, state, basis.kernels(problem.model))
    gap2 = rao_score(gradient, information)
    return OptimumTest("embedding", gap2, float(chdtrc(basis.degrees, gap2)))


def wilson_hilferty(statistic: float, degrees: int) -> float:
    """Normal deviate of a chi-squared statistic, by the cube root."""
    positive("degrees", degrees, "degrees of freedom")
    if not statistic >= 0:
        raise ValueError(f"statistic = {statistic:g}: a chi-squared one is not negative (unitless)")
    spread = 2 / (9 * degrees)
    return float(((statistic / degrees) ** (1 / 3) - (1 - spread)) / np.sqrt(spread))


def _embedded_score(problem: Problem, state: State, kernels: list[Complexes]) -> tuple[Floats, Floats]:
    """Gradient and information over all fitted parameters, with the basis's first of all, as if they were modes."""
    used, drawing = [f.used for f in problem.frames], problem.draw(state)
    torus, embedded = problem.model.blur.torus, []
    evaluations = problem.model.evaluate(state.waves, drawing, used)
    for evaluation, spectrum, u in zip(evaluations, drawing.spectra, used, strict=True):
        departures = [torus.sample(spectrum, kernel)[u] for kernel in kernels]
        embedded.append(replace(evaluation, by_waves=np.concatenate([departures, evaluation.by_waves])))
    return problem.assembled(state, embedded)[:2]


def bootstrap(
    problem: Problem,
    state: State,
    statistics: Callable[[Problem, State], Sequence[float]],
    rng: np.random.Generator,
    draws: int,
) -> Floats:
    """(draws, n) of n statistics over data drawn from an optimum and fitted anew: as they are distributed at the right one.

    The calibration of the noise is drawn anew as well, within its standard errors.
    """
    positive("draws", draws, "sets of data")
    values = []
    truth = _calibrated(problem, state)
    images = problem.relative(truth)
    for _ in range(draws):
        frames = []
        for frame, detector, relative in zip(problem.frames, truth.detectors(), images, strict=True):
            mean, variance = predict(relative, frame, detector)
            counts = np.zeros(frame.counts.shape)
            counts[frame.used] = rng.normal(mean, np.sqrt(variance))
            frames.append(replace(frame, counts=counts))
        drawn = replace(problem, frames=tuple(frames), noise=recalibrated(problem.noise, rng))
        values.append(statistics(drawn, maximize(drawn, replace(truth, log_noise=drawn.noise.centre)).state))
    return np.array(values)


def against(test: OptimumTest, drawn: Floats) -> OptimumTest:
    """The same test with its p-value by bootstrap: rank among statistics (draws,) drawn at the right optimum."""
    drawn = real_array("drawn", drawn, (None,), "the statistic's")
    return replace(test, p_value=float((1 + np.sum(drawn >= test.statistic)) / (1 + drawn.size)))


def recalibrated(noise: NoisePrior, rng: np.random.Generator) -> NoisePrior:
    """What another calibration as good would have measured of the noise."""
    gain, read_variance = np.exp(rng.normal(noise.centre, 1 / np.sqrt(noise.precision)))
    return replace(noise, gain=float(gain), read_variance=float(read_variance))


def find_psf_basis(cases: list[tuple[Problem, State, Floats]], degrees: int, half_width: int = 14) -> PsfBasis:
    """Algorithm 4.9 in the space of PSFs, which serves every pose and wavefront.

    cases: (problem of one frame without noise, a wrong optimum of it, weights (pixels,), one over the variance). The
    score by every sample of the PSF at each wrong optimum is whitened by the information; the leading left singular
    vectors, taken back, are the directions.
    """
    scores: list[Floats] = []
    information = np.zeros(((2 * half_width + 1) ** 2,) * 2)
    for problem, state, weights in cases:
        samples = _psf_samples(problem, state, half_width)
        (frame,) = problem.frames
        residual = frame.counts[frame.used] - predict(problem.relative(state)[0], frame, state.detectors()[0])[0]
        scores.append(samples @ (residual * weights))
        information += samples * weights @ samples.T
    values, vectors = np.linalg.eigh(information / len(cases))
    kept = values > 1e-6 * values[-1]
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    left = np.linalg.svd(whiten.T @ np.array(scores).T, full_matrices=False)[0][:, :degrees]
    side = 2 * half_width + 1
    return PsfBasis((whiten @ left).T.reshape(degrees, side, side))


def _psf_samples(problem: Problem, state: State, half_width: int) -> Floats:
    """(samples, pixels) what each sample of the PSF, SPACING_AIRY apart, adds to the frame."""
    model = problem.model
    torus, pupil = model.blur.torus, model.blur.pupil
    (frame,) = problem.frames
    (spectrum,) = problem.draw(state).spectra
    spectrum = spectrum * model.blur.beyond * state.scales[0]
    step_um = SPACING_AIRY * pupil.wavelength_um * pupil.f_number
    places = np.arange(-half_width, half_width + 1) * step_um
    down = [np.exp(-2j * np.pi * torus.row_frequency * y) for y in places]
    right = [np.exp(-2j * np.pi * torus.column_frequency * x) for x in places]
    return np.array([torus.sample(spectrum, a * b)[frame.used] for a in down for b in right])


@cache
def shipped_psf_basis(degrees: int) -> PsfBasis:
    """The first of the 16 directions that `benchmarks/make_psf_basis.py` computed at the conditions of thesis §3.8.

    Raises ValueError for more or none.
    """
    with resources.as_file(resources.files("labkit.inference") / "psf_basis.npz") as path:
        directions = np.load(path)["directions"]
    if not 1 <= degrees <= len(directions):
        raise ValueError(f"degrees = {degrees}: 1 to {len(directions)} directions are shipped")
    return PsfBasis(directions[:degrees].astype(float))
