"""Least squares over the observations of a session, eliminated group by group (Schur complement).

No array here is larger than observations x values x columns: the normal equations of n observations with p common columns
cost n p^2. Levenberg (1944), Marquardt (1963); the elimination: physics of a session over keys.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labkit.estimation.lens_model import LensModel
from labkit.types import Bools, Floats

MOST_STEPS = 50
SETTLED = 1e-4  # standard errors: a step shorter than this ends a climb
STIFF = 1e12  # factor of a column's information by which it is held where it is


@dataclass(frozen=True)
class Data:
    """What the observations measured.

    Attributes
    ----------
    values : (n, values)
    precision : (n, values, values) inverse covariances, 0 where an observation is left out
    """

    values: Floats
    precision: Floats

    @classmethod
    def of(cls, values: Floats, covariance: Floats, used: Bools) -> Data:
        """From covariances (n, values, values), and which observations (n,) count."""
        precision = np.zeros_like(covariance)
        precision[used] = np.linalg.inv(covariance[used])
        return cls(values, precision)


@dataclass(frozen=True)
class Normal:
    """Normal equations in blocks: common columns, and those of each group.

    Attributes
    ----------
    common : (p, p)
    cross : (groups, p, own)
    own : (groups, own, own)
    """

    common: Floats
    cross: Floats
    own: Floats

    @cached_property
    def eliminated(self) -> Floats:
        """(groups, own, p) own columns' response to the common ones."""
        return np.asarray(np.linalg.solve(self.own, self.cross.transpose(0, 2, 1)), float)

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) of the common columns."""
        reduced = self.common - np.einsum("gpl,glq->pq", self.cross, self.eliminated)
        scale = 1 / np.sqrt(np.diag(reduced))
        return np.asarray(np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale))

    @cached_property
    def own_covariance(self) -> Floats:
        """(groups, own, own) of the groups' columns where the common ones are held."""
        return np.asarray(np.linalg.inv(self.own), float)

    def solve(self, common: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Solve for right-hand sides (p,) and (groups, own)."""
        alone = np.einsum("glm,gm->gl", self.own_covariance, own)
        step = self.covariance @ (common - np.einsum("gpl,gl->p", self.cross, alone))
        return step, alone - self.eliminated @ step

    def log_determinant(self) -> float:
        """Of the whole matrix."""
        return float(-np.linalg.slogdet(self.covariance)[1] - np.linalg.slogdet(self.own_covariance)[1].sum())

    def damped(self, damping: float) -> Normal:
        """Marquardt's: diagonals grown by a share."""
        return Normal(_grown(self.common, damping), self.cross, _grown(self.own, damping))

    def solve_within(self, common: Floats, own: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Solve, where common columns that would leave bounds (p,) end there, and all others follow them."""
        held = np.zeros(len(common), bool)
        ends = np.zeros(len(common))
        while True:
            stiff = self._holding(held)
            step, own_step = stiff.solve(np.where(held, np.diag(stiff.common) * ends, common), own)
            beyond = ~held & ((step < low) | (step > high))
            if not beyond.any():
                return step, own_step
            ends = np.where(beyond, np.clip(step, low, high), ends)
            held |= beyond

    def _holding(self, held: Bools) -> Normal:
        """With common columns (p,) too stiff to leave where the right-hand side puts them."""
        common = self.common.copy()
        at = np.flatnonzero(held)
        common[at, at] *= STIFF
        return Normal(common, self.cross, self.own)


@dataclass(frozen=True)
class Point:
    """Where the session's parameters stand. theta: (columns,); own: (groups, local columns)."""

    theta: Floats
    own: Floats


@dataclass(frozen=True)
class Solved:
    """The least squares at their minimum.

    Attributes
    ----------
    point : of the parameters
    predicted : (n, values)
    slopes : (n, values, columns)
    own_slopes : (n, values, local columns)
    normal : equations there, the priors' information included
    chi2 : of the data and the priors
    """

    point: Point
    predicted: Floats
    slopes: Floats
    own_slopes: Floats
    normal: Normal
    chi2: float


def solve(model: LensModel, data: Data, start: Point) -> Solved:
    """Minimise the squared misfits of data and priors, from a start, within the model's bounds."""
    prior = _Prior.of(model)
    low, high = model.bounds()
    here = _expanded(model, data, prior, start)
    damping = 1e-6
    for _ in range(MOST_STEPS):
        normal, gradient, own_gradient = here[1:]
        theta = here[0].point.theta
        damped = normal.damped(damping)
        step, own_step = damped.solve_within(gradient, own_gradient, low - theta, high - theta)
        within = np.clip(theta + step, low, high)
        trial = _expanded(model, data, prior, Point(within, here[0].point.own + own_step))
        length = np.sqrt(max(float(step @ gradient + np.sum(own_step * own_gradient)), 0.0))
        if trial[0].chi2 <= here[0].chi2 * (1 + 1e-12) + 1e-9:
            here, damping = trial, damping / 10
        else:
            damping = max(damping, 1e-6) * 30
        if length < SETTLED or damping > 1e10:
            break
    return here[0]


@dataclass(frozen=True)
class _Prior:
    """Columns' values before the session, and their precisions; of a group's columns too."""

    centre: Floats
    precision: Floats
    own_precision: Floats

    @classmethod
    def of(cls, model: LensModel) -> _Prior:
        return cls(
            np.array([column.value for column in model.columns]),
            np.array([column.prior_std for column in model.columns]) ** -2.0,
            np.array([column.prior_std for column in model.local_columns]) ** -2.0,
        )


def _expanded(model: LensModel, data: Data, prior: _Prior, point: Point) -> tuple[Solved, Normal, Floats, Floats]:
    """The misfit about a point: with its normal equations and the two parts of minus half its gradient."""
    predicted = model.predicted(point.theta, point.own)
    slopes, own_slopes = model.slopes(point.theta, point.own)
    weighted = data.precision @ slopes
    own_turned = own_slopes.transpose(0, 2, 1)
    own_normal = model.by_group(own_turned @ (data.precision @ own_slopes)) + np.diag(prior.own_precision)
    cross = model.by_group(own_turned @ weighted).transpose(0, 2, 1)
    common = np.tensordot(slopes, weighted, ([0, 1], [0, 1])) + np.diag(prior.precision)
    rest = data.values - predicted
    pulled = (data.precision @ rest[..., None])[..., 0]
    away = prior.centre - point.theta
    own_gradient = model.by_group((own_turned @ pulled[..., None])[..., 0]) - prior.own_precision * point.own
    gradient = np.tensordot(slopes, pulled, ([0, 1], [0, 1])) + prior.precision * away
    chi2 = np.sum(rest * pulled) + np.sum(prior.precision * away**2) + np.sum(prior.own_precision * point.own**2)
    normal = Normal(common, cross, own_normal)
    return Solved(point, predicted, slopes, own_slopes, normal, float(chi2)), normal, gradient, own_gradient


def _grown(matrix: Floats, damping: float) -> Floats:
    """(..., p, p) with its diagonal grown by a share."""
    return matrix * (1 + damping * np.eye(matrix.shape[-1]))
