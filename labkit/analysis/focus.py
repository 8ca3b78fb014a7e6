"""Defocus against range: best focus of each colour and one pupil magnification (thesis §4.5.2, Appendix E)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from labkit.errors import DataError
from labkit.optics.lens import Convention, ThinLens, defocus_slopes, defocus_waves
from labkit.plan import Plan
from labkit.results import Focus, Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

TELLING_STD = 0.02  # pupil magnifications of real lenses lie between 0.5 and 2: with a larger error nothing was learnt
USUAL_MAGNIFICATION_STD = 0.3
LEAST, MOST = 0.05, 20.0  # pupil magnifications that are tried; a fit that ends there has found none
MODEL_FLOOR_WAVES = 2e-4  # RMS error beyond the bound of nine defocus values from an independent simulator
MOST_CHI2 = 4.0  # for each degree of freedom: residuals of twice their errors are warned of
LEAST_SLOPE = 1e-9  # standard errors for a unit of a parameter: less determines nothing
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

    def as_results(self) -> Focus:
        """As results keep it."""
        best = zip(self.channels, self.best_focus_mm, self.std, strict=False)
        return Focus(
            {channel: Uncertain(float(value), float(std), "mm") for channel, value, std in best},
            Uncertain(self.pupil_magnification, float(self.std[-1])),
            self.identifiable,
            {channel: tuple(rest) for channel, rest in self.residual_waves.items()},
            self.covariance,
            self.chi2_per_freedom,
        )

    @property
    def identifiable(self) -> bool:
        """Whether the ranges determine the pupil magnification."""
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

    range_std_mm: standard error of each range, which all colours measured there share; one common to all ranges is not in it.
    Raises DataError where a channel has fewer than two ranges or the points are fewer than the unknowns.
    """
    channels = _channels(points)
    law = _DefocusLaw(points, channels, ThinLens(focal_length_mm, f_number), reference_nm, convention)
    start = [_crossing(*law.of_channel(k), focal_length_mm) for k in range(len(channels))]
    theta0 = np.array([*start, 1.0])
    root = cholesky(law.covariance(theta0, range_std_mm), lower=True)

    def misfit(theta: Floats) -> Floats:
        return np.asarray(solve_triangular(root, law.waves - law.defocus(theta), lower=True))

    def slopes(theta: Floats) -> Floats:
        return np.asarray(solve_triangular(root, -law.jacobian(theta), lower=True))

    solved = least_squares(
        misfit,
        theta0,
        slopes,
        x_scale=np.array([1e-3 * r for r in start] + [0.01]),
        bounds=([1.01 * focal_length_mm] * len(channels) + [LEAST], [np.inf] * len(channels) + [MOST]),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    freedom = len(points) - theta0.size
    chi2 = float(2 * solved.cost / freedom) if freedom > 0 else None
    widened = _covariance(slopes(solved.x)) * max(1.0, chi2 or 1.0)
    residuals = law.residuals(solved.x, channels)
    return FocusFit(channels, solved.x[:-1], float(solved.x[-1]), widened, residuals, chi2, convention)


def _channels(points: Sequence[DefocusPoint]) -> tuple[str, ...]:
    """Each channel once. Raises DataError for one with fewer than two ranges."""
    channels = tuple(dict.fromkeys(p.channel for p in points))
    for name in channels:
        ranges = {p.range_mm for p in points if p.channel == name}
        if len(ranges) < 2:
            raise DataError(
                f"best focus and pupil magnification need at least 2 ranges for each channel; {name} has {len(ranges)}: "
                "photograph the target at more ranges"
            )
    return channels


class _DefocusLaw:
    """Defocus of points by (4.40). theta: best focus of each channel in mm, then the pupil magnification."""

    def __init__(
        self,
        points: Sequence[DefocusPoint],
        channels: Sequence[str],
        lens: ThinLens,
        reference_nm: float,
        convention: Convention,
    ) -> None:
        self.which = np.array([channels.index(p.channel) for p in points])
        self.ranges_mm = np.array([p.range_mm for p in points])
        self.waves = np.array([p.waves for p in points])
        self._std = np.hypot([p.std for p in points], MODEL_FLOOR_WAVES)
        self._lens, self._reference_nm, self._convention = lens, reference_nm, convention

    def of_channel(self, index: int) -> tuple[Floats, Floats]:
        """Ranges and defocus of one channel."""
        return self.ranges_mm[self.which == index], self.waves[self.which == index]

    def defocus(self, theta: Floats) -> Floats:
        """(points,) waves RMS."""
        return defocus_waves(*self._lens_and_ranges(theta), self._reference_nm, self._convention)

    def residuals(self, theta: Floats, channels: Sequence[str]) -> dict[str, list[float]]:
        """Measured less modelled defocus of each channel's points, waves RMS."""
        rest = self.waves - self.defocus(theta)
        return {channel: [float(v) for v in rest[self.which == k]] for k, channel in enumerate(channels)}

    def jacobian(self, theta: Floats) -> Floats:
        """(points, parameters) derivatives of the defocus by theta."""
        _, by_focus, by_pupils = defocus_slopes(*self._lens_and_ranges(theta), self._reference_nm, self._convention)
        of_channel = self.which[:, None] == np.arange(len(theta) - 1)
        return np.column_stack([np.where(of_channel, by_focus[:, None], 0.0), by_pupils])

    def covariance(self, theta: Floats, range_std_mm: float) -> Floats:
        """(points, points) of the measured defocus; the error of a range is common to all colours there."""
        by_range = defocus_slopes(*self._lens_and_ranges(theta), self._reference_nm, self._convention)[0]
        moved = range_std_mm * by_range
        shared = np.outer(moved, moved) * (self.ranges_mm[:, None] == self.ranges_mm)
        return np.asarray(np.diag(self._std**2) + shared)

    def _lens_and_ranges(self, theta: Floats) -> tuple[ThinLens, Floats, Floats]:
        lens = replace(self._lens, pupil_magnification=float(theta[-1]))
        return lens, self.ranges_mm, np.asarray(theta)[:-1][self.which]


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
    convention: Convention = "corrected",
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
        cost = _curve_cost(ranges, signed, errors, lens, reference_nm, convention)
        for mode in others.values():
            turned = np.asarray(mode, float)[order] * signs * as_fitted
            cost += float(np.sum((turned - turned.mean()) ** 2)) / SIGN_FLOOR_WAVES**2
        if cost < best_cost:
            best, best_cost = signs * as_fitted, cost
    result = np.empty(len(order), int)
    result[order] = best.astype(int)
    return [int(s) for s in result]


def _curve_cost(
    ranges: Floats, waves: Floats, errors: Floats, lens: ThinLens, reference_nm: float, convention: Convention
) -> float:
    """Misfit of the best curve, its pupil magnification near 1 as lenses have it."""
    start = _crossing(ranges, waves, lens.focal_length_mm)

    def misfit(theta: Floats) -> Floats:
        own = replace(lens, pupil_magnification=float(theta[1]))
        curve = (waves - defocus_waves(own, ranges, theta[0], reference_nm, convention)) / errors
        return np.append(curve, (theta[1] - 1.0) / USUAL_MAGNIFICATION_STD)

    bounds = ([1.01 * lens.focal_length_mm, LEAST], [np.inf, MOST])
    return float(2 * least_squares(misfit, [start, 1.0], bounds=bounds, x_scale=[1e-3 * start, 0.1]).cost)


def summarise_focus(wavefronts: Sequence[Wavefront], plan: Plan) -> tuple[Focus | None, list[str]]:
    """Best focus over the wavefronts of a session, None where they do not determine one; and warnings, a line each."""
    points = [
        DefocusPoint(w.measured_range_mm, w.channel, w.defocus.value, w.defocus.std)
        for w in wavefronts
        if w.measured_range_mm is not None and w.defocus is not None
    ]
    if not points:
        fitted = any(w.defocus is not None for w in wavefronts)
        return None, [f"no best focus: {'the frames carry no ranges' if fitted else 'defocus was not fitted'}"]
    lens, settings = plan.lens, plan.fit
    try:
        focus = fit_focus(
            points,
            lens.focal_length_mm,
            lens.f_number,
            plan.reference_wavelength_nm,
            settings.convention,
            settings.range_std_mm,
        )
    except DataError as error:
        return None, [f"no best focus: {error}"]
    return focus.as_results(), _warnings(focus)


def _warnings(focus: FocusFit) -> list[str]:
    warnings = []
    if focus.at_limit:
        warnings.append(
            f"no pupil magnification from {LEAST:g} to {MOST:g} fits: defocus does not follow a lens's curve; check the "
            "ranges, the focal length, and the optima that were rejected"
        )
    elif not focus.identifiable:
        warnings.append(
            f"these ranges do not determine the pupil magnification: its standard error is {focus.std[-1]:.3f}; "
            "ranges near the closest focus would"
        )
    if focus.chi2_per_freedom is not None and focus.chi2_per_freedom > MOST_CHI2:
        warnings.append(
            f"defocus departs from the lens's curve by {np.sqrt(focus.chi2_per_freedom):.1f} times its standard "
            "errors; those of best focus and pupil magnification were widened by as much"
        )
    return warnings
