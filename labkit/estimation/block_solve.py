"""Least squares over the observations of a session, eliminated block by block (Schur complement).

No array here is larger than observations x values x columns: the normal equations of n observations with p common columns
cost n p^2. Levenberg (1944), Marquardt (1963).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labkit.estimation.climb import Position, Step, climb
from labkit.estimation.lens_model import LensModel
from labkit.estimation.settings import SETTINGS
from labkit.types import Bools, Floats


@dataclass(frozen=True)
class Data:
    """Measured values of n observations with their weights.

    Attributes
    ----------
    values : (n, values)
    precision : (n, values, values) inverse covariances; 0 for observations that are left out
    """

    values: Floats
    precision: Floats

    @classmethod
    def of(cls, values: Floats, covariance: Floats, used: Bools) -> Data:
        """Weight values (n, values) by covariances (n, values, values); used: (n,) observations that count."""
        precision = np.zeros_like(covariance)
        precision[used] = np.linalg.inv(covariance[used])
        return cls(values, precision)

    def chi2(self, rest: Floats) -> float:
        """Return the sum of squared misfits (n, values), weighted by the precision."""
        return quadratic(rest, self.precision)


@dataclass(frozen=True)
class Normal:
    """Normal equations: p common columns, and own columns of each block of observations.

    Attributes
    ----------
    common : (p, p)
    cross : (blocks, p, own)
    own : (blocks, own, own)
    """

    common: Floats
    cross: Floats
    own: Floats

    @cached_property
    def eliminated(self) -> Floats:
        """(blocks, own, p) response of own columns to common columns."""
        return np.asarray(np.linalg.solve(self.own, self.cross.transpose(0, 2, 1)), float)

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) covariance of the common columns."""
        reduced = self.common - np.einsum("gpl,glq->pq", self.cross, self.eliminated)
        scale = 1 / np.sqrt(np.diag(reduced))
        return np.asarray(
            np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        )

    @cached_property
    def own_covariance(self) -> Floats:
        """(blocks, own, own) covariance of each block's own columns, the common columns held."""
        return np.asarray(np.linalg.inv(self.own), float)

    def solve(self, common: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Solve for right-hand sides (p,) and (blocks, own)."""
        alone = np.einsum("glm,gm->gl", self.own_covariance, own)
        step = self.covariance @ (common - np.einsum("gpl,gl->p", self.cross, alone))
        return step, alone - self.eliminated @ step

    def log_determinant(self) -> float:
        """Return ln of the determinant of the whole matrix."""
        return float(
            -np.linalg.slogdet(self.covariance)[1]
            - np.linalg.slogdet(self.own_covariance)[1].sum()
        )

    def damped(self, damping: float) -> Normal:
        """Return Marquardt's equations: every diagonal element grows by the share `damping`."""
        return Normal(_grown(self.common, damping), self.cross, _grown(self.own, damping))

    def solve_within(
        self, common: Floats, own: Floats, low: Floats, high: Floats
    ) -> tuple[Floats, Floats]:
        """Solve within bounds (p,): common columns stop at a bound, all other columns follow."""
        held = np.zeros(len(common), bool)
        ends = np.zeros(len(common))
        while True:
            stiff = self._holding(held)
            step, own_step = stiff.solve(
                np.where(held, np.diag(stiff.common) * ends, common), own
            )
            beyond = ~held & ((step < low) | (step > high))
            if not beyond.any():
                return step, own_step
            ends = np.where(beyond, np.clip(step, low, high), ends)
            held |= beyond

    def _holding(self, held: Bools) -> Normal:
        """Return equations in which held columns (p,) keep the values of the right-hand side."""
        common = self.common.copy()
        at = np.flatnonzero(held)
        common[at, at] /= SETTINGS.exact**2
        return Normal(common, self.cross, self.own)


@dataclass(frozen=True)
class Point:
    """A point of the session's parameter space: `theta` (columns,), and `own` (blocks, local columns)."""

    theta: Floats
    own: Floats


@dataclass(frozen=True, eq=False)
class LeastSquares(Position):
    """Squared misfits of data and priors about a point of the session's parameters."""

    model: LensModel
    data: Data
    point: Point

    @cached_property
    def predicted(self) -> Floats:
        """(n, values) predicted by the model."""
        return self.model.predicted(self.point.theta, self.point.own)

    @cached_property
    def rest(self) -> Floats:
        """(n, values) residuals: measured less predicted."""
        return self.data.values - self.predicted

    @cached_property
    def chi2(self) -> float:
        """Sum of squared misfits of data and priors."""
        model = self.model
        point = self.point
        away = (point.theta - model.centre) / model.prior_std
        own = point.own / model.local_std
        return self.data.chi2(self.rest) + float(np.sum(away**2) + np.sum(own**2))

    @property
    def objective(self) -> float:
        """Log-likelihood up to a constant."""
        return -0.5 * self.chi2

    @cached_property
    def _slopes(self) -> tuple[Floats, Floats]:
        return self.model.slopes(self.point.theta, self.point.own)

    @property
    def slopes(self) -> Floats:
        """(n, values, columns) derivatives by the common columns."""
        return self._slopes[0]

    @property
    def own_slopes(self) -> Floats:
        """(n, values, local columns) derivatives by the block's own columns."""
        return self._slopes[1]

    @cached_property
    def normal(self) -> Normal:
        """Normal equations, the priors' information included."""
        model = self.model
        weighted = self.data.precision @ self.slopes
        own_weighted = self.data.precision @ self.own_slopes
        members = [model.blocks == block for block in range(model.blocks.max() + 1)]

        def summed(rows: Floats, other: Floats) -> Floats:
            return np.array([_product(rows[at], other[at]) for at in members])

        return Normal(
            _product(self.slopes, weighted) + np.diag(model.prior_std**-2.0),
            summed(weighted, self.own_slopes),
            summed(self.own_slopes, own_weighted) + np.diag(model.local_std**-2.0),
        )

    def pulls(self, shifts: Floats) -> tuple[Floats, Floats]:
        """Return right-hand sides (p,) and (blocks, own) of the normal equations for residuals (n, values)."""
        weighted = (self.data.precision @ shifts[..., None])[..., 0]
        own = self.model.by_block(np.einsum("nvl,nv->nl", self.own_slopes, weighted))
        return np.tensordot(self.slopes, weighted, ([0, 1], [0, 1])), own

    def step(self, damping: float) -> Step:
        model = self.model
        theta = self.point.theta
        gradient, own = self.pulls(self.rest)
        gradient -= (theta - model.centre) / model.prior_std**2
        own -= self.point.own / model.local_std**2
        low, high = model.bounds()
        change, own_change = self.normal.damped(damping).solve_within(
            gradient, own, low - theta, high - theta
        )
        square = max(float(change @ gradient + np.sum(own_change * own)), 0.0)
        return Step(np.append(change, own_change), square**0.5, square / 2)

    def moved(self, change: Floats) -> LeastSquares:
        theta, own = np.split(change, [self.point.theta.size])
        within = np.clip(self.point.theta + theta, *self.model.bounds())
        return replace(
            self, point=Point(within, self.point.own + own.reshape(self.point.own.shape))
        )


def solve(
    model: LensModel, data: Data, start: Point, tolerance: float = 1e-4
) -> LeastSquares:
    """Minimise the squared misfits of data and priors, from a start, within the model's bounds.

    The first step is damped by 1e-9 only, for the weakest combinations have 1e-9 of the others' information.
    """
    return climb(LeastSquares(model, data, start), tolerance=tolerance, damping=1e-9)[0]


def _product(rows: Floats, other: Floats) -> Floats:
    """Return the sum of products (a, b) of rows (n, values, a) and (n, values, b)."""
    return np.asarray(np.tensordot(rows, other, ([0, 1], [0, 1])))


def _grown(matrix: Floats, damping: float) -> Floats:
    """Grow the diagonal of matrices (..., p, p) by the share `damping`."""
    return matrix * (1 + damping * np.eye(matrix.shape[-1]))


def quadratic(vectors: Floats, matrices: Floats) -> float:
    """Sum the quadratic forms of matrices (n, values, values) in vectors (n, values)."""
    return float(np.sum(vectors * (matrices @ vectors[..., None])[..., 0]))
