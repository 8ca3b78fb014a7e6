"""The roughness of a scene, independent of its scale and level, with its derivatives (thesis, Appendix K)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from labkit.restoration.grid import SceneGrid
from labkit.types import AnyComplexes, AnyFloats, Bools, Floats, Floats32

ONE = np.float32(1)


@dataclass(frozen=True, slots=True)
class Norm:
    """A scene's, over what is seen of it. square: squares about the means, integrated over pixels; means: (components,);
    roughness: (K.11), its mean squared frequency, (radians a pixel)^2."""

    square: float
    means: Floats
    roughness: float


@dataclass(frozen=True, eq=False)
class Roughness:
    """strength times R(f) = f^T Q f / |f - mean|^2: (K.11) with no reference image; Q weighs frequencies by w^2.

    The mean and the norm are taken over the frame. Over all of the torus, as printed, a smooth swelling where no data
    contradict it, beyond the frame or where all is clipped, would make the norm larger and R less without end.
    strength: lambda; frequencies in radians a pixel. coupling: (components, components) by which colours' roughness is
    weighed, the inverse of their covariance in scenes. held: the norm of a larger scene that this is a tile of: then the
    penalty is the quadratic form that has the same gradient where all tiles' scenes together have that norm.
    """

    grid: SceneGrid
    seen: Bools
    strength: float
    coupling: Floats = field(default_factory=lambda: np.eye(1))
    held: Norm | None = None

    def norm(self, scene: AnyFloats, spectra: AnyComplexes) -> Norm:
        """Return the norm of a scene (components, rows, columns), with its half planes given."""
        means = scene[:, self.seen].mean(axis=1, dtype=np.float64)
        apart = self._apart(scene, means)
        square = self._area * float(np.sum(apart * self._coupled(apart), dtype=np.float64))
        return Norm(square, means, self._rough(spectra) / max(square, np.finfo(float).tiny))

    def value(self, scene: AnyFloats, spectra: AnyComplexes) -> float:
        """Return the value of the penalty. Thesis (K.11)."""
        if self.held is None:
            return self.strength * self.norm(scene, spectra).roughness
        apart = self._apart(scene, self.held.means)
        square = self._area * float(np.sum(apart * self._coupled(apart), dtype=np.float64))
        return (
            self.strength
            / self.held.square
            * (self._rough(spectra) - self.held.roughness * square)
        )

    def gradient(
        self, scene: AnyFloats, spectra: AnyComplexes
    ) -> tuple[AnyComplexes, AnyFloats]:
        """Return the gradient, thesis (K.19), in two parts: half planes, and an addition to their scene."""
        norm = self.held or self.norm(scene, spectra)
        factor = np.float32(self.stiffness(norm))
        return self._weighed(spectra, factor), -factor * np.float32(
            norm.roughness
        ) * self._coupled(self._apart(scene, norm.means))

    def curvature(
        self,
        scene: AnyFloats,
        spectra: AnyComplexes,
        step: AnyFloats,
        step_spectra: AnyComplexes,
    ) -> tuple[AnyComplexes, AnyFloats]:
        """Return the second derivatives times a step (components, rows, columns), in the two parts of `gradient`."""
        norm = self.held or self.norm(scene, spectra)
        factor = self.stiffness(norm)
        rough = self._weighed(step_spectra)
        if self.held is not None:
            apart = self._apart(step, np.zeros(len(step)))
            return self._weighed(step_spectra, np.float32(factor)), np.float32(
                -factor * norm.roughness
            ) * self._coupled(apart)
        here = self._coupled(self._apart(scene, norm.means))
        moved = self._coupled(
            self._apart(step, step[:, self.seen].mean(axis=1, dtype=np.float64))
        )
        square_by = (
            2 * self._area * float(np.sum(here * step, dtype=np.float64))
        )  # the norm's square along the step
        rough_by = (
            2
            * self._area
            * float(
                np.sum(
                    self.grid.share * np.real(np.conj(spectra) * rough), dtype=np.float64
                )
            )
        )
        share = np.float32(square_by / norm.square)
        by_norm = (2 * norm.roughness * square_by - rough_by) / norm.square
        spectral = self._weighed(
            np.asarray(step_spectra - share * spectra), np.float32(factor)
        )
        return spectral, np.float32(factor) * (
            np.float32(by_norm) * here - np.float32(norm.roughness) * moved
        )

    def stiffness(self, norm: Norm) -> float:
        """Return the factor of w^2 in a sample's second derivatives without the norm's: 2 lambda / |f -
        mean|^2.
        """
        return 2 * self.strength / (self.held or norm).square * self._area

    @property
    def _area(self) -> float:
        """Area of a fine sample, in pixels squared."""
        return 1 / self.grid.samples**2

    def _apart(self, scene: AnyFloats, means: Floats) -> AnyFloats:
        """Return seen samples less their means, the others 0."""
        return np.asarray(
            np.where(
                self.seen,
                scene - means.astype(scene.dtype)[:, None, None],
                scene.dtype.type(0),
            )
        )

    def _coupled(self, of_components: AnyFloats) -> AnyFloats:
        if len(of_components) == 1:
            return of_components * of_components.dtype.type(self.coupling[0, 0])
        return np.tensordot(self.coupling.astype(of_components.dtype), of_components, 1)

    def _weighed(self, spectra: AnyComplexes, factor: np.float32 = ONE) -> AnyComplexes:
        """Return M Q f, times a factor."""
        coupled = (
            np.tensordot(self.coupling.astype(np.float32), spectra, 1)
            if len(spectra) > 1
            else spectra
        )
        scale = np.float32(self.coupling[0, 0] if len(spectra) == 1 else 1.0)
        return coupled * (factor * scale * self.grid.squared_frequency)

    def _rough(self, spectra: AnyComplexes) -> float:
        """Return f^T M Q f."""
        weighed: Floats32 = np.real(np.conj(spectra) * self._weighed(spectra))
        return self._area * float(np.sum(self.grid.share * weighed, dtype=np.float64))
