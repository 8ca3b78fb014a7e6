"""Least squares over the observations of a session, eliminated block by block (Schur complement).

The observations of an exposure are added up once (`Data`): a step costs as much for a thousand tiles as for ten. Levenberg
(1944), Marquardt (1963).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labkit.estimation.lens_model import LensModel
from labkit.estimation.levenberg_marquardt import Position, Step, climb
from labkit.estimation.settings import SETTINGS
from labkit.types import Bools, Floats


@dataclass(frozen=True, eq=False)
class Data:
    """Measured values of n observations with their weights, and what they say of the coefficients of their exposures.

    The values of an exposure are linear in its coefficients: a quadratic form of these holds all that its observations say,
    however many there are.

    Attributes
    ----------
    model : has the exposures, and the polynomials of the field
    values : (n, values)
    precision : (n, values, values) inverse covariances; 0 for observations left out
    """

    model: LensModel
    values: Floats
    precision: Floats

    @classmethod
    def of(cls, model: LensModel, values: Floats, covariance: Floats, used: Bools) -> Data:
        """Weight values (n, values) by covariances (n, values, values); used: (n,) observations that count."""
        precision = np.zeros_like(covariance)
        precision[used] = np.linalg.inv(covariance[used])
        return cls(model, values, precision)

    def pulled(self, shifts: Floats) -> Floats:
        """Return the pull (exposures, coefficients) of residuals (n, values) on the coefficients."""
        forces = (self.precision @ shifts[..., None])[..., 0]
        pulls = np.zeros((len(self.model.blocks), self.model.values, self.model.terms))
        np.add.at(pulls, self.model.exposures, forces[..., None] * self.model.polynomials)
        return pulls.reshape(len(pulls), -1)

    @cached_property
    def information(self) -> Floats:
        """(exposures, coefficients, coefficients)."""
        model = self.model
        exposures, values, terms = len(model.blocks), model.values, model.terms
        information = np.zeros((exposures, values, terms, values, terms))
        for k in range(exposures):
            here = np.flatnonzero(model.exposures == k)
            field, precision = model.polynomials[here], self.precision[here]
            for value in range(values):
                weighted = precision[:, value, :, None] * field
                information[k, value] = np.tensordot(field[:, value], weighted, (0, 0))
        return information.reshape(exposures, values * terms, values * terms)

    @cached_property
    def _middle(self) -> tuple[Floats, Floats, float]:
        """Coefficients near those that fit best, the pull of the residuals there, and their chi2.

        Two steps, so that rounding of the first does not count.
        """
        scale = np.sqrt(np.einsum("kcc->kc", self.information))
        scale[scale == 0] = 1.0
        unit = self.information / (scale[:, :, None] * scale[:, None])
        unit += SETTINGS.exact**2 * np.eye(scale.shape[1])
        middle, rest = np.zeros_like(scale), self.values
        for _ in range(2):
            pull = self.pulled(rest)
            middle = (
                middle + np.linalg.solve(unit, (pull / scale)[..., None])[..., 0] / scale
            )
            rest = self.values - self.model.seen(middle)
        return middle, self.pulled(rest), quadratic(rest, self.precision)

    def chi2(self, coefficients: Floats) -> float:
        """Return the sum of squared misfits, weighted by the precision, for coefficients (exposures, coefficients)."""
        middle, pull, least = self._middle
        away = coefficients - middle
        return least + quadratic(away, self.information) - 2 * float(np.sum(away * pull))

    def pulls(self, coefficients: Floats) -> Floats:
        """Return minus half the derivatives of `chi2`, (exposures, coefficients)."""
        middle, pull, _ = self._middle
        away = coefficients - middle
        return np.asarray(pull - (self.information @ away[..., None])[..., 0])


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
    def coefficients(self) -> Floats:
        """(exposures, coefficients) predicted by the model."""
        return self.model.coefficients(self.point.theta, self.point.own)

    @cached_property
    def predicted(self) -> Floats:
        """(n, values) predicted by the model."""
        return self.model.seen(self.coefficients)

    @property
    def prior_chi2(self) -> float:
        """Sum of squared departures from the priors' means."""
        model, point = self.model, self.point
        away = (point.theta - model.centre) / model.prior_std
        return float(np.sum(away**2) + np.sum((point.own / model.local_std) ** 2))

    @cached_property
    def chi2(self) -> float:
        """Sum of squared misfits of data and priors."""
        return self.data.chi2(self.coefficients) + self.prior_chi2

    @property
    def objective(self) -> float:
        """Log-likelihood up to a constant."""
        return -0.5 * self.chi2

    @cached_property
    def _slopes(self) -> tuple[Floats, Floats]:
        return self.model.slopes(self.point.theta, self.point.own)

    @property
    def slopes(self) -> Floats:
        """(exposures, coefficients, columns) derivatives of the coefficients by the common columns."""
        return self._slopes[0]

    @property
    def own_slopes(self) -> Floats:
        """(exposures, coefficients, local columns) derivatives by the block's own columns."""
        return self._slopes[1]

    @cached_property
    def normal(self) -> Normal:
        """Normal equations, the priors' information included."""
        model = self.model
        weighted = self.data.information @ self.slopes
        own_weighted = self.data.information @ self.own_slopes
        members = [model.blocks == block for block in range(model.blocks.max() + 1)]

        def summed(rows: Floats, other: Floats) -> Floats:
            return np.array([_product(rows[at], other[at]) for at in members])

        return Normal(
            _product(self.slopes, weighted) + np.diag(model.prior_std**-2.0),
            summed(weighted, self.own_slopes),
            summed(self.own_slopes, own_weighted) + np.diag(model.local_std**-2.0),
        )

    def pulls(self, forces: Floats) -> tuple[Floats, Floats]:
        """Return right-hand sides (p,) and (blocks, own) of the normal equations for forces (exposures, coefficients)."""
        own = np.zeros_like(self.point.own)
        np.add.at(own, self.model.blocks, np.einsum("nvl,nv->nl", self.own_slopes, forces))
        return np.tensordot(self.slopes, forces, ([0, 1], [0, 1])), own

    @cached_property
    def followed(self) -> Floats:
        """(exposures, coefficients, columns) derivatives by the common columns, own columns following."""
        eliminated = self.normal.eliminated[self.model.blocks]
        return np.asarray(self.slopes - self.own_slopes @ eliminated)

    @cached_property
    def covariance(self) -> Floats:
        """(exposures, coefficients, coefficients) covariance of each exposure's coefficients."""
        own, alone = self.own_slopes, self.normal.own_covariance[self.model.blocks]
        return np.asarray(
            self.followed @ self.normal.covariance @ self.followed.transpose(0, 2, 1)
            + own @ alone @ own.transpose(0, 2, 1)
        )

    def step(self, damping: float) -> Step:
        model = self.model
        theta = self.point.theta
        gradient, own = self.pulls(self.data.pulls(self.coefficients))
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

    def foreseen(self, change: Floats) -> LeastSquares:
        return self.moved(change)


def solve(
    model: LensModel, data: Data, start: Point, tolerance: float = 1e-4
) -> LeastSquares:
    """Minimise the squared misfits of data and priors, from a start, within the model's bounds.

    The first step is damped by 1e-9 only, for the weakest combinations have 1e-9 of the others' information.
    """
    return climb(LeastSquares(model, data, start), tolerance=tolerance, damping=1e-9)[0]


def _product(rows: Floats, other: Floats) -> Floats:
    """Return the sum of products (a, b) of rows (exposures, coefficients, a) and (exposures, coefficients, b)."""
    return np.asarray(np.tensordot(rows, other, ([0, 1], [0, 1])))


def _grown(matrix: Floats, damping: float) -> Floats:
    """Grow the diagonal of matrices (..., p, p) by the share `damping`."""
    return matrix * (1 + damping * np.eye(matrix.shape[-1]))


def quadratic(vectors: Floats, matrices: Floats) -> float:
    """Sum the quadratic forms of matrices (n, values, values) in vectors (n, values)."""
    return float(np.sum(vectors * (matrices @ vectors[..., None])[..., 0]))
