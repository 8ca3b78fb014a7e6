"""Standard errors of a restored scene: the diagonal of the inverse of the penalised misfit's second derivatives.

Where all counts are equally good that is the same from cell to cell of the filter array, and known without estimating it: a
sample's variance before the data, less what the data of all cells take off it. Noise that changes slowly over the picture is
taken as even about each sample; what is clipped or dead has no weight in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy import ndimage

from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.views import Views
from labkit.types import AnyFloats, Complexes, Floats, Floats32

ERROR_LEVELS = 6
FAINTEST = 1e-3  # of the usual weight: less counts as this much
NEAR_CELLS = (
    1.0  # standard deviation, cells, of the neighbourhood whose counts a sample hangs on
)


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """std: (components, rows, columns) of the frame's samples, counts; by_penalty: which share of the variance is what the
    penalty holds open, the rest being the noise's: where it is near 1 the penalty rules, and std is as true as the penalty is
    of the scene."""

    std: Floats32
    by_penalty: Floats32


def standard_errors(
    views: Views, small: Views, coupling: Floats, stiffness: float, means: Sequence[Floats]
) -> ErrorMap:
    """Of the scene that `restore` finds, the bound at 0 left out.

    small: the same planes through the same lenses on a torus that is only as large as the PSF; stiffness: as `Strength` has it;
    means: of each plane of `views`.
    """
    weights = [
        view.light**2 * view.weight(mean) for view, mean in zip(views, means, strict=True)
    ]
    typical = [float(np.median(weight[weight > 0])) for weight in weights]
    near = np.mean(
        [_near(weight / usual) for weight, usual in zip(weights, typical, strict=True)],
        axis=0,
    )
    level = np.log(np.maximum(near, FAINTEST))
    at = (
        np.linspace(level.min(), level.max(), ERROR_LEVELS)
        if np.ptp(level) > 1e-6
        else np.array([level.mean()])
    )
    every = [
        _even(small, coupling, stiffness, [usual * np.exp(one) for usual in typical])
        for one in at
    ]
    variance, share = (np.array([pair[k] for pair in every]) for k in (0, 1))
    step = views.grid.cells.oversampling
    std, by_penalty = (
        _spread_out(np.log(values), at, level, step) for values in (variance, share)
    )
    return ErrorMap(np.exp(0.5 * std), np.exp(by_penalty))


def _near(weight: Floats) -> Floats:
    """A mean over each cell's neighbourhood; what lies beyond the frame has no weight."""
    return ndimage.gaussian_filter(weight, NEAR_CELLS, mode="constant")


def _even(
    small: Views, coupling: Floats, stiffness: float, weights: Sequence[float]
) -> tuple[Floats, Floats]:
    """(components, step, step) variance of a cell's samples, and the penalty's share of it, where weights are even."""
    grid = small.grid
    longest = max(side / grid.samples for side in grid.shape)
    rough = stiffness / grid.samples**2
    solid = Stiffness(grid, coupling, rough, rough * (2 * np.pi / longest) ** 2)
    full = [
        np.full(view.counts.shape, weight)
        for view, weight in zip(small, weights, strict=True)
    ]
    inverse = _whole_plane(Kriging(small, solid, full).nearly, grid.cells.pixels)
    half = grid.shape[0] // 2 + 1
    variances, shares = [], []
    for component in range(small.components):
        before = float(
            np.sum(grid.share * solid.between(component, component), dtype=np.float64)
        )
        kernels: list[Complexes] = [
            np.multiply(
                np.conj(view.transfer),
                solid.between(component, view.component),
                dtype=complex,
            )
            for view in small
        ]
        taken, noise = (
            np.zeros(2 * (grid.cells.oversampling,)),
            np.zeros(2 * (grid.cells.oversampling,)),
        )
        for j, kernel in enumerate(kernels):
            answer: Complexes = np.zeros(kernel.shape, complex)
            for i, other in enumerate(kernels):
                answer += _repeated(inverse[i, j], half, grid.cells.oversampling) * other
            free, held = grid.image(kernel), grid.image(answer)
            taken = taken + _over_cells(free * held, grid.cells.oversampling)
            noise = noise + _over_cells(held**2, grid.cells.oversampling) / weights[j]
        variance = before - taken
        variances.append(variance)
        shares.append(np.clip(1 - noise / variance, 1e-6, 1.0))
    return np.array(variances), np.array(shares)


def _whole_plane(half: Complexes, cells: tuple[int, int]) -> Complexes:
    """(views, views, rows, columns) of half planes over columns, of kernels that are real."""
    return np.asarray(scipy.fft.fft2(scipy.fft.irfft2(half, s=cells)))


def _repeated(cells: Complexes, half: int, times: int) -> Complexes:
    """A filter on cells as a half plane of fine samples."""
    return np.tile(cells, (1, times))[np.arange(half) % len(cells)]


def _over_cells(kernel: AnyFloats, step: int) -> Floats:
    """(step, step) a kernel summed over its places in all cells."""
    rows, columns = (side // step for side in kernel.shape)
    return np.asarray(
        kernel.reshape(rows, step, columns, step).sum(axis=(0, 2), dtype=np.float64)
    )


def _spread_out(values: Floats, at: Floats, level: Floats, step: int) -> Floats32:
    """(components, rows, columns) samples of cells with a level each, from values (levels, components, step, step)."""
    place = np.zeros(level.shape) if len(at) == 1 else (level - at[0]) / (at[1] - at[0])
    below = np.clip(place.astype(int), 0, max(len(at) - 2, 0))
    above = np.minimum(below + 1, len(at) - 1)
    part = (place - below)[..., None, None]
    rows, columns = level.shape
    result = np.empty((values.shape[1], rows * step, columns * step), np.float32)
    for component in range(values.shape[1]):
        of = values[:, component]
        mixed = (1 - part) * of[below] + part * of[above]
        result[component] = mixed.transpose(0, 2, 1, 3).reshape(rows * step, columns * step)
    return result
