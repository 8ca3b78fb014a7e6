"""One lens for a session: the parameters that observations and plan determine, with all their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from labkit.estimation.block_solve import Data, LeastSquares, Point, quadratic, solve
from labkit.estimation.field_terms import Family, family, spreads
from labkit.estimation.focus_line import crossing
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    FOCUS,
    GEOMETRY,
    LATERAL_COLOUR,
    OPEN,
    WAVELENGTH,
    WORKING_F_NUMBER,
    Laws,
)
from labkit.estimation.lens_model import LensModel
from labkit.estimation.settings import SETTINGS
from labkit.optics.known_bias import covariance_with_bias
from labkit.types import Bools, Floats
from labkit.uncertain import Uncertain

LEAST_SHARE = float(np.sqrt(np.finfo(float).eps))
"""Least share of a variance for the other observations: a smaller share is rounding."""


@dataclass(frozen=True)
class Measurements:
    """Measurements of n observations, stacked for the solver.

    Attributes
    ----------
    values : (n, values), see `LensModel`
    covariance : (n, values, values) without the laws' scatter
    calibration : (n, values, values) part of the covariance due to errors of the flat frames
    model : (n, values, values) part of the covariance due to residuals that are not noise alone
    used : (n,) whether the observation is a member
    """

    values: Floats
    covariance: Floats
    calibration: Floats
    model: Floats
    used: Bools


@dataclass(frozen=True)
class LensFit:
    """The estimate of a session's parameters from its members.

    Attributes
    ----------
    model : the laws, for all observations
    measured : measurements of all observations
    solved : the least-squares solution
    bias : change of the estimate due to camera parts that the model of the frames lacks; None if no part is missing
    bias_chi2 : change of chi2 due to the missing parts
    others : probabilities and estimates of other models of the plan: numbers that may be mistaken
    unknown : changes of the estimate by one standard deviation of independent numbers that the model lacks: modes
    """

    model: LensModel
    measured: Measurements
    solved: LeastSquares
    bias: Point | None = None
    bias_chi2: float = 0.0
    others: tuple[tuple[float, LensFit], ...] = ()
    unknown: tuple[Point, ...] = ()

    @property
    def theta(self) -> Floats:
        """(columns,) estimated parameters."""
        return self.solved.point.theta

    @property
    def chi2(self) -> float:
        """Sum of squared misfits of members and priors."""
        return self.solved.chi2 + self.bias_chi2

    @cached_property
    def degrees_of_freedom(self) -> float:
        """Number of measured values less the effective number of parameters that they determine.

        Families with a fitted standard deviation are drawn from it, and cost one number each: chi2 contains their spread.
        """
        model, variance = self.model, np.diag(self.solved.normal.covariance)
        unknown = [
            column.kind in OPEN and family(column) not in model.spread
            for column in model.columns
        ]
        own = [family(column) not in model.spread for column in model.local_columns]
        free = len(model.spread) + np.sum(1 - (variance / model.prior_std**2)[unknown])
        free += np.sum((1 - self.own_variance / model.local_std**2)[:, own])
        return max(float(self.measured.used.sum() * model.values - free), 0.0)

    @cached_property
    def own_variance(self) -> Floats:
        """(blocks, local columns) variances of the local columns."""
        normal = self.solved.normal
        followed = normal.eliminated
        return np.asarray(
            np.einsum("gll->gl", normal.own_covariance)
            + np.einsum("glp,pq,glq->gl", followed, normal.covariance, followed)
        )

    def likelier_spread(self) -> dict[Family, float]:
        """Return the standard deviation of each family of columns, from their estimates and errors."""
        model, own = self.model, self.solved.point.own
        columns = (*model.columns, *model.local_columns * len(own))
        values = np.append(self.theta, own)
        variances = np.append(np.diag(self.solved.normal.covariance), self.own_variance)
        return spreads(columns, values, variances)

    @property
    def reduced_chi2(self) -> float:
        """chi2 over the degrees of freedom; 1 if there is none."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom >= 1 else 1.0

    @property
    def p_value(self) -> float:
        """Probability of a chi2 at least as large."""
        return (
            float(chdtrc(self.degrees_of_freedom, self.chi2))
            if self.degrees_of_freedom >= 1
            else 1.0
        )

    @property
    def birge_ratio(self) -> float:
        """Birge ratio: factor by which errors grow if members disagree beyond chance, else 1."""
        return (
            float(np.sqrt(self.reduced_chi2))
            if self.p_value < SETTINGS.contradiction_chance
            else 1.0
        )

    @property
    def contradicted(self) -> bool:
        """Return whether members disagree beyond chance, or did under the strictest laws."""
        return self.birge_ratio != 1 or self.model.laws != Laws()

    @cached_property
    def errors(self) -> Floats:
        """(columns, columns) covariance of the estimate, Birge ratio and bias included."""
        return self.errors_of(np.eye(len(self.theta)))

    def errors_of(self, combinations: Floats, k: int | None = None) -> Floats:
        """Return the covariance (m, m) of linear combinations of the parameters, over all models of the plan.

        Parameters
        ----------
        combinations : (m, columns)
        k : observation whose values the combinations are: the own columns of its block count too
        """
        normal, model = self.solved.normal, self.model
        own = np.zeros((len(combinations), len(model.local_columns)))
        if k is not None:
            own = model.seen(self.solved.own_slopes, np.array([k]))[0]
        block = model.blocks[model.exposures[k or 0]]
        followed = combinations - own @ normal.eliminated[block]
        noise = (
            followed @ normal.covariance @ followed.T
            + own @ normal.own_covariance[block] @ own.T
        )
        noise += self._repeated(followed, own, block)
        noise *= self.birge_ratio**2 * (1 - sum(chance for chance, _ in self.others))
        for chance, lens in self.others:
            moved = combinations @ (lens.theta - self.theta)
            noise += chance * (lens.errors_of(combinations, k) + np.outer(moved, moved))
        for one in self.unknown:
            change = combinations @ one.theta + own @ one.own[block]
            noise += np.outer(change, change)
        if self.bias is None:
            return np.asarray(noise)
        bias = combinations @ self.bias.theta + own @ self.bias.own[block]
        return covariance_with_bias(noise, bias)

    def value(self, kind: str, *name: str | float) -> float:
        """Return the estimate of a column."""
        return float(self.theta[self.model.index(kind, *name)])

    def std(self, kind: str, *name: str | float) -> float:
        """Return the standard error of a column."""
        return float(np.sqrt(np.diag(self.errors))[self.model.index(kind, *name)])

    def uncertain(self, kind: str, *name: str | float, unit: str = "") -> Uncertain:
        """Return the estimate of a column with its standard error."""
        return Uncertain(self.value(kind, *name), self.std(kind, *name), unit)

    @cached_property
    def residual_std(self) -> Floats:
        """(n, values) standard errors of members' values less their fitted values, Birge ratio included."""
        noise = self.measured.covariance + np.diag(self.model.scatter())
        left = np.diagonal(noise - self._spread, axis1=1, axis2=2)
        return np.asarray(self.birge_ratio * np.sqrt(np.maximum(left, 0.0)))

    @cached_property
    def _spread(self) -> Floats:
        """(n, values, values) covariance of fitted values."""
        model = self.model
        values, terms = model.values, model.terms
        spread = np.empty((len(model.readings), values, values))
        for k, covariance in enumerate(self.solved.covariance):
            here = np.flatnonzero(model.exposures == k)
            field = model.polynomials[here]
            of_values = covariance.reshape(values, terms, values, terms)
            for value in range(values):
                turned = np.tensordot(field[:, value], of_values[value], 1)
                spread[here, value] = np.sum(turned * field, axis=2)
        return spread

    @cached_property
    def predictions(self) -> tuple[Floats, Floats]:
        """Leave-one-out predictions: (n, values) of each observation from all others, and their (n, values, values) covariance.

        The covariance includes the scatter of the laws, but not the observation's own noise.
        """
        spread = self._spread
        noise = self.measured.covariance + np.diag(self.model.scatter())
        root = np.linalg.cholesky(noise)
        back = np.linalg.inv(root)
        share = back @ spread @ back.transpose(0, 2, 1) * self.measured.used[:, None, None]
        shares, vectors = np.linalg.eigh(share)
        shares = np.clip(shares, 0.0, 1.0)
        grown = shares / np.maximum(1 - shares, LEAST_SHARE)
        turned = root @ vectors
        rest = np.einsum(
            "nji,nj->ni",
            vectors,
            np.einsum("nij,nj->ni", back, self.measured.values - self.solved.predicted),
        )
        away = np.einsum("nij,nj->ni", turned, grown * rest) * self.measured.used[:, None]
        others = (turned * grown[:, None]) @ turned.transpose(0, 2, 1)
        used = self.measured.used[:, None, None]
        covariance = np.where(used, others, spread) + np.diag(self.model.scatter())
        return self.solved.predicted - away, covariance

    @cached_property
    def true_values(self) -> Floats:
        """(n, values) of the observations for light and a pitch as stated, see `LensModel.true`."""
        return self.model.true(self.solved.point.theta, self.solved.point.own)

    def posterior(self, k: int) -> tuple[Floats, Floats]:
        """Estimate the values of observation k from the whole session.

        If the laws let modes scatter from range to range, the observation's own measurement determines its share.

        Returns
        -------
        (values,) for the estimated wavelengths and pitch, see `LensModel.true`, and their covariance (values, values)
        """
        model, value = self.model, self.true_values[k]
        whole = self.errors_of(self._true_slopes(k), k)
        if not model.laws.paraxial:
            whole = covariance_with_bias(whole, self._by_f_number(value))
        own = self._own_share(k) @ (self.measured.values[k] - self.solved.predicted[k])
        return value + own, self._with_scatter(whole, k)

    def longer(self, k: int) -> float:
        """Return ln of the estimated over the stated wavelength of observation k."""
        return float(self.model.longer[self.model.exposures[k]] @ self.theta)

    def scale_std(self, k: int) -> float:
        """Return the relative standard error of lambda N in observation k, in units of the stated pixel pitch.

        A cone that errs as the wavelength does leaves lambda N, the scale of diffraction, as it is, and a wrong pitch leaves
        it in pixels: so the apparent cone tells it. Where blurs tell N better than the wavelength is known, the wavelength's
        error counts.
        """
        slopes = self._true_slopes(k)
        slopes[-2] = self._slopes(k)[-2]
        whole = self._with_scatter(self.errors_of(slopes, k), k)
        return float(np.sqrt(whole[-2, -2]))

    def _true_slopes(self, k: int) -> Floats:
        """Return the derivatives (values, columns) of the `true_values` of observation k."""
        return self.model.true_slopes(self._slopes(k))

    def _slopes(self, k: int) -> Floats:
        """Return the derivatives (values, columns) of the predicted values of observation k."""
        return np.asarray(self.model.seen(self.solved.slopes, np.array([k]))[0])

    def _own_share(self, k: int) -> Floats:
        """Return the share (values, values) of observation k's misfit that is its modes' own scatter."""
        scatter = np.diag(self.model.mode_scatter())
        if self.model.laws.shared:
            return scatter
        noise = self.measured.covariance[k] + np.diag(self.model.scatter())
        return np.asarray(scatter @ np.linalg.inv(noise))

    def _with_scatter(self, covariance: Floats, k: int) -> Floats:
        """Return the covariance (values, values) of observation k's values, for that of the values by the laws."""
        left = np.eye(self.model.values) - self._own_share(k)
        return np.asarray(
            left @ covariance @ left.T + left @ np.diag(self.model.mode_scatter())
        )

    def _by_f_number(self, value: Floats) -> Floats:
        """Return the change of values (values,) if all cones are off because all wavelengths are: see `LensModel.predicted`."""
        modes = len(self.model.noll)
        change = np.zeros(len(value))
        change[:modes] = -value[:modes]
        change[-2] = 1.0
        return change * self.value(WORKING_F_NUMBER)

    def _repeated(self, followed: Floats, own: Floats, block: int) -> Floats:
        """Return the covariance (m, m) that model errors add to m combinations because every fit has the same error.

        Residuals that are not noise have a cause, which is in every photograph: an average over observations keeps its
        error. Least squares takes the errors of fits as independent, and an average as better by their number.

        Parameters
        ----------
        followed : (m, columns) derivatives by the common columns, own columns eliminated
        own : (m, local columns) derivatives by the own columns of a block
        block : the block
        """
        if not self._model_pulls.any():
            return np.zeros((len(followed), len(followed)))
        normal, model = self.solved.normal, self.model
        moves = self.solved.followed @ (normal.covariance @ followed.T)
        alike = model.blocks == block
        moves[alike] += self.solved.own_slopes[alike] @ (
            normal.own_covariance[block] @ own.T
        )
        moved = np.tensordot(moves, self._model_pulls, ([0, 1], [0, 1]))
        return np.asarray((1 - 1 / self.measured.used.sum()) * moved @ moved.T)

    @cached_property
    def _model_pulls(self) -> Floats:
        """(exposures, coefficients, values) pull of model errors of one standard deviation, the same in every fit."""
        used = np.where(self.measured.used[:, None, None], self.measured.model, 0.0)
        roots = _roots(used)
        return np.stack(
            [self.solved.data.pulled(roots[..., k]) for k in range(self.model.values)],
            axis=-1,
        )

    def contributions(self, gradient: Floats) -> dict[str, float]:
        """Return an error budget of a combination (columns,): standard errors by photons, calibration, geometry, model."""
        normal, model, measured = self.solved.normal, self.model, self.measured
        along = model.seen(self.solved.followed @ (normal.covariance @ gradient))
        pull = (self.solved.data.precision @ along[..., None])[..., 0]
        calibration = quadratic(pull, measured.calibration)
        surplus = quadratic(pull, measured.model)
        scatter = np.sum(pull**2, axis=0) * model.scatter()
        prior = ((gradient @ normal.covariance) / model.prior_std) ** 2
        kinds = np.array([column.kind for column in model.columns])

        def share(*of: str) -> float:
            return float(prior[np.isin(kinds, of)].sum())

        shares = {
            "photons": quadratic(pull, measured.covariance) - calibration - surplus,
            "calibration": calibration,
            "geometry": float(scatter[-1]) + share(*GEOMETRY, LATERAL_COLOUR),
            "model": surplus
            + float(scatter[:-1].sum())
            + share(WAVELENGTH, WORKING_F_NUMBER),
        }
        shares["model"] += float(self.errors_of(gradient[None])[0, 0]) - sum(
            shares.values()
        )
        return {name: float(np.sqrt(max(value, 0.0))) for name, value in shares.items()}

    @property
    def log_evidence(self) -> float:
        """Log-evidence of the laws, up to a constant common to all laws: the marginal likelihood of the members.

        Laplace's approximation, exact for linear laws: S. F. Gull, in Maximum Entropy and Bayesian Methods (1988).
        """
        noise = (self.measured.covariance + np.diag(self.model.scatter()))[
            self.measured.used
        ]
        own = len(self.solved.point.own) * np.sum(np.log(self.model.local_std))
        prior = np.sum(np.log(self.model.prior_std)) + own
        log_noise = float(np.linalg.slogdet(noise)[1].sum())
        return -0.5 * (
            self.chi2 + log_noise + self.solved.normal.log_determinant()
        ) - float(prior)


def _roots(covariance: Floats) -> Floats:
    """Return the symmetric square roots of covariances (n, values, values)."""
    values, vectors = np.linalg.eigh(covariance)
    roots = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors
    return np.asarray(roots @ vectors.transpose(0, 2, 1))


def fit_lens(
    model: LensModel,
    measured: Measurements,
    start: Point | None = None,
    tolerance: float = 1e-4,
) -> LensFit:
    """Estimate the session's parameters by least squares.

    Parameters
    ----------
    model : laws and columns
    measured : measurements of all the model's observations
    start : an earlier estimate of the same columns; None to start from the observations' defocus
    tolerance : of the end, in standard errors
    """
    noise = measured.covariance + np.diag(model.scatter())
    data = Data.of(model, measured.values, noise, measured.used)
    start = start or first_point(model, measured)
    return LensFit(model, measured, solve(model, data, start, tolerance))


def predicted_by_other_stations(lens: LensFit) -> Floats:
    """Predict the values (n, values) of each observation: modes by the members at other stations of the rail, if there are any.

    Defocus is predicted by all other observations, because one other station does not determine best focus.
    """
    stations = np.array([reading.station for reading in lens.model.readings])
    modes = [k for k in range(len(lens.model.noll)) if k != lens.model.defocus]
    predicted = lens.predictions[0].copy()
    for station in np.unique(stations):
        here = stations == station
        others = replace(lens.measured, used=lens.measured.used & ~here)
        if others.used.any():
            rest = fit_lens(lens.model, others, lens.solved.point)
            predicted[np.ix_(here, modes)] = rest.solved.predicted[np.ix_(here, modes)]
    return predicted


def fit_families(
    model: LensModel, measured: Measurements, start: Point | None = None
) -> LensFit:
    """Estimate the session's parameters, and with them the standard deviations of families of columns.

    These maximise the marginal likelihood: of the field's terms, and of what colours differ by in the modes.
    """
    lens = fit_lens(model, measured, start)
    for _ in range(SETTINGS.most_steps):
        wider = replace(model, spread=lens.likelier_spread())
        solved = solve(wider, lens.solved.data, lens.solved.point)
        changed = LensFit(wider, measured, solved)
        if changed.log_evidence < lens.log_evidence + SETTINGS.same_optimum:
            break
        lens = changed
    return lens


def first_point(model: LensModel, measured: Measurements) -> Point:
    """Return a start: best focus where each channel's defocus crosses zero, all other columns at their prior mean."""
    theta = model.centre.copy()
    channels = np.array([reading.key.channel for reading in model.readings])
    ranges = np.array([reading.range_mm for reading in model.readings])
    waves = measured.values[:, model.defocus]
    found = {
        channel: float(crossing(ranges[here], waves[here], model))
        for channel in model.channels
        if np.any(here := (channels == channel) & measured.used)
    }
    first = found.get(
        model.reference,
        float(np.mean(list(found.values()))) if found else float(ranges.mean()),
    )
    theta[model.index(FOCUS)] = first
    for channel in model.channels:
        if channel != model.reference:
            theta[model.index(AXIAL_COLOUR, channel)] = found.get(channel, first) - first
    return Point(theta, np.zeros((len(model.channels), len(model.local_columns))))
