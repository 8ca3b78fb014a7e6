"""Least squares over the observations of a session, eliminated group by group (Schur complement).

No array here is larger than observations x values x columns: the normal equations of n observations with p common columns
cost n p^2. Levenberg (1944), Marquardt (1963); the elimination: physics of a session over keys.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labkit.estimation.climb import Position, Step, climb
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
    begin = _Misfit(model, data, _Prior.of(model), start)
    end, _, _ = climb(begin, max_steps=MOST_STEPS, tolerance=SETTLED, damping=1e-9)
    return Solved(end.point, end.predicted, *end.slopes, end.normal, -2 * end.objective)


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


@dataclass(frozen=True, eq=False)
class _Misfit(Position):
    """The misfit of data and priors about a point."""

    model: LensModel
    data: Data
    prior: _Prior
    point: Point

    @cached_property
    def predicted(self) -> Floats:
        return self.model.predicted(self.point.theta, self.point.own)

    @cached_property
    def slopes(self) -> tuple[Floats, Floats]:
        return self.model.slopes(self.point.theta, self.point.own)

    @cached_property
    def pulled(self) -> Floats:
        """(n, values) misfits times their inverse covariances."""
        rest = self.data.values - self.predicted
        return np.asarray((self.data.precision @ rest[..., None])[..., 0])

    @cached_property
    def objective(self) -> float:
        """Minus half the squares."""
        prior, point = self.prior, self.point
        chi2 = np.sum((self.data.values - self.predicted) * self.pulled)
        chi2 += np.sum(prior.precision * (prior.centre - point.theta) ** 2)
        chi2 += np.sum(prior.own_precision * point.own**2)
        return -0.5 * float(chi2)

    @cached_property
    def normal(self) -> Normal:
        """The normal equations, the priors' information included."""
        slopes, own_slopes = self.slopes
        weighted = self.data.precision @ slopes
        turned = own_slopes.transpose(0, 2, 1)
        own = self.model.by_group(turned @ (self.data.precision @ own_slopes)) + np.diag(self.prior.own_precision)
        cross = self.model.by_group(turned @ weighted).transpose(0, 2, 1)
        common = np.tensordot(slopes, weighted, ([0, 1], [0, 1])) + np.diag(self.prior.precision)
        return Normal(common, cross, own)

    @cached_property
    def gradient(self) -> tuple[Floats, Floats]:
        """(columns,) and (groups, local columns) of the objective."""
        slopes, own_slopes = self.slopes
        away = self.prior.centre - self.point.theta
        common = np.tensordot(slopes, self.pulled, ([0, 1], [0, 1])) + self.prior.precision * away
        own = self.model.by_group((own_slopes.transpose(0, 2, 1) @ self.pulled[..., None])[..., 0])
        return common, own - self.prior.own_precision * self.point.own

    def step(self, damping: float) -> Step:
        low, high = self.model.bounds()
        gradient, own_gradient = self.gradient
        damped = self.normal.damped(damping)
        theta = self.point.theta
        common, own = damped.solve_within(gradient, own_gradient, low - theta, high - theta)
        square = max(float(common @ gradient + np.sum(own * own_gradient)), 0.0)
        return Step(np.append(common, own), square**0.5, square / 2)

    def moved(self, change: Floats) -> _Misfit:
        theta, own = np.split(change, [self.point.theta.size])
        moved = np.clip(self.point.theta + theta, *self.model.bounds())
        return replace(self, point=Point(moved, self.point.own + own.reshape(self.point.own.shape)))


def _grown(matrix: Floats, damping: float) -> Floats:
    """(..., p, p) with its diagonal grown by a share."""
    return matrix * (1 + damping * np.eye(matrix.shape[-1]))
