"""Cramér-Rao bounds: of the wavefront and of biased estimates (thesis §3.4, §3.5)."""

import numpy as np
import scipy.linalg

from labkit.arrays import positive, real_array, symmetric
from labkit.estimation.climb import NOISE, PER_FRAME, Problem, State
from labkit.estimation.likelihood import slopes
from labkit.types import Floats, Integers


def fisher_information(problem: Problem, state: State, modes_at_once: int = 4) -> Floats:
    """Return the information over all parameters of all frames, computed in little memory.

    The derivatives of at most twice `modes_at_once` modes of one frame are held at a time
    (thesis Figure 3.4). The price
    is that derivatives are computed more than once.

    Parameters
    ----------
    problem : frames, model and the prior of the noise
    state : where the information is evaluated
    modes_at_once : modes of a block

    Returns
    -------
    (p, p), parameters in the order of `State.moved`

    Raises
    ------
    ValueError
        for a block without modes

    Notes
    -----
    Thesis (3.15), (3.19), (3.28).
    """
    positive("modes_at_once", modes_at_once, "modes")
    modes = state.waves.size
    common = state.unevenness.size + NOISE
    size = modes + PER_FRAME * len(problem.frames) + common
    total = np.zeros((size, size))
    blocks = [
        slice(k, min(k + modes_at_once, modes)) for k in range(0, modes, modes_at_once)
    ]
    for k in range(len(problem.frames)):
        first = modes + k * PER_FRAME
        of_frame = np.arange(first, first + PER_FRAME)
        of_light = np.arange(size - common, size - NOISE)
        _add_frame(total, problem, state, k, np.concatenate([of_frame, of_light]), blocks)
    total[-NOISE:, -NOISE:] += np.diag(problem.noise.precision)
    return total


def _add_frame(
    total: Floats,
    problem: Problem,
    state: State,
    k: int,
    at_frame: Integers,
    blocks: list[slice],
) -> None:
    """Add the information of frame `k`. at_frame: rows of its pose and light; blocks: the modes'."""
    model = problem.model
    frame = problem.frames[k]
    detector = state.detectors()[k]
    drawing = model.draw([state.poses[k]])
    (evaluation,) = model.evaluate(state.waves, drawing, [frame.used], by_waves=False)
    by_frame = slopes(evaluation, frame, detector)
    mean = by_frame.of_mean
    variance = by_frame.of_variance
    both, cross, square = by_frame.weights()
    at_noise = len(total) - NOISE + np.arange(NOISE)
    total[np.ix_(at_frame, at_frame)] += mean * both @ mean.T
    _add(total, at_frame, at_noise, mean * cross @ variance.T)
    total[np.ix_(at_noise, at_noise)] += variance * square @ variance.T
    counts = detector.scale * frame.light(detector.unevenness)
    for i, block in enumerate(blocks):
        here = model.slopes(state.waves, drawing, frame.used, block) * counts
        at = np.arange(block.start, block.stop)
        total[np.ix_(at, at)] += here * both @ here.T
        _add(total, at, at_frame, here * both @ mean.T)
        _add(total, at, at_noise, here * cross @ variance.T)
        for later in blocks[i + 1 :]:
            there = model.slopes(state.waves, drawing, frame.used, later) * counts
            _add(total, at, np.arange(later.start, later.stop), here * both @ there.T)


def _add(total: Floats, rows: Integers, columns: Integers, block: Floats) -> None:
    """Add an off-diagonal block and its transpose."""
    total[np.ix_(rows, columns)] += block
    total[np.ix_(columns, rows)] += block.T


def uniform_bound(
    covariance: Floats, index: int, multipliers: Floats, norm: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the uniform Cramér-Rao bound of one parameter, over the norm of its bias's gradient.

    Parameters
    ----------
    covariance : (p, p), of an unbiased estimate
    index : of the parameter
    multipliers : (n,), Lagrange's, above 0: a large one leaves little bias; in the
        parameter's unit, squared
    norm : (p, p) C of ||d||^2 = d^T C d, the identity by default

    Returns
    -------
    norm : (n,), delta of the bias's gradient d
    variance : (n,), the bound, in the parameter's unit, squared

    Raises
    ------
    ValueError
        for a multiplier that is not positive, and for matrices that are not symmetric and
        finite

    Notes
    -----
    Thesis (3.47), (3.48).
    """
    multipliers = real_array(
        "multipliers", multipliers, (None,), "the parameter's unit squared"
    )
    if np.any(multipliers <= 0):
        raise ValueError(
            f"multipliers, shape {multipliers.shape}: all must be above 0 (the parameter's unit squared)"
        )
    size = len(covariance)
    covariance = symmetric(
        "covariance", covariance, size, "of the parameters' units, squared"
    )
    norm = (
        None
        if norm is None
        else symmetric("norm", norm, size, "of the parameters' units, inverse squared")
    )
    root = np.eye(size) if norm is None else np.asarray(scipy.linalg.sqrtm(norm).real)
    inverse = np.linalg.inv(root)
    beta, vectors = np.linalg.eigh(inverse @ covariance @ inverse)
    part = (root[index] @ vectors) ** 2
    lam = multipliers[:, None]
    delta = np.sqrt(np.sum((beta / (lam + beta)) ** 2 * part, axis=1))
    return delta, np.asarray(np.sum(lam**2 * beta / (lam + beta) ** 2 * part, axis=1))


def bias_sensitivity(covariance: Floats, index: int, norm: Floats | None = None) -> float:
    """Return the slope of the uniform bound at zero bias, in the parameter's unit, squared.

    The slope is -2 times the norm of the parameter's row of the covariance. Thesis §3.5.

    Parameters
    ----------
    covariance : (p, p), of an unbiased estimate
    index : of the parameter
    norm : (p, p), as of `uniform_bound`

    Raises
    ------
    ValueError
        for a covariance that is not symmetric and finite
    """
    row = symmetric(
        "covariance", covariance, len(covariance), "of the parameters' units, squared"
    )[index]
    weighted = row if norm is None else np.linalg.solve(norm, row)
    return float(-2 * np.sqrt(row @ weighted))
