"""Standard errors of a restored scene: the diagonal of the inverse of the penalised misfit's second derivatives.

Where all counts are equally good that is the same from cell to cell of the filter array, and known without estimating it: a
sample's variance before the data, less its reduction by the data of all cells. Noise that changes slowly over the picture is
taken as even about each sample; clipped and dead pixels have no weight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from scipy import ndimage

from labkit.restoration.grid import SceneGrid
from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.views import Views
from labkit.types import AnyFloats, Complexes, Floats, Floats32

WEIGHT_LEVELS = 6
FAINTEST = 1e-3  # of the usual weight: less counts as this much
NEAR_CELLS = 1.0  # standard deviation of the neighbourhood that a sample depends on
EVEN = 1e-6  # spread of logarithms of weights


class ErrorMap(NamedTuple):
    """Errors of a restored scene.

    Attributes
    ----------
    std : (components, rows, columns) of the frame's samples, counts
    by_penalty : share of the variance that the penalty holds open, the rest being the noise's; near 1 the penalty rules,
        and std is as true as the penalty is of the scene
    """

    std: Floats32
    by_penalty: Floats32


def standard_errors(
    views: Views, small: Views, coupling: Floats, stiffness: float, means: Floats
) -> ErrorMap:
    """Return the errors of the scene by `restore`, without regard to its bound at 0.

    Parameters
    ----------
    views : the data
    small : the same planes through the same lenses on a torus only as large as the PSF
    coupling : as of `Roughness`
    stiffness : as of `Strength`
    means : (views, rows, columns)
    """
    weights = views.light**2 * views.weights(means)
    usual = np.array([np.median(weight[weight > 0]) for weight in weights])
    # a mean over each cell's neighbourhood, in which places beyond the frame have no weight
    near = np.mean(
        [
            ndimage.gaussian_filter(weight / of, NEAR_CELLS, mode="constant")
            for weight, of in zip(weights, usual, strict=True)
        ],
        axis=0,
    )
    level = np.log(np.maximum(near, FAINTEST))
    even = np.ptp(level) <= EVEN
    at = (
        np.full(1, level.mean())
        if even
        else np.linspace(level.min(), level.max(), WEIGHT_LEVELS)
    )
    every = [_even(small, coupling, stiffness, usual * np.exp(one)) for one in at]
    step = views.grid.cells.oversampling
    std, by_penalty = (
        _spread_out(np.log([pair[k] for pair in every]), at, level, step) for k in (0, 1)
    )
    return ErrorMap(np.exp(0.5 * std), np.exp(by_penalty))


def random_error(
    views: Views, coupling: Floats, stiffness: float, rng: np.random.Generator
) -> Floats32:
    """Return the error (components, rows, columns) of the frame of a random scene, restored without regard to its bound.

    The scene is Gaussian, with the penalty's spectrum, and as bright as the data.
    """
    grid = views.grid
    solid = _supposed(grid, coupling, stiffness)
    white = grid.spectrum(rng.standard_normal((views.components, *grid.shape), np.float32))
    spectra = np.tensordot(solid.turn, np.sqrt(solid.give) * white, 1).astype(np.complex64)
    weights = views.weights(views.flat(views.levels()))
    noise = rng.normal(size=weights.shape) / np.sqrt(np.where(weights > 0, weights, 1.0))
    kriging = Kriging(views, solid, weights)
    restored = kriging.scene(kriging.solve(views.means(spectra) + noise))
    return np.asarray(grid.image(restored - spectra)[:, *grid.inner], np.float32)


def _supposed(grid: SceneGrid, coupling: Floats, stiffness: float) -> Stiffness:
    """Return the penalty's inverse covariance of scenes. stiffness: as of `Strength`."""
    longest = max(side / grid.samples for side in grid.shape)
    rough = stiffness / grid.samples**2
    return Stiffness(grid, coupling, rough, rough * (2 * np.pi / longest) ** 2)


def _even(
    small: Views, coupling: Floats, stiffness: float, weights: Floats
) -> tuple[Floats, Floats]:
    """Return the variance (components, step, step) of a cell's samples, and the penalty's share of it, for even weights."""
    grid = small.grid
    solid = _supposed(grid, coupling, stiffness)
    full = [np.full(small.counts.shape[1:], weight) for weight in weights]
    kriging = Kriging(small, solid, full)
    # half planes over columns of kernels that are real, made whole
    whole = scipy.fft.irfft2(kriging.nearly, s=grid.cells.pixels)
    inverse = np.asarray(scipy.fft.fft2(whole))
    half, step = grid.shape[0] // 2 + 1, grid.cells.oversampling
    variances, shares = [], []
    for c in range(small.components):
        before = float(np.sum(grid.share * solid.between(c, c), dtype=np.float64))
        kernels: list[Complexes] = []
        for view in small:
            between = solid.between(c, view.component)
            kernels.append(np.multiply(np.conj(view.transfer), between, dtype=complex))
        taken, noise = np.zeros((step, step)), np.zeros((step, step))
        for j, kernel in enumerate(kernels):
            answer: Complexes = np.zeros(kernel.shape, complex)
            for i, other in enumerate(kernels):
                answer += _repeated(inverse[i, j], half, step) * other
            free, held = grid.image(kernel), grid.image(answer)
            taken += _over_cells(free * held, step)
            noise += _over_cells(held**2, step) / weights[j]
        variance = before - taken
        variances.append(variance)
        shares.append(np.clip(1 - noise / variance, 1e-6, 1.0))
    return np.array(variances), np.array(shares)


def _repeated(cells: Complexes, half: int, times: int) -> Complexes:
    """Return a filter on cells as a half plane of fine samples."""
    return np.tile(cells, (1, times))[np.arange(half) % len(cells)]


def _over_cells(kernel: AnyFloats, step: int) -> Floats:
    """Return the sum (step, step) of a kernel over its places in all cells."""
    rows, columns = (side // step for side in kernel.shape)
    return np.asarray(
        kernel.reshape(rows, step, columns, step).sum(axis=(0, 2), dtype=np.float64)
    )


def _spread_out(values: Floats, at: Floats, level: Floats, step: int) -> Floats32:
    """Return samples (components, rows, columns) of cells with a level each, by values (levels, components, step, step)."""
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
