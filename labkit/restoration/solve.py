"""The scene of least penalised misfit, nowhere below 0 (thesis 4.41).

Newton's steps: the misfit's curvature averaged over the noise (Fisher's), the penalty's exact slope. Each step's quadratic
problem under f >= 0 is solved by splitting (S. Boyd et al., Found. Trends Mach. Learn. 3, 1 (2011), §5.2): in turn the scene
by the data and a pull to a scene without negative samples, by `Kriging`, and the nearest such scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labkit.restoration.grid import SceneGrid
from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.roughness import Norm, Roughness
from labkit.restoration.views import Views
from labkit.types import AnyComplexes, AnyFloats, Floats, Floats32

MOST_STEPS = 12
MOST_TURNS = 8
TURN_TOLERANCE = 3e-3  # of a turn's equations, which begin at the last turn's solution
MOST_HALVINGS = 7
PULL = 0.02  # of the data's curvature for an even scene
OVER = 1.6  # relaxation: between 1.5 and 1.8 is usual
SAME_NORM = 0.01  # relative: lambda need not be more exact
SETTLED = 0.05  # of a Newton step, RMS: the splitting's own error
DECREASE = 3e-3  # of the misfit, for each count: a sample is then within a few hundredths of its standard error


@dataclass(frozen=True, eq=False)
class Start:
    """A scene to begin with, and the multiplier of its bound: (components, rows, columns)."""

    scene: Floats32
    multiplier: Floats32


@dataclass(frozen=True, eq=False)
class Restored:
    """A restored scene.

    Attributes
    ----------
    scene : (components, rows, columns) fine samples of the torus, counts above black
    multiplier : of its bound
    means : (views, rows, columns) mean counts
    norm : of the scene
    """

    scene: Floats32
    multiplier: Floats32
    means: Floats
    norm: Norm

    def finer(self, grid: SceneGrid, samples: int) -> Start:
        """Return a start on a grid of more samples a pixel. grid: this one's."""
        return Start(grid.finer(self.scene, samples), grid.finer(self.multiplier, samples))


@dataclass(frozen=True, eq=False)
class Point:
    """A scene, its spectra and mean counts, and the penalised misfit."""

    scene: Floats32
    spectra: AnyComplexes
    means: Floats
    value: float

    @classmethod
    def of(cls, views: Views, penalty: Roughness, scene: Floats32) -> Point:
        """Return the point of a scene."""
        spectra = views.grid.spectrum(scene)
        means = views.means(spectra)
        value = views.misfit(means) + penalty.value(scene, spectra)
        return cls(scene, spectra, means, value)

    def gradient(self, views: Views, penalty: Roughness) -> AnyFloats:
        """Return the gradient (components, rows, columns) of the penalised misfit."""
        rough, beside = penalty.gradient(self.scene, self.spectra)
        return views.grid.image(views.spread(views.slopes(self.means)) + rough) + beside

    def curvature(self, views: Views, penalty: Roughness, step: AnyFloats) -> AnyFloats:
        """Return the misfit's second derivatives, Fisher's, times a step."""
        spectra = views.grid.spectrum(step)
        seen = views.weights(self.means) * views.means(spectra)
        rough, beside = penalty.curvature(self.scene, self.spectra, step, spectra)
        return views.grid.image(views.spread(seen) + rough) + beside


def restore(
    views: Views,
    penalty: Roughness,
    start: Start | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Restored:
    """Return the scene of least penalised misfit.

    Parameters
    ----------
    views : the data
    penalty : of the scene's roughness
    start : by default made of the data; one Newton step follows a coarser grid's scene
    progress : called after each Newton step
    """
    levels, norm = guessed_norm(views, penalty)
    solver = Solver(views, penalty, norm, views.flat(levels))
    if start is None:
        begin = solver.first(levels)
    else:
        begin = start.scene
        solver.multiplier = start.multiplier
    point = Point.of(views, penalty, np.maximum(begin, 0))
    for _ in range(MOST_STEPS if start is None else 1):
        before = point
        end = solver.step(point)
        for halvings in range(MOST_HALVINGS):
            scene = before.scene + np.float32(0.5**halvings) * (end - before.scene)
            point = Point.of(views, penalty, scene)
            if point.value < before.value:
                break
        else:
            point = before
        progress()
        if before.value - point.value < DECREASE * views.data:
            break
    norm = penalty.norm(point.scene, point.spectra)
    return Restored(point.scene, solver.multiplier, point.means, norm)


class Solver:
    """The quadratic problems of Newton's steps, each begun where the last one ended."""

    def __init__(self, views: Views, penalty: Roughness, norm: Norm, means: Floats) -> None:
        self.views, self.penalty, self.grid = views, penalty, views.grid
        weights = views.weights(means)
        typical = sum(float(np.median(w[w > 0])) for w in weights)
        self.pull = PULL * typical / self.grid.cells.oversampling**2 / views.components
        self.kriging = self._kriging(norm, weights)
        shape = views.components, *self.grid.shape
        self.multiplier: Floats32 = np.zeros(shape, np.float32)
        self.planes: Floats | None = None

    def first(self, levels: Floats) -> Floats32:
        """Return the scene near an even one, levels (components,)."""
        apart = self.views.counts - self.views.flat(levels)
        scene = self.grid.image(self.kriging.scene(self.kriging.solve(apart)))
        return np.asarray(scene + levels.astype(np.float32)[:, None, None], np.float32)

    def _kriging(self, norm: Norm, weights: Floats) -> Kriging:
        rough = self.penalty.stiffness(norm)
        stiffness = Stiffness(self.grid, self.penalty.coupling, rough, self.pull)
        return Kriging(self.views, stiffness, weights)

    def step(self, point: Point) -> Floats32:
        """Return the approximate minimum of the quadratic problem at a point."""
        weights = self.views.weights(point.means)
        norm = self.penalty.norm(point.scene, point.spectra)
        if abs(self.penalty.stiffness(norm) / self.kriging.stiffness.rough - 1) > SAME_NORM:
            self.kriging = self._kriging(norm, weights)
        else:
            self.kriging.weigh(weights)
        slopes = self.views.slopes(point.means)
        data = point.means - slopes / np.where(weights > 0, weights, 1.0)
        _, beside = self.penalty.gradient(point.scene, point.spectra)
        kept = point.scene
        multiplier = self.multiplier
        pull = np.float32(self.pull)
        for _ in range(MOST_TURNS):
            called = self.grid.spectrum(pull * (kept - multiplier) - beside)
            free = self.kriging.stiffness.inverse(called)
            left = data - self.views.means(free)
            self.planes = self.kriging.solve(left, self.planes, TURN_TOLERANCE)
            scene = self.grid.image(free + self.kriging.scene(self.planes))
            relaxed = np.float32(OVER) * scene + np.float32(1 - OVER) * kept
            before = kept
            kept = np.maximum(relaxed + multiplier, 0)
            multiplier = multiplier + relaxed - kept
            far = _rms(kept - point.scene)
            if max(_rms(kept - before), _rms(scene - kept)) < SETTLED * far:
                break
        self.multiplier = multiplier
        return kept


def guessed_norm(views: Views, penalty: Roughness) -> tuple[Floats, Norm]:
    """Return levels of the scene's components, and its norm by the blurred pictures without their noise."""
    levels = views.levels()
    squares = np.zeros(views.components)
    if penalty.held is not None:
        return levels, penalty.held
    planes = np.bincount([view.component for view in views], minlength=views.components)
    for view, flat in zip(views, views.flat(levels), strict=True):
        counts = view.counts[view.used]
        mean = flat[view.used]
        noise = float(np.mean(view.expected(mean).variance))
        apart = max(float(np.mean((counts - mean) ** 2)) - noise, 0.01 * noise)
        squares[view.component] += apart / planes[view.component]
    sizes = np.sqrt(squares)
    pixels = float(penalty.seen.sum()) / views.grid.samples**2
    return levels, Norm(pixels * float(sizes @ penalty.coupling @ sizes), levels, 0.0)


def _rms(values: AnyFloats) -> float:
    return float(np.sqrt(np.mean(values * values, dtype=np.float64)))
