"""The scene of least penalised misfit, none of it below 0 (thesis 4.41).

Newton's steps: the misfit's curvature averaged over the noise (Fisher's), the penalty's exact slope. Each step's quadratic
problem under f >= 0 is solved by splitting (S. Boyd et al., Found. Trends Mach. Learn. 3, 1 (2011), §5.2): in turn the scene
that the data and a pull to a scene without negative samples call for, by `Kriging`, and the nearest such scene to it.
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

MOST_SOLVER_STEPS, MOST_TURNS = 12, 15
PULL = 0.02  # of the data's curvature, for what is constant
OVER = 1.6  # relaxation: between 1.5 and 1.8 is usual
SAME_NORM = 0.01  # relative: lambda need be no more exact
SETTLED = 0.05  # of a Newton step, RMS: the splitting's own error
DECREASE = 3e-3  # of the misfit, for each count: a restored sample is then within a few hundredths of its standard error


@dataclass(frozen=True, eq=False)
class Start:
    """A scene to begin with, and the multiplier of its bound: (components, rows, columns)."""

    scene: Floats32
    multiplier: Floats32


@dataclass(frozen=True, eq=False)
class Restored:
    """scene: (components, rows, columns) fine samples of all the torus, counts above black; means: of each plane; norm: of
    the scene; objective: penalised misfit; steps, turns: Newton's, and the splitting's in all; multiplier: the splitting's."""

    scene: Floats32
    multiplier: Floats32
    means: tuple[Floats, ...]
    norm: Norm
    objective: float
    steps: int
    turns: int

    def finer(self, grid: SceneGrid, samples: int) -> Start:
        """To begin with on a grid of more samples to a pixel; this one's grid is given."""
        return Start(grid.finer(self.scene, samples), grid.finer(self.multiplier, samples))


@dataclass(frozen=True, eq=False)
class Point:
    """A scene, what it looks like, and the penalised misfit there."""

    scene: Floats32
    spectra: AnyComplexes
    means: list[Floats]
    value: float

    @classmethod
    def of(cls, views: Views, penalty: Roughness, scene: Floats32) -> Point:
        """At a scene."""
        spectra = views.grid.spectrum(scene)
        means = views.means(spectra)
        return cls(
            scene, spectra, means, views.misfit(means) + penalty.value(scene, spectra)
        )

    def gradient(self, views: Views, penalty: Roughness) -> AnyFloats:
        """(components, rows, columns) of the penalised misfit."""
        rough, beside = penalty.gradient(self.scene, self.spectra)
        return views.grid.image(views.spread(views.slopes(self.means)) + rough) + beside

    def curvature(self, views: Views, penalty: Roughness, step: AnyFloats) -> AnyFloats:
        """Its second derivatives, Fisher's, times a step."""
        spectra = views.grid.spectrum(step)
        seen = [
            w * moved
            for w, moved in zip(
                views.weights(self.means), views.means(spectra), strict=True
            )
        ]
        rough, beside = penalty.curvature(self.scene, self.spectra, step, spectra)
        return views.grid.image(views.spread(seen) + rough) + beside


def restore(
    views: Views,
    penalty: Roughness,
    start: Start | None = None,
    progress: Callable[[int, float], None] = lambda step, decrease: None,
) -> Restored:
    """The scene of least penalised misfit. start: by default made of the data; from a
    coarser grid's scene it is one Newton step.

    progress: called with the number of each Newton step and what it gained, log-likelihood for each count.
    """
    levels, norm = guessed_norm(views, penalty)
    flat = [view.light * levels[view.component] for view in views]
    solver = Solver(views, penalty, norm, flat)
    if start is None:
        begin = solver.first(levels)
    else:
        begin, solver.multiplier = start.scene, start.multiplier
    point = Point.of(views, penalty, np.maximum(begin, 0))
    steps = 0
    for steps in range(1, MOST_SOLVER_STEPS + 1 if start is None else 2):
        moved = _searched(views, penalty, point, solver.step(point))
        gained = point.value - moved.value
        point = moved
        progress(steps, gained / views.data)
        if gained < DECREASE * views.data:
            break
    norm = penalty.norm(point.scene, point.spectra)
    return Restored(
        point.scene,
        solver.multiplier,
        tuple(point.means),
        norm,
        point.value,
        steps,
        solver.turns,
    )


class Solver:
    """The quadratic problems of Newton's steps, each begun where the last one ended."""

    def __init__(
        self, views: Views, penalty: Roughness, norm: Norm, means: list[Floats]
    ) -> None:
        self.views, self.penalty, self.grid = views, penalty, views.grid
        cell = self.grid.cells.oversampling**2
        weights = views.weights(means)
        self.pull = (
            PULL
            * sum(float(np.median(w[w > 0])) for w in weights)
            / cell
            / views.components
        )
        self.kriging = self._kriging(norm, weights)
        self.multiplier: Floats32 = np.zeros(
            (views.components, *self.grid.shape), np.float32
        )
        self.planes: Floats | None = None
        self.turns = 0

    def first(self, levels: Floats) -> Floats32:
        """The scene near one that is constant, levels (components,)."""
        means = [view.light * levels[view.component] for view in self.views]
        apart = np.array(
            [view.counts - mean for view, mean in zip(self.views, means, strict=True)]
        )
        scene = self.grid.image(self.kriging.scene(self.kriging.solve(apart)))
        return np.asarray(scene + levels.astype(np.float32)[:, None, None], np.float32)

    def _kriging(self, norm: Norm, weights: list[Floats]) -> Kriging:
        stiffness = Stiffness(
            self.grid, self.penalty.coupling, self.penalty.stiffness(norm), self.pull
        )
        return Kriging(self.views, stiffness, weights)

    def step(self, point: Point) -> Floats32:
        """Where the quadratic problem at a point has its least, about."""
        weights, norm = (
            self.views.weights(point.means),
            self.penalty.norm(point.scene, point.spectra),
        )
        if abs(self.penalty.stiffness(norm) / self.kriging.stiffness.rough - 1) > SAME_NORM:
            self.kriging = self._kriging(norm, weights)
        else:
            self.kriging.weigh(weights)
        slopes = self.views.slopes(point.means)
        data = np.array(
            [
                mean - slope / np.where(weight > 0, weight, 1.0)
                for mean, slope, weight in zip(point.means, slopes, weights, strict=True)
            ]
        )
        _, beside = self.penalty.gradient(point.scene, point.spectra)
        kept, multiplier = point.scene, self.multiplier
        pull = np.float32(self.pull)
        for _ in range(MOST_TURNS):
            called = self.grid.spectrum(pull * (kept - multiplier) - beside)
            free = self.kriging.stiffness.inverse(called)
            self.planes = self.kriging.solve(
                data - np.array(self.views.means(free)), self.planes
            )
            scene = self.grid.image(free + self.kriging.scene(self.planes))
            relaxed = np.float32(OVER) * scene + np.float32(1 - OVER) * kept
            before, kept = kept, np.maximum(relaxed + multiplier, 0)
            multiplier = multiplier + relaxed - kept
            self.turns += 1
            far = _rms(kept - point.scene)
            if max(_rms(kept - before), _rms(scene - kept)) < SETTLED * far:
                break
        self.multiplier = multiplier
        return kept


def guessed_norm(views: Views, penalty: Roughness) -> tuple[Floats, Norm]:
    """Levels of the scene's components, and its norm as the blurred pictures have it, noise taken off."""
    levels, squares = views.levels(), np.zeros(views.components)
    planes = np.bincount([view.component for view in views], minlength=views.components)
    for view in views:
        counts, mean = (
            view.counts[view.used],
            (view.light * levels[view.component])[view.used],
        )
        noise = float(np.mean(view.expected(mean).variance))
        apart = max(float(np.mean((counts - mean) ** 2)) - noise, 0.01 * noise)
        squares[view.component] += apart / planes[view.component]
    if penalty.held is not None:
        return levels, penalty.held
    sizes, pixels = np.sqrt(squares), float(penalty.seen.sum()) / views.grid.samples**2
    return levels, Norm(pixels * float(sizes @ penalty.coupling @ sizes), levels, 0.0)


def _searched(views: Views, penalty: Roughness, point: Point, end: Floats32) -> Point:
    """The farthest of ever shorter steps to a scene that gains; the point itself where none does."""
    for halvings in range(7):
        scene = point.scene + np.float32(0.5**halvings) * (end - point.scene)
        there = Point.of(views, penalty, scene)
        if there.value < point.value:
            return there
    return point


def _rms(values: AnyFloats) -> float:
    return float(np.sqrt(np.mean(values * values, dtype=np.float64)))
