"""How well frames determine parameters: Fisher information, Cramér-Rao bounds and what follows (thesis §3.4, §3.5)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from labkit.arrays import positive, real_array, symmetric
from labkit.imaging.warp import POSE_SIZE
from labkit.inference.fisher_scoring import NOISE, PER_FRAME, Problem, State
from labkit.inference.likelihood import FrameData, predict, slopes
from labkit.optics.zernike import mode_name
from labkit.types import Floats, Integers


def parameter_names(state: State, noll: Sequence[int]) -> tuple[str, ...]:
    """Names of all parameters of a state, in their order."""
    frames = [
        f"{name} of frame {k + 1}"
        for k in range(len(state.poses))
        for name in (*(f"pose {i}" for i in range(POSE_SIZE)), "scale", "ambient light")
    ]
    light = [f"unevenness {k + 1}" for k in range(state.unevenness.size)]
    return (*(mode_name(j) for j in noll), *frames, *light, "log gain", "log read variance")


def fisher_information(problem: Problem, state: State, modes_at_once: int = 4) -> Floats:
    """Information (p, p) over all parameters of all frames, thesis (3.15), (3.19), (3.28).

    Never holds the derivatives of more than twice so many modes of one frame (thesis Figure 3.4); the price is that they
    are computed more than once. The order of parameters is that of `State.moved`.
    """
    positive("modes_at_once", modes_at_once, "modes")
    modes, common = state.waves.size, state.unevenness.size + NOISE
    size = modes + PER_FRAME * len(problem.frames) + common
    total = np.zeros((size, size))
    blocks = [slice(k, min(k + modes_at_once, modes)) for k in range(0, modes, modes_at_once)]
    for k, (frame, detector) in enumerate(zip(problem.frames, state.detectors(), strict=True)):
        at_frame = np.concatenate(
            [np.arange(PER_FRAME) + modes + k * PER_FRAME, np.arange(size - common, size - NOISE)]
        )
        noise = np.array([size - 2, size - 1])
        drawing = problem.model.draw([state.poses[k]])
        (evaluation,) = problem.model.evaluate(state.waves, drawing, [frame.used], by_waves=False)
        of = slopes(evaluation, frame, detector)
        both, cross, square = of.weights()
        total[np.ix_(at_frame, at_frame)] += of.of_mean * both @ of.of_mean.T
        _add(total, at_frame, noise, of.of_mean * cross @ of.of_variance.T)
        total[np.ix_(noise, noise)] += of.of_variance * square @ of.of_variance.T
        factor = detector.scale * frame.light(detector.unevenness)
        for i, rows in enumerate(blocks):
            here = problem.model.slopes(state.waves, drawing, frame.used, rows) * factor
            at = np.arange(rows.start, rows.stop)
            total[np.ix_(at, at)] += here * both @ here.T
            _add(total, at, at_frame, here * both @ of.of_mean.T)
            _add(total, at, noise, here * cross @ of.of_variance.T)
            for columns in blocks[i + 1 :]:
                there = problem.model.slopes(state.waves, drawing, frame.used, columns) * factor
                _add(total, at, np.arange(columns.start, columns.stop), here * both @ there.T)
    total[-NOISE:, -NOISE:] += np.diag(problem.noise.precision)
    return total


def _add(total: Floats, rows: Integers, columns: Integers, block: Floats) -> None:
    total[np.ix_(rows, columns)] += block
    total[np.ix_(columns, rows)] += block.T


DETECTOR = ("light c1", "ambient light c2", "gain c3", "black level c4", "read noise")


def detector_information(relative: Floats, light: Floats, c: Floats) -> Floats:
    """Information (5, 5) of one frame on the thesis's five detector numbers of (3.4), `DETECTOR`: it is singular.

    relative, light: (pixels,) relative image and illumination; c: the five numbers, the last the standard deviation.
    mu = c3 V (c1 u + c2) + c4, Sigma = c3 (mu - c4) + read_noise^2.
    """
    relative = real_array("relative", relative, (None,), "of the target's radiance")
    light = real_array("light", light, relative.shape, "relative")
    c1, c2, c3, _, read = real_array("c", c, (len(DETECTOR),), "electrons; counts per electron; counts")
    bright = light * (c1 * relative + c2)
    zero, one = np.zeros_like(bright), np.ones_like(bright)
    means = np.stack([c3 * light * relative, c3 * light, bright, one, zero])
    variances = np.stack([c3**2 * light * relative, c3**2 * light, 2 * c3 * bright, zero, 2 * read * one])
    variance = c3**2 * bright + read**2
    return np.asarray((means / variance) @ means.T + (variances * 0.5 / variance**2) @ variances.T)


def uniform_bound(
    covariance: Floats, index: int, multipliers: Floats, norm: Floats | None = None
) -> tuple[Floats, Floats]:
    """The uniform Cramér-Rao bound of one parameter: (bias-gradient norm delta, bound on the variance), thesis (3.47), (3.48).

    covariance: (p, p) of an unbiased estimate. multipliers: (n,) positive, from large (delta near 0) to small. norm: (p, p) C
    of the norm ||d||^2 = d^T C d, the identity by default.
    Raises ValueError for a multiplier that is not positive, and for matrices that are not symmetric and finite.
    """
    multipliers = real_array("multipliers", multipliers, (None,), "the parameter's unit squared")
    if np.any(multipliers <= 0):
        raise ValueError(f"multipliers, shape {multipliers.shape}: all must be above 0 (the parameter's unit squared)")
    size = len(covariance)
    covariance = symmetric("covariance", covariance, size, "of the parameters' units, squared")
    norm = None if norm is None else symmetric("norm", norm, size, "of the parameters' units, inverse squared")
    root = np.eye(size) if norm is None else np.asarray(scipy.linalg.sqrtm(norm).real)
    inverse = np.linalg.inv(root)
    beta, vectors = np.linalg.eigh(inverse @ covariance @ inverse)
    part = (root[index] @ vectors) ** 2
    lam = multipliers[:, None]
    delta = np.sqrt(np.sum((beta / (lam + beta)) ** 2 * part, axis=1))
    return delta, np.asarray(np.sum(lam**2 * beta / (lam + beta) ** 2 * part, axis=1))


def bias_sensitivity(covariance: Floats, index: int, norm: Floats | None = None) -> float:
    """Slope of the uniform bound at no bias, in the parameter's unit squared: -2 || row of the covariance ||, thesis §3.5."""
    row = symmetric("covariance", covariance, len(covariance), "of the parameters' units, squared")[index]
    weighted = row if norm is None else np.linalg.solve(norm, row)
    return float(-2 * np.sqrt(row @ weighted))


def expected(problem: Problem, state: State) -> Problem:
    """The same problem with its frames as they are expected at a state, without noise."""
    frames: list[FrameData] = []
    for frame, detector, relative in zip(problem.frames, state.detectors(), problem.relative(state), strict=True):
        counts = np.zeros(frame.counts.shape)
        counts[frame.used] = predict(relative, frame, detector)[0]
        frames.append(replace(frame, counts=counts))
    return replace(problem, frames=tuple(frames))
