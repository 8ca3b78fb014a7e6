"""Residuals of an optimum: tests whether they are noise alone, and their power by spatial frequency.

A wrong optimum leaves structure of two kinds, which are tested separately: more variance than the calibrated noise, and
correlation between nearby pixels. The power of noise alone is flat over all frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, ndtr

from labkit.estimation.climb import Problem, State
from labkit.estimation.identifiability import worse_than
from labkit.estimation.likelihood import Detector, FrameData, predict
from labkit.estimation.settings import SETTINGS
from labkit.optics.other_circle import root_over_clear_part
from labkit.optics.rim import ROUND, Rim
from labkit.optics.zernike import mode_name
from labkit.types import Floats

LAGS = (
    (0, 1),
    (1, 0),
    (1, 1),
    (1, -1),
    (0, 2),
    (2, 0),
    (2, 2),
    (2, -2),
)  # rows and columns, in pixels
RADIAL_BINS = 12


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of the residual tests on an optimum.

    Attributes
    ----------
    p_value : probability of residuals as extreme at the true parameters
    accepted : whether the optimum is accepted
    excess : excess variance, standard normal at the true parameters
    correlation : sum of squared correlations over all lags in LAGS that exist, each standard normal at the true parameters
    name : name of the test
    undetermined : combinations of modes that the data do not determine, in words
    """

    p_value: float
    accepted: bool
    excess: float
    correlation: float
    name: str = "residuals"
    undetermined: tuple[str, ...] = ()

    def given_covariance(
        self, covariance: Floats, noll: Sequence[int], rim: Rim = ROUND
    ) -> "Verdict":
        """Return the verdict, rejected if a covariance leaves the wavefront over the clear pupil undetermined.

        Behind a cat's eye modes of the full pupil have large errors together that no light shows.

        Parameters
        ----------
        covariance : (modes, modes), waves RMS squared
        noll : Noll's numbers of the modes
        rim : the pupil's
        """
        names, root = [mode_name(j) for j in noll], root_over_clear_part(noll, rim)
        open_ = worse_than(SETTINGS.unmeasured, covariance, names, root)
        return replace(self, accepted=self.accepted and not open_, undetermined=open_)


def judge(
    problem: Problem,
    state: State,
    relative: Sequence[Floats],
    model_error: float = SETTINGS.model_error,
) -> Verdict:
    """Judge an optimum by its residuals.

    Two one-sided tests are combined by Bonferroni's rule. The excess variance is chi2 against the calibrated noise, in
    standard deviations that include the errors of the calibration and of the model; without a noise calibration the excess is
    not tested. The correlation over several lags is a portmanteau test as by Box and Pierce.

    Parameters
    ----------
    problem : frames and their model
    state : the optimum
    relative : relative image (pixels,) of the used pixels of each frame
    model_error : relative error of the residuals' variance due to the model

    Raises
    ------
    ValueError : the number of images differs from the number of frames
    """
    if len(relative) != len(problem.frames):
        raise ValueError(
            f"relative: {len(relative)} images (of the target's radiance) for {len(problem.frames)} frames"
        )
    gain, read_variance = np.exp(problem.noise.centre)
    total = 0.0
    pixels = 0
    photons = 0.0
    across = np.zeros(len(LAGS))
    scatter = np.zeros(len(LAGS))
    calibrated = bool(np.all(problem.noise.precision > SETTINGS.unmeasured**-2))
    for frame, detector, u in zip(problem.frames, state.detectors(), relative, strict=True):
        mean, variance = predict(
            u,
            frame,
            replace(detector, gain=float(gain), read_variance=float(read_variance)),
        )
        residual = frame.counts[frame.used] - mean
        total += float(np.sum(residual**2 / variance))
        pixels += mean.size
        photons += float(np.sum(gain * np.maximum(mean, 0) / variance))
        image = np.zeros(frame.used.shape)
        image[frame.used] = residual / np.sqrt(variance) if calibrated else residual
        for k, lag in enumerate(LAGS):
            product = _product(image, lag)
            across[k] += product.sum()
            scatter[k] += np.sum(product**2)
    excess = 0.0
    if calibrated:
        shares = np.array([photons / pixels, 1 - photons / pixels])
        allowed = (
            2 / pixels + float(np.sum(shares**2 / problem.noise.precision)) + model_error**2
        )
        excess = float((total / pixels - 1) / np.sqrt(allowed))
    # products of independent residuals scatter about zero by their own squares, whatever the pixels' variances
    lags = scatter > 0  # a Bayer plane has no neighbours at odd distances
    correlation = float(np.sum(across[lags] ** 2 / scatter[lags])) / (
        1 + pixels * (model_error / 4) ** 2
    )
    p_value = min(
        1.0, 2 * float(min(ndtr(-excess), chdtrc(np.count_nonzero(lags), correlation)))
    )
    return Verdict(p_value, p_value >= SETTINGS.contradiction_chance, excess, correlation)


def _product(image: Floats, lag: tuple[int, int]) -> Floats:
    """Multiply each pixel with the pixel a lag (rows >= 0, columns) away."""
    down, right = lag
    rows, columns = image.shape
    here = image[: rows - down, max(0, -right) : columns - max(0, right)]
    return here * image[down:, max(0, right) : columns - max(0, -right)]


def residual_frequencies(frames: Sequence[FrameData]) -> Floats:
    """Return the frequencies of `residual_spectrum`, (BINS,) cycles per pixel: middles of evenly spaced rings."""
    return (np.arange(RADIAL_BINS) + 0.5) * _highest(frames) / RADIAL_BINS


def residual_spectrum(
    frames: Sequence[FrameData], relative: Sequence[Floats], detectors: Sequence[Detector]
) -> Floats:
    """Compute the power of normalised residuals by spatial frequency.

    Frequencies beyond the Nyquist frequency of a Bayer plane are aliases, and are left out.

    Parameters
    ----------
    frames : counts, with calibration
    relative : relative image (pixels,) of the used pixels of each frame
    detectors : detector numbers of each frame

    Returns
    -------
    (BINS,) power averaged over rings of frequencies and over frames; 1 for noise alone
    """
    highest = _highest(frames)
    total = np.zeros(RADIAL_BINS)
    for frame, image, detector in zip(frames, relative, detectors, strict=True):
        mean, variance = predict(image, frame, detector)
        rest = np.zeros(frame.used.shape)
        rest[frame.used] = (frame.counts[frame.used] - mean) / np.sqrt(variance)
        power = np.abs(np.fft.fft2(rest)) ** 2 / mean.size
        at = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, rest.shape), indexing="ij"))
        rings = np.digitize(at, np.linspace(0, highest, RADIAL_BINS + 1)) - 1
        inside = rings < RADIAL_BINS
        total += np.bincount(rings[inside], power[inside], RADIAL_BINS) / np.maximum(
            np.bincount(rings[inside], minlength=RADIAL_BINS), 1
        )
    return total / len(frames)


def _highest(frames: Sequence[FrameData]) -> float:
    """Return the Nyquist frequency of the frames' pixels, cycles per pixel; a Bayer plane has half of the sensor's."""
    rows, columns = np.nonzero(frames[0].used)
    alone = frames[0].used.sum() < 0.6 * (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    return 0.25 if alone else 0.5
