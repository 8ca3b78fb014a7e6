"""A photograph's own noise, for another camera or sensitivity than the session's.

Photon transfer within one picture: second differences leave noise and little of the scene, and of the squares of one brightness
those that vary least show noise alone (A. Foi et al., IEEE Trans. Image Process. 17, 1737 (2008), in the simplest form).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri

from labkit.restoration.job import Colour, Exposure, Job
from labkit.types import Bools, Floats

DIFFERENCE_STRIDE, SQUARE_SIDE = (
    3,
    4,
)  # counts between differences that share none; differences to a square's side
QUIET = 0.1  # share of a brightness's squares that show noise alone
BRIGHTNESSES = 12
LEAST_SQUARES = 100
LEAST_VARIANCE = 1 / 12  # of rounding
ROUNDS = 5


def own_noise(
    photograph: Exposure, colour: Colour, period: int
) -> tuple[float, float] | None:
    """Return (gain in counts per electron, read variance in counts squared) of a colour; None for too small or dark a picture.

    In a scene without even areas this is an upper bound, for the roughness passes for noise.
    """
    planes = [(slice(r, None, period), slice(c, None, period)) for r, c in colour.places]
    squares = [
        _squares(photograph.counts[plane].astype(float), photograph.used[plane])
        for plane in planes
    ]
    level, variance = np.concatenate(squares, axis=1)
    if level.size < LEAST_SQUARES:
        return None
    order = np.argsort(level)
    groups = [
        group for group in np.array_split(order, BRIGHTNESSES) if level[group].mean() > 0
    ]
    # quantile of noise alone, over its mean
    usual = float(chdtri(SQUARE_SIDE**2, 1 - QUIET)) / SQUARE_SIDE**2
    at = np.array([level[group].mean() for group in groups])
    found = np.array([np.quantile(variance[group], QUIET) for group in groups]) / usual
    gain, floor = _line(at, np.maximum(found, LEAST_VARIANCE))
    return (gain, max(floor, LEAST_VARIANCE)) if gain > 0 else None


def _squares(counts: Floats, used: Bools) -> Floats:
    """Return (2, squares) mean level, and variance by second differences along both axes, of one plane."""
    kernel = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0)) / 6  # of unit noise unit noise
    rows, columns = (
        side // (DIFFERENCE_STRIDE * SQUARE_SIDE) * SQUARE_SIDE for side in counts.shape
    )
    cells = (rows, DIFFERENCE_STRIDE, columns, DIFFERENCE_STRIDE)
    cut = (slice(DIFFERENCE_STRIDE * rows), slice(DIFFERENCE_STRIDE * columns))
    apart = np.einsum("iajb,ab->ij", counts[cut].reshape(cells), kernel)
    whole = (rows // SQUARE_SIDE, SQUARE_SIDE, columns // SQUARE_SIDE, SQUARE_SIDE)
    level = counts[cut].reshape(cells).mean(axis=(1, 3)).reshape(whole).mean(axis=(1, 3))
    there = np.all(
        np.all(used[cut].reshape(cells), axis=(1, 3)).reshape(whole), axis=(1, 3)
    )
    return np.array([level[there], (apart**2).reshape(whole).mean(axis=(1, 3))[there]])


def _line(level: Floats, variance: Floats) -> tuple[float, float]:
    """Return slope and floor, neither below 0, by relative least squares: a square's variance errs by a share of itself."""
    expected = variance
    for _ in range(ROUNDS):
        slope, floor = nnls(
            np.column_stack([level, np.ones(level.size)]) / expected[:, None],
            variance / expected,
        )[0]
        expected = np.maximum(slope * level + floor, LEAST_VARIANCE)
    return float(slope), float(floor)


def with_own_noise(job: Job, notes: list[str]) -> Job:
    """Return the job with the noise of the first photograph, which may be of another camera, and note it."""
    colours = []
    for colour in job.colours:
        if (noise := own_noise(job.photographs[0], colour, job.period)) is not None:
            notes.append(
                f"{colour.name}: the noise is the photograph's own, {noise[0]:.2g} counts an electron; the session's has "
                f"{colour.gain:.2g}"
            )
            colour = replace(colour, gain=noise[0], read_variance=noise[1])
        colours.append(colour)
    return replace(job, colours=tuple(colours))
