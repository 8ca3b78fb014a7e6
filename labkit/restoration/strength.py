"""The strength of the penalty on roughness, lambda of thesis (4.41), by the discrepancy principle.

Trials solve the quadratic problem, without the bound, whose misfit needs the mosaic's grid alone: `Kriging`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.views import View, Views
from labkit.types import Floats

LONGEST_PX = 120.0  # period of waves, longer than which the pull to the mean decides
SMOOTH = 1.0  # cells, of counts that estimate their own variance
LEAST, MOST = -6.0, 4.0
"""Decades of the stiffness, about equal stiffness of penalty and data at PER_PX."""

PER_PX = 0.25  # cycles
EXACT, SCORE_STRIDE = 0.02, 0.25  # decades
LOOSE = 1e-2  # tolerance of equations that serve a trace


@dataclass(frozen=True, slots=True)
class Strength:
    """The strength of a penalty.

    Attributes
    ----------
    stiffness : factor of w^2, (radians a pixel)^2, in the misfit's second derivatives, for each pixel of scene:
        2 lambda / |f - mean|^2, the norm's square integrated over pixels
    chosen_by : name of the method
    """

    stiffness: float
    chosen_by: str


class Trial:
    """A part of the photograph, solved for any stiffness. power: as of `Stiffness`."""

    def __init__(
        self, views: Views, coupling: Floats, rng: np.random.Generator, power: float = 1.0
    ) -> None:
        self.views = views
        weights = [_weight(view) for view in views]
        self.levels = views.levels()
        self.apart = views.counts - views.flat(self.levels)
        self.signs = rng.choice([-1.0, 1.0], self.apart.shape)
        density = sum(float(np.mean(w)) for w in weights) / views.grid.period**2
        self.unit = density / (2 * np.pi * PER_PX) ** 2
        soft = 1 / views.grid.samples**2
        pull = soft * (2 * np.pi / LONGEST_PX) ** (2 * power)
        stiffness = Stiffness(views.grid, coupling, soft, pull, power)
        self.soft = Kriging(views, stiffness, weights)

    def sums(self, stiffness: float) -> tuple[float, float]:
        """Return squared residuals over their variance, and the number of counts that the scene does not follow."""
        kriging = self.soft.stiffer(stiffness)
        planes = kriging.solve(self.apart)
        signs = np.where(kriging.used, kriging.variance * self.signs, 0.0)
        left = float(np.sum(self.signs * kriging.solve(signs, tolerance=LOOSE)))
        return float(np.sum(kriging.variance * planes**2)), left

    def unlikely(self, stiffness: float) -> float:
        """Return minus the log-likelihood of the counts over all scenes whose spectrum the penalty is."""
        kriging = self.soft.stiffer(stiffness)
        squares = float(np.sum(self.apart * kriging.solve(self.apart, tolerance=LOOSE)))
        return 0.5 * (squares + kriging.log_determinant())

    def contrast_of_one(self) -> float:
        """Return variance over squared mean of scenes whose penalty has a stiffness of 1; it is inverse to the stiffness."""
        share = self.views.grid.share
        solid = self.soft.stiffness
        return max(
            float(np.sum(share * solid.between(c, c)) / max(level, 1.0) ** 2)
            for c, level in enumerate(self.levels)
        )


@dataclass(frozen=True)
class Choice:
    """A method to choose a strength: its name, and the decade of the stiffness by trials of parts and a unit."""

    name: str
    decade: Callable[[Sequence[Trial], float], float]


def choose(
    parts: Sequence[Views], coupling: Floats, how: Choice, rng: np.random.Generator
) -> Strength:
    """Choose the strength by parts of a photograph together. rng: draws signs to estimate a trace."""
    trials = [Trial(views, coupling, rng) for views in parts]
    unit = max(trial.unit for trial in trials)
    return Strength(unit * 10 ** how.decade(trials, unit), how.name)


def _discrepancy(trials: Sequence[Trial], unit: float) -> float:
    """Return the decade by the discrepancy principle, but no weaker strength than by cross-validation.

    Squared residuals over their variance sum to the number of counts less the scene's degrees of freedom, not to that
    number: with 15 unknowns a count the scene follows most of the noise. Several sharp frames of a scene with edges, or a
    lens that is not the photograph's, leave residuals that no strength explains.
    P. Hall and D. Titterington, J. R. Statist. Soc. B 49, 184 (1987).
    """

    def sums(decade: float) -> tuple[float, float]:
        squares, left = np.sum([t.sums(unit * 10**decade) for t in trials], axis=0)
        return float(squares), float(left)

    def excess(decade: float) -> float:
        squares, left = sums(decade)
        return squares - left

    low, high = -1.0, 0.0
    while excess(low) > 0 and low > LEAST:
        low, high = low - 1.0, low
    if high == 0.0:
        while excess(high) < 0 and high < MOST:
            low, high = high, high + 1.0
    while high - low > EXACT:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    start = decade = 0.5 * (low + high)
    data = sum(trial.views.data for trial in trials)
    here = np.inf
    while decade < MOST:
        squares, left = sums(decade)
        there = float(np.log(squares) - 2 * np.log(max(left, 1e-6 * data)))
        if there >= here:
            return max(decade - SCORE_STRIDE, start)
        decade = decade + SCORE_STRIDE
        here = there
    return decade


DISCREPANCY = Choice("discrepancy", _discrepancy)


def _weight(view: View) -> Floats:
    """Return the weights of counts by the variance of the smoothed counts."""
    share = ndimage.gaussian_filter(view.used.astype(float), SMOOTH)
    mean = ndimage.gaussian_filter(np.where(view.used, view.counts, 0.0), SMOOTH)
    return view.weight(np.maximum(mean / np.maximum(share, 1e-6), 0.0))
