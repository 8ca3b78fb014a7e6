"""Defocus against range: best focus of each colour and one pupil magnification (thesis §4.5.2, Appendix E)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from labkit.errors import DataError
from labkit.optics.lens import Convention, ThinLens, defocus_slopes, defocus_waves
from labkit.types import Floats

TELLING_STD = (
    0.02  # pupil magnifications of real lenses lie between 0.5 and 2: less certain than this, nothing was learnt
)
USUAL_MAGNIFICATION_STD = 0.3
LEAST, MOST = 0.05, 20.0  # pupil magnifications that are tried; a fit that ends there has found none
MODEL_FLOOR_WAVES = 2e-4  # RMS error beyond the bound of nine defocus values from an independent simulator
LEAST_SLOPE = 1e-9  # standard errors for a unit of a parameter: less tells nothing
ROUNDING = 1e-14  # of an eigenvalue, scaled to a unit diagonal
SIGN_FLOOR_WAVES = 0.01  # errors below this decide no sign


@dataclass(frozen=True, slots=True)
class DefocusPoint:
    """A signed defocus, waves RMS at the reference wavelength, seen at a range; std: its standard error."""

    range_mm: float
    channel: str
    waves: float
    std: float


@dataclass(frozen=True)
class FocusFit:
    """Best focus (mm) of each channel and the pupil magnification.

    covariance: of the channels' best focus in order, then of the magnification. residual_waves: measured less fitted, by
    channel, in the order the points came in. chi2_per_freedom: None where there are as many unknowns as points.
    """

    channels: tuple[str, ...]
    best_focus_mm: Floats
    pupil_magnification: float
    covariance: Floats
    residual_waves: dict[str, list[float]]
    chi2_per_freedom: float | None
    convention: Convention

    @property
    def std(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def identifiable(self) -> bool:
        """Whether the pupil magnification could be told at the ranges measured."""
        return bool(self.std[-1] <= TELLING_STD) and not self.at_limit

    @property
    def at_limit(self) -> bool:
        """Whether the magnification ended at the edge of what is tried: then the points do not follow a lens's curve."""
        return not 1.001 * LEAST < self.pupil_magnification < MOST / 1.001


def fit_focus(
    points: Sequence[DefocusPoint],
    focal_length_mm: float,
    f_number: float,
    reference_nm: float,
    convention: Convention,
    range_std_mm: float = 0.0,
) -> FocusFit:
    """Weighted least squares of (4.40) over all points; standard errors grow with the residuals where those are larger.

    range_std_mm: standard error of each range, which all colours seen there share; one common to all ranges is not in it.
    Raises DataError where a channel has fewer than two ranges or the points are fewer than the unknowns.
    """
    channels = tuple(dict.fromkeys(p.channel for p in points))
    for name in channels:
        own = {p.range_mm for p in points if p.channel == name}
        if len(own) < 2:
            raise DataError(
                f"best focus and pupil magnification need at least 2 ranges for each channel; {name} has {len(own)}: "
                "photograph the target at more ranges"
            )
    which = np.array([channels.index(p.channel) for p in points])
    ranges = np.array([p.range_mm for p in points])
    waves = np.array([p.waves for p in points])
    std = np.hypot([p.std for p in points], MODEL_FLOOR_WAVES)

    def modelled(theta: Floats) -> Floats:
        lens = ThinLens(focal_length_mm, f_number, float(theta[-1]))
        return defocus_waves(lens, ranges, theta[:-1][which], reference_nm, convention)

    start = [_crossing(ranges[which == k], waves[which == k], focal_length_mm) for k in range(len(channels))]
    theta0 = np.array([*start, 1.0])
    shortest = 1.01 * focal_length_mm

    lens = ThinLens(focal_length_mm, f_number)
    moved = range_std_mm * defocus_slopes(lens, ranges, theta0[:-1][which], reference_nm, convention)[0]
    shared = np.outer(moved, moved) * (ranges[:, None] == ranges)
    root = cholesky(np.diag(std**2) + shared, lower=True)

    def misfit(theta: Floats) -> Floats:
        return np.asarray(solve_triangular(root, waves - modelled(theta), lower=True))

    def slopes(theta: Floats) -> Floats:
        lens = ThinLens(focal_length_mm, f_number, float(theta[-1]))
        _, by_focus, by_pupils = defocus_slopes(lens, ranges, theta[:-1][which], reference_nm, convention)
        own = np.where(which[:, None] == np.arange(len(channels)), by_focus[:, None], 0.0)
        return np.asarray(solve_triangular(root, -np.column_stack([own, by_pupils]), lower=True))

    solved = least_squares(
        misfit,
        theta0,
        slopes,
        x_scale=np.array([1e-3 * r for r in start] + [0.01]),
        bounds=([shortest] * len(channels) + [LEAST], [np.inf] * len(channels) + [MOST]),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    jacobian: Floats = np.asarray(solved.jac, float)  # the stubs allow sparse ones too
    covariance = _covariance(jacobian)
    freedom = len(points) - theta0.size
    chi2 = float(2 * solved.cost / freedom) if freedom > 0 else None
    left = waves - modelled(solved.x)
    residuals = {c: [float(v) for v in left[which == k]] for k, c in enumerate(channels)}
    best = np.asarray(solved.x, float)
    widened = covariance * max(1.0, chi2 or 1.0)
    return FocusFit(channels, best[:-1], float(best[-1]), widened, residuals, chi2, convention)


def _covariance(jacobian: Floats) -> Floats:
    """(J^T J)^-1, its entries huge where the ranges tell nothing, never zero."""
    scale = 1 / np.linalg.norm(jacobian, axis=0).clip(LEAST_SLOPE)
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian * np.outer(scale, scale))
    return np.asarray((vectors / values.clip(ROUNDING)) @ vectors.T * np.outer(scale, scale))


def _crossing(ranges: Floats, waves: Floats, focal_length_mm: float) -> float:
    """Range of zero defocus: defocus is nearly a straight line over the image distance, that is over 1/(range - f)."""
    slope, offset = np.polyfit(1 / (ranges - focal_length_mm), waves, 1)
    nearest = -slope / offset if offset != 0 else np.inf
    low, high = ranges.min(), ranges.max()
    reach = 3 * (high - low)
    return float(np.clip(nearest + focal_length_mm, max(low - reach, 1.02 * focal_length_mm), high + reach))


def choose_signs(
    ranges_mm: Sequence[float],
    defocus: Sequence[float],
    std: Sequence[float],
    others: Mapping[int, Sequence[float]],
    lens: ThinLens,
    reference_nm: float,
) -> list[int]:
    """Signs that turn each fit of one channel into the right twin: defocus must grow with range.

    defocus, std: as fitted. others: the other even modes of each fit, mode -> values; a lens keeps them from range to
    range. Of the assignments under which defocus grows with range the one is taken that fits the lens's curve and
    leaves the other modes most alike. Returns +1 or -1 for each fit.
    """
    order = np.argsort(ranges_mm)
    ranges = np.asarray(ranges_mm, float)[order]
    values = np.abs(np.asarray(defocus, float))[order]
    errors = np.hypot(np.asarray(std, float)[order], SIGN_FLOOR_WAVES)
    as_fitted = np.where(np.asarray(defocus, float)[order] < 0, -1.0, 1.0)
    best, best_cost = np.ones(len(order)), np.inf
    for negative in range(len(order) + 1):
        signs = np.where(np.arange(len(order)) < negative, -1.0, 1.0)
        signed = signs * values
        cost = _curve_cost(ranges, signed, errors, lens, reference_nm)
        for mode in others.values():
            turned = np.asarray(mode, float)[order] * signs * as_fitted
            cost += float(np.sum((turned - turned.mean()) ** 2)) / SIGN_FLOOR_WAVES**2
        if cost < best_cost:
            best, best_cost = signs * as_fitted, cost
    result = np.empty(len(order), int)
    result[order] = best.astype(int)
    return [int(s) for s in result]


def _curve_cost(ranges: Floats, waves: Floats, errors: Floats, lens: ThinLens, reference_nm: float) -> float:
    """Misfit of the best curve, its pupil magnification near 1 as lenses have it."""
    start = _crossing(ranges, waves, lens.focal_length_mm)

    def misfit(theta: Floats) -> Floats:
        own = replace(lens, pupil_magnification=float(theta[1]))
        curve = (waves - defocus_waves(own, ranges, theta[0], reference_nm)) / errors
        return np.append(curve, (theta[1] - 1.0) / USUAL_MAGNIFICATION_STD)

    bounds = ([1.01 * lens.focal_length_mm, LEAST], [np.inf, MOST])
    return float(2 * least_squares(misfit, [start, 1.0], bounds=bounds, x_scale=[1e-3 * start, 0.1]).cost)
