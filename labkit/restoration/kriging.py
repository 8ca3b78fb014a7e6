"""Scenes by the data's own equations: as many as there are counts, on the mosaic's grid, whatever the scene's.

A penalty K, quadratic, and weights W make the normal equations (K + H^T W H) f = H^T W d. By Woodbury's formula they are
solved by (W^-1 + H K^-1 H^T) u = d - H f0: K^-1 is diagonal in frequency and H K^-1 H^T a few convolutions from plane to
plane of the mosaic, so that a step costs no transform of the fine grid. Masked counts are left out, not weighed by 0. It is
kriging, with the penalty as the scene's covariance (G. Wahba, Spline models for observational data, SIAM 1990, ch. 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
import scipy.fft

from labkit.restoration.grid import SceneGrid
from labkit.restoration.views import Views
from labkit.types import AnyComplexes, AnyFloats, Complexes, Floats, Floats32

GRADIENT_TOLERANCE, MOST_GRADIENT_STEPS = 1e-3, 400  # of conjugate gradients


@dataclass(frozen=True, eq=False)
class Stiffness:
    """A quadratic penalty, half of f^T (rough M Q + pull) f, diagonal in frequency.

    coupling: M, (components, components). rough: what w^2, (radians a pixel)^2, is multiplied by; pull: to where the
    scene is, so that nothing is without a penalty. power: of w^2, 1 in (K.11). Raises ValueError unless both are above 0.
    """

    grid: SceneGrid
    coupling: Floats
    rough: float
    pull: float
    power: float = 1.0
    turn: Floats = field(init=False, repr=False)
    give: Floats = field(init=False, repr=False)
    _give: Floats32 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (self.rough > 0 and self.pull > 0):
            raise ValueError(
                f"rough {self.rough:g}, pull {self.pull:g}: numbers above 0 are needed"
            )
        weights, turn = np.linalg.eigh(self.coupling)
        squared = self.grid.squared_frequency.astype(np.float64) ** self.power
        give = np.array(
            [1 / (self.rough * weight * squared + self.pull) for weight in weights]
        )
        object.__setattr__(self, "turn", turn)
        object.__setattr__(self, "give", give)
        object.__setattr__(self, "_give", give.astype(np.float32))

    def inverse(self, spectra: AnyComplexes) -> AnyComplexes:
        """Return K^-1 of half planes (components, half, columns)."""
        if len(spectra) == 1:
            return self._give * spectra
        own = np.tensordot(self.turn.T.astype(np.float32), spectra, 1)
        own *= self._give
        return np.tensordot(self.turn.astype(np.float32), own, 1)

    def between(self, one: int, other: int) -> Floats:
        """Return the half plane by which light in one colour moves the scene in another."""
        return np.asarray(np.tensordot(self.turn[one] * self.turn[other], self.give, 1))


class Kriging:
    """The scene of a quadratic penalty, given data with noise: `weights` (rows, columns) of each view's, 0 where not used."""

    def __init__(
        self, views: Views, stiffness: Stiffness, weights: Sequence[Floats] | Floats
    ) -> None:
        self.views, self.stiffness, self.grid = views, stiffness, views.grid
        self._between = self._kernels()
        self.weigh(weights)

    def weigh(self, weights: Sequence[Floats] | Floats) -> None:
        """Use other weights."""
        self.used = np.array(weights) > 0
        self.variance = 1 / np.where(self.used, weights, 1.0)
        self._invert()

    def _invert(self) -> None:
        """Invert `apply` for all counts used and equally good."""
        blocks = self._blocks()
        inverse = np.linalg.inv(blocks) if blocks.shape[-1] > 1 else 1 / blocks
        self.nearly: Complexes = np.asarray(np.moveaxis(inverse, (2, 3), (0, 1)), complex)
        # single precision is enough for conjugate gradients, and takes half the time
        self._roughly = self.nearly.astype(np.complex64)
        self._applied = self._between.astype(np.complex64)

    def _blocks(self) -> Complexes:
        """Return (rows, columns // 2 + 1, views, views) of `apply` by frequency, all counts as good as the median."""
        between = np.moveaxis(self._between, (0, 1), (2, 3))
        return np.asarray(between + np.diag(self._typical()))

    def _typical(self) -> Floats:
        """Return the median variance of each view."""
        pairs = zip(self.variance, self.used, strict=True)
        return np.array([np.median(variance[used]) for variance, used in pairs])

    def log_determinant(self) -> float:
        """Return the log determinant of `apply` over that of the variances, by its mean over frequencies."""
        logs, columns = np.linalg.slogdet(self._blocks())[1], self.grid.cells.pixels[1]
        edge = (np.arange(logs.shape[1]) * 2) % columns == 0
        twice = np.where(edge, 1.0, 2.0)  # half a plane stands for all of it
        mean = float(np.sum(twice * logs) / (twice.sum() * len(logs)))
        mean -= float(np.sum(np.log(self._typical())))
        return mean * float(self.used.sum()) / len(self.views)

    def stiffer(self, factor: float) -> Kriging:
        """Return the equations of a penalty so many times as stiff; `scene` is still that of this one."""
        other = copy(self)
        other._between = self._between / factor
        other._invert()
        return other

    def solve(
        self,
        data: Floats,
        start: Floats | None = None,
        tolerance: float = GRADIENT_TOLERANCE,
    ) -> Floats:
        """Solve (W^-1 + H K^-1 H^T) u = data for u (views, rows, columns), 0 at unused counts, by conjugate gradients."""
        solution = np.zeros_like(data) if start is None else start.copy()
        wanted = np.where(self.used, data, 0.0)
        rest = wanted if start is None else wanted - self.apply(solution)
        enough = tolerance**2 * float(np.sum(wanted * wanted))
        near = self._nearly(rest)
        direction, product = near, float(np.sum(rest * near))
        for _ in range(MOST_GRADIENT_STEPS):
            if not (product > 0 and np.sum(rest * rest) > enough):
                break
            image = self.apply(direction)
            length = product / float(np.sum(direction * image))
            solution += length * direction
            rest = rest - length * image
            near = self._nearly(rest)
            before, product = product, float(np.sum(rest * near))
            direction = near + product / before * direction
        return solution

    def apply(self, planes: Floats) -> Floats:
        """Return (W^-1 + H K^-1 H^T) of planes (views, rows, columns)."""
        return np.where(self.used, self.variance * planes, 0.0) + self.data_part(planes)

    def data_part(self, planes: Floats) -> Floats:
        """Return H K^-1 H^T of planes, at used counts."""
        return np.where(
            self.used,
            self.views.light * self._convolved(self._applied, self.views.light * planes),
            0.0,
        )

    def scene(self, planes: Floats) -> AnyComplexes:
        """Return half planes of K^-1 H^T u."""
        return self.stiffness.inverse(self.views.spread(planes))

    def _kernels(self) -> Complexes:
        """Return the DFT (views, views, rows, columns // 2 + 1) of the effect of one plane's light on another, on the cells'
        torus.
        """
        count, (rows, columns) = len(self.views), self.grid.cells.pixels
        between = np.zeros((count, count, rows, columns // 2 + 1), complex)
        for i, one in enumerate(self.views):
            for j, other in enumerate(self.views.views[: i + 1]):
                give = self.stiffness.between(one.component, other.component)
                moved = give * np.conj(one.transfer) * other.transfer
                between[j, i] = self.grid.kernel(moved)
                between[i, j] = np.conj(between[j, i])
        return between

    def _nearly(self, planes: Floats) -> Floats:
        """Return the inverse of `apply` for all counts used and equally good."""
        return np.where(self.used, self._convolved(self._roughly, planes), 0.0)

    def _convolved(self, kernels: AnyComplexes, planes: Floats) -> AnyFloats:
        """Return planes convolved with kernels, in the precision of the kernels."""
        cells = np.zeros((len(planes), *self.grid.cells.pixels), kernels.real.dtype)
        cells[:, *self.grid.at_frame] = planes
        spectra = scipy.fft.rfft2(cells)
        mixed = (
            kernels[0] * spectra
            if len(planes) == 1
            else np.einsum("ijrc,jrc->irc", kernels, spectra)
        )
        return np.asarray(
            scipy.fft.irfft2(mixed, s=self.grid.cells.pixels)[:, *self.grid.at_frame]
        )
