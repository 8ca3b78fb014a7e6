"""How a gradient scatters: by the flats' errors, and by residuals that are not noise alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse

from labkit.estimation.climb import NOISE, Problem, State
from labkit.estimation.likelihood import slopes
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation
from labkit.types import Bools, Floats


def scattered(
    problem: Problem, state: State, evaluations: Sequence[Evaluation]
) -> tuple[Floats, Floats]:
    """Return two covariances (p, p) of the gradient: due to the flats' relative errors, and from the scatter of blocks.

    Residuals of neighbouring pixels may be correlated, those of blocks are not.
    """
    places = state.places(len(evaluations[0].by_waves))
    size = 1 + int(places[0][-1])
    flats, blocks = np.zeros((size, size)), np.zeros((size, SETTINGS.blocks**2))
    for index, evaluation, frame, detector in zip(
        places, evaluations, problem.frames, state.detectors(), strict=True
    ):
        of = slopes(evaluation, frame, detector)
        weighted = of.of_mean * (frame.relative_std[frame.used] * of.mean / of.variance)
        flats[np.ix_(index[:-NOISE], index[:-NOISE])] += weighted @ weighted.T
        by_mean, by_variance = of.pulls(frame.counts[frame.used])
        pulled = np.concatenate([of.of_mean * by_mean, of.of_variance * by_variance])
        blocks[index] += pulled @ _in_blocks(frame.used)
    blocks -= blocks.mean(axis=1, keepdims=True)
    return flats, np.asarray(blocks @ blocks.T)


def _in_blocks(used: Bools) -> scipy.sparse.csr_array:
    """Return a matrix (pixels, blocks^2) with 1 for the block that contains a used pixel."""
    rows, columns = (
        at * SETTINGS.blocks // n
        for at, n in zip(np.nonzero(used), used.shape, strict=True)
    )
    pixels = rows.size
    return scipy.sparse.csr_array(
        (np.ones(pixels), (np.arange(pixels), rows * SETTINGS.blocks + columns)),
        (pixels, SETTINGS.blocks**2),
    )
