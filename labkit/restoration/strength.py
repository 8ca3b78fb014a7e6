"""How strongly roughness is to be penalised: by the discrepancy principle, or by the L-curve (lambda of thesis 4.41).

Both look at the quadratic problem, without the bound, whose misfit needs the mosaic's grid alone: `Kriging`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.views import View, Views
from labkit.types import Floats

Choice = Literal["discrepancy", "l-curve"]

LONGEST_ROUGH_PX = 120.0  # period of waves that roughness alone decides on: longer ones are pulled to the mean
SMOOTHING_CELLS = 1.0  # cells, of counts that tell their own variance
LEAST_DECADE, MOST_DECADE = (
    -6.0,
    4.0,
)  # decades of the stiffness about that at which the penalty is as stiff as the data are at PER_PX
PER_PX = 0.25  # cycles
EXACT, DECADE_STRIDE = 0.02, 0.25  # decades
BENDS = 41  # points of an L-curve
LOOSE = 1e-2  # of the equations that only a trace comes from


@dataclass(frozen=True, slots=True)
class Strength:
    """A penalty's. stiffness: what w^2, (radians a pixel)^2, is multiplied by in the misfit's second derivatives, for each
    pixel of scene: 2 lambda / |f - mean|^2, the norm's square integrated over pixels. chosen_by: how."""

    stiffness: float
    chosen_by: str


def choose(
    parts: Sequence[Views], coupling: Floats, how: Choice, rng: np.random.Generator
) -> Strength:
    """The strength that parts of a photograph call for together. rng: draws the signs that a trace is estimated with.

    "discrepancy": squared residuals over their variance sum to the number of counts less what the scene takes up of them
    (P. Hall and D. Titterington, J. R. Statist. Soc. B 49, 184 (1987)), not to that number: with 15 unknowns a count the scene
    follows most of the noise. Never weaker than cross-validation has it: several sharp frames of a scene with edges, or a lens
    that is not the photograph's, leave residuals that no strength explains. "l-curve": where misfit against roughness, both
    logarithmic, bends most among strengths that leave a tenth to ten times the noise.
    """
    trials = [Trial(views, coupling, rng) for views in parts]
    unit = max(trial.unit for trial in trials)
    if how == "discrepancy":
        excess = _excess_of(trials, unit)
        low, high = _bracket(excess)
        while high - low > EXACT:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle) < 0 else (low, middle)
        return Strength(
            unit * 10 ** _cross_validated(trials, unit, 0.5 * (low + high)), how
        )
    decades = np.linspace(LEAST_DECADE, MOST_DECADE, BENDS)
    points = np.array(
        [np.sum([trial.corner(unit * 10**d) for trial in trials], axis=0) for d in decades]
    )
    likely = np.abs(np.log10(points[:, 0] / sum(trial.views.data for trial in trials))) < 1
    decade = (
        decades[likely][_bend(np.log(points[likely]))]
        if likely.sum() > 4
        else decades[BENDS // 2]
    )
    return Strength(unit * 10 ** float(decade), how)


def _cross_validated(trials: Sequence[Trial], unit: float, from_decade: float) -> float:
    """The decade from there on, up the strengths, to where the score rises."""
    data, decade, here = sum(trial.views.data for trial in trials), from_decade, np.inf
    while decade < MOST_DECADE:
        squares, left = np.sum([trial.sums(unit * 10**decade) for trial in trials], axis=0)
        there = float(np.log(squares) - 2 * np.log(max(left, 1e-6 * data)))
        if there >= here:
            return max(decade - DECADE_STRIDE, from_decade)
        decade, here = decade + DECADE_STRIDE, there
    return decade


def _excess_of(trials: Sequence[Trial], unit: float) -> Callable[[float], float]:
    def excess(decade: float) -> float:
        return sum(trial.excess(unit * 10**decade) for trial in trials)

    return excess


def _bracket(excess: Callable[[float], float]) -> tuple[float, float]:
    """Decades between which the excess changes sign, or the end of the range that it points to."""
    low, high = -1.0, 0.0
    while excess(low) > 0 and low > LEAST_DECADE:
        low, high = low - 1.0, low
    if high == 0.0:
        while excess(high) < 0 and high < MOST_DECADE:
            low, high = high, high + 1.0
    return low, high


def _bend(points: Floats) -> int:
    """Where a curve (n, 2) bends most to the left, as an L does.

    P. Hansen and D. O'Leary, SIAM J. Sci. Comput. 14, 1487 (1993).
    """
    x, y = points.T
    dx, dy = np.gradient(x), np.gradient(y)
    ddx, ddy = np.gradient(dx), np.gradient(dy)
    bent = (dx * ddy - ddx * dy) / (dx**2 + dy**2) ** 1.5
    return int(np.argmax(bent[1:-1])) + 1


class Trial:
    """One part of the photograph, solved for any stiffness. power: as `Stiffness` has it."""

    def __init__(
        self, views: Views, coupling: Floats, rng: np.random.Generator, power: float = 1.0
    ) -> None:
        self.views = views
        self.weights = [_weight(view) for view in views]
        self.levels = views.levels()
        self.apart = views.counts - views.flat(self.levels)
        self.signs = rng.choice([-1.0, 1.0], self.apart.shape)
        density = sum(float(np.mean(w)) for w in self.weights) / views.grid.period**2
        self.unit = density / (2 * np.pi * PER_PX) ** 2
        soft = 1 / views.grid.samples**2
        pull = soft * (2 * np.pi / LONGEST_ROUGH_PX) ** (2 * power)
        self.soft = Kriging(
            views, Stiffness(views.grid, coupling, soft, pull, power), self.weights
        )

    def kriging(self, stiffness: float) -> Kriging:
        return self.soft.stiffer(stiffness)

    def excess(self, stiffness: float) -> float:
        """Of the squared residuals over what they should sum to."""
        squares, left = self.sums(stiffness)
        return squares - left

    def sums(self, stiffness: float) -> tuple[float, float]:
        """Squared residuals over their variance, and how many counts the scene does not take up."""
        kriging = self.kriging(stiffness)
        planes = kriging.solve(self.apart)
        signs = np.where(kriging.used, kriging.variance * self.signs, 0.0)
        left = float(np.sum(self.signs * kriging.solve(signs, tolerance=LOOSE)))
        return float(np.sum(kriging.variance * planes**2)), left

    def unlikely(self, stiffness: float) -> float:
        """Minus the log-likelihood of the counts, but for a constant, over all scenes that the penalty is the spectrum of."""
        kriging = self.kriging(stiffness)
        squares = float(np.sum(self.apart * kriging.solve(self.apart, tolerance=LOOSE)))
        return 0.5 * (squares + kriging.log_determinant())

    def contrast_of_one(self) -> float:
        """Variance over squared mean of scenes whose penalty has a stiffness of 1: inversely as much of another."""
        grid, levels = self.views.grid, np.maximum(self.levels, 1.0)
        between = [self.soft.stiffness.between(c, c) for c in range(self.views.components)]
        return max(
            float(np.sum(grid.share * b) / level**2)
            for b, level in zip(between, levels, strict=True)
        )

    def corner(self, stiffness: float) -> tuple[float, float]:
        """Squared residuals, and roughness: f^T K f is that of the planes by way of the scene."""
        kriging = self.kriging(stiffness)
        planes = kriging.solve(self.apart)
        rough = float(np.sum(planes * kriging.data_part(planes))) / stiffness
        return float(np.sum(kriging.variance * planes**2)), rough


def _weight(view: View) -> Floats:
    """Of counts by the smoothed counts' own variance."""
    share = ndimage.gaussian_filter(view.used.astype(float), SMOOTHING_CELLS)
    mean = ndimage.gaussian_filter(
        np.where(view.used, view.counts, 0.0), SMOOTHING_CELLS
    ) / np.maximum(share, 1e-6)
    return view.weight(np.maximum(mean, 0.0))
