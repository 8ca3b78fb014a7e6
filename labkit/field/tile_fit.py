"""Least squares for the places of tiles: Gauss-Newton with derivatives by complex steps.

Tiles that contradict the others are set apart and named. Numbers that the tiles do not
determine keep the width of their prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_ratio

from labkit.field.tile_model import (
    BEND,
    CHANNEL_NUMBERS,
    DECENTRE,
    FIFTH,
    HOMOGRAPHY,
    RADIAL,
    SHARED,
    TileModel,
)
from labkit.field.tile_places import usual_covariance
from labkit.types import Bools, Floats, Integers

COMPLEX_STEP = 1e-30
"""Of derivatives by complex steps, which lose no digits however small the step."""

VALUES = 8
"""Of an observation: two of each corner."""

USUAL_DISTORTION = 0.2
"""Prior standard deviation of each term of distortion in the corner of the frame, of the corner's image height."""

USUAL_DECENTRE = 0.2
"""Prior standard deviation of the distortion's centre, of half the frame's diagonal."""

USUAL_CURVATURE_PER_MM = 1e-3
"""Prior standard deviation of a print's curvature: a radius of a metre."""

USUAL_COLOUR = 0.01
"""Prior standard deviation of lateral colour in the corner of the frame, of the corner's image height."""

APART_P = 1e-4
"""Probability that a session without outliers sets any tile apart."""

ITERATIONS, SETTLED_STEP = 30, 1e-4
"""Most steps, and the step, in standard errors, after which the numbers have settled."""

LEAST_SCALE = 1e-16
"""Variance of the corners, px squared, that stands for rounding errors."""


@dataclass(frozen=True, eq=False)
class TileFit:
    """The likeliest numbers of a model.

    Parameters
    ----------
    model : whose numbers
    numbers, covariance : (size,), (size, size), with the residuals' scale in the latter; 0 where not fitted
    residual_px : (n, 8) corners as observed less those of the model
    squares : (n,) of the observations, in their stated covariances
    apart : (n,) observations that contradict the others, and were left out
    scale : variance of the corners over the stated one
    cost : sum of squares of observations and priors
    spare : observations' values less fitted numbers
    """

    model: TileModel
    numbers: Floats
    covariance: Floats
    residual_px: Floats
    squares: Floats
    apart: Bools
    scale: float
    cost: float
    spare: int

    def gain_p_value(self, larger: TileFit) -> float:
        """Return the probability of a gain as large by the further numbers of a larger fit, if all of them are zero.

        The ratio of variances has Fisher's distribution.
        """
        further = self.spare - larger.spare
        if larger.spare <= 0:
            return 1.0
        gained = max(self.cost - larger.cost, 0.0) / further
        left = larger.cost / larger.spare
        return float(f_ratio.sf(gained / left, further, larger.spare)) if left > 0 else 1.0


def fit_tiles(model: TileModel, fitted: Bools, apart: Bools) -> TileFit:
    """Fit the numbers that `fitted` (size,) marks to the observations that `apart` (n,) does not mark."""
    numbers = _start(model)
    whitening = _whitening(model)
    free = np.flatnonzero(fitted)
    known = prior_std(model)[free] ** -2
    spare = VALUES * int((~apart).sum()) - len(free)
    scale = 1.0
    for _ in range(ITERATIONS):
        left, rows = _whitened(model, numbers, whitening)
        scale = _scale(model, left[~apart], spare, scale)
        inside = rows[~apart].reshape(-1, model.size)[:, free]
        covariance = _inverse(inside.T @ inside / scale + np.diag(known))
        slope = inside.T @ left[~apart].ravel() / scale - numbers[free] * known
        step = covariance @ slope
        numbers[free] += step
        if np.all(np.abs(step) <= SETTLED_STEP * np.sqrt(np.diag(covariance))):
            break
    left, _ = _whitened(model, numbers, whitening)
    squares = (left**2).sum(axis=1)
    everywhere = np.zeros((model.size, model.size))
    everywhere[np.ix_(free, free)] = covariance
    cost = float(squares[~apart].sum() + scale * known @ numbers[free] ** 2)
    residual_px = _residual_px(model, numbers)
    return TileFit(
        model, numbers, everywhere, residual_px, squares, apart, scale, cost, spare
    )


def whitened_residuals(fit: TileFit) -> Floats:
    """Return the residuals (n, 8) of a fit, in stated standard errors and independent of each other."""
    left = _whitening(fit.model) @ fit.residual_px[..., None]
    return np.asarray(left[..., 0])


def _scale(model: TileModel, left: Floats, spare: int, before: float) -> float:
    """Return the variance of residuals over the stated one; no less than 1 where all covariances are stated."""
    if spare <= 0:
        return before
    stated = all(p.covariance_px2 is not None for p in model.places)
    return max(float((left**2).sum()) / spare, 1.0 if stated else LEAST_SCALE)


def _inverse(normal: Floats) -> Floats:
    """Return the inverse of a normal matrix, whose numbers may have very different units."""
    root = np.sqrt(np.diag(normal))
    units = np.outer(root, root)
    return np.asarray(np.linalg.inv(normal / units) / units)


def without_outliers(model: TileModel, fitted: Bools) -> TileFit:
    """Fit, and set apart what contradicts the others, in comparison with the median observation.

    No more than a quarter of the observations are set apart.
    """
    apart = np.zeros(len(model.places), bool)
    while True:
        fit = fit_tiles(model, fitted, apart)
        usual = np.median(fit.squares[~apart]) / chi2.median(VALUES)
        largest = chi2.isf(APART_P / len(apart), VALUES) * usual
        wrong = ~apart & (fit.squares > largest)
        if not wrong.any() or 4 * (1 + apart.sum()) > len(apart):
            return fit
        apart = apart.copy()
        apart[np.argmax(np.where(wrong, fit.squares, 0.0))] = True


def chosen(model: TileModel, fifth: bool, bend: bool) -> Bools:
    """Return which numbers (size,) to fit: all but k2 and the print's curvatures, which have to be asked for."""
    fitted = np.ones(model.size, bool)
    shared = fitted[model.shared]
    shared[list(FIFTH)] = fifth
    shared[list(BEND)] = bend
    return fitted


def _residual_px(model: TileModel, numbers: Floats) -> Floats:
    """Return the observed corners (n, 8) less those of the model, px."""
    corners = model.frame.places_px(np.real(model.corners_mm(numbers)))
    observed = np.stack([p.corners_px for p in model.places])
    return np.asarray((observed - corners).reshape(-1, VALUES))


def _whitened(
    model: TileModel, numbers: Floats, whitening: Floats
) -> tuple[Floats, Floats]:
    """Return residuals (n, 8) and the corners' derivatives (n, 8, size), both in standard errors."""
    rows = np.zeros((len(model.places), VALUES, model.size))
    for places in _independent(model):
        moved = numbers.astype(complex)
        moved[places[places >= 0]] += 1j * COMPLEX_STEP
        slope = np.imag(model.corners_mm(moved)).reshape(-1, VALUES) / COMPLEX_STEP
        moves = np.flatnonzero(places >= 0)
        rows[moves, :, places[moves]] = slope[moves]
    rows = rows / (1e-3 * model.frame.pixel_pitch_um)
    left = whitening @ _residual_px(model, numbers)[..., None]
    return left[..., 0], whitening @ rows


def _independent(model: TileModel) -> list[Integers]:
    """Return arrays (n,): for each observation the number to move, -1 for none.

    No observation depends on the homography of another station or the colour of another
    channel, so that one step serves all.
    """
    count = len(model.places)
    found = [HOMOGRAPHY * model.stations + k for k in range(HOMOGRAPHY)]
    found += [np.full(count, model.shared.start + k) for k in range(SHARED)]
    colours = model.shared.stop + CHANNEL_NUMBERS * (model.channel_numbers - 1)
    has = model.channel_numbers > 0
    return found + [np.where(has, colours + k, -1) for k in range(CHANNEL_NUMBERS)]


def _whitening(model: TileModel) -> Floats:
    """Return matrices (n, 8, 8) that turn the observations' errors into independent ones of size one."""
    stated = [
        usual_covariance() if p.covariance_px2 is None else p.covariance_px2
        for p in model.places
    ]
    return np.asarray(np.linalg.inv(np.linalg.cholesky(np.stack(stated))))


def prior_std(model: TileModel) -> Floats:
    """Return the standard deviation (size,) of each number before the photographs; infinite for homographies."""
    corner_mm = model.frame.radius_mm
    std = np.full(model.size, np.inf)
    shared = std[model.shared]
    shared[list(RADIAL)] = USUAL_DISTORTION / corner_mm**2
    shared[list(DECENTRE)] = USUAL_DISTORTION * USUAL_DECENTRE / corner_mm
    shared[list(FIFTH)] = USUAL_DISTORTION / corner_mm**4
    shared[list(BEND)] = USUAL_CURVATURE_PER_MM
    colours = std[model.shared.stop :].reshape(-1, CHANNEL_NUMBERS)
    colours[:] = USUAL_COLOUR * np.array([1.0, corner_mm, corner_mm])
    return std


def _start(model: TileModel) -> Floats:
    """Return numbers (size,) of homographies by linear least squares, without distortion and colour."""
    numbers = np.zeros(model.size)
    for station in range(len(model.ranges_mm)):
        here = np.flatnonzero(model.stations == station)
        on_target = model.target_mm[here, :4].reshape(-1, 2) / model.unit_mm
        seen = np.concatenate(
            [model.frame.heights_mm(model.places[k].corners_px) for k in here]
        )
        numbers[model.homography(station)] = _linear_homography(on_target, seen)
    return numbers


def _linear_homography(from_: Floats, to: Floats) -> Floats:
    """Return the eight numbers of the homography between points (n, 2), by linear least squares."""
    ones = np.ones((len(from_), 1))
    flat = np.concatenate([from_, ones], axis=1)
    none = np.zeros_like(flat)
    down = np.concatenate([flat, none, -to[:, :1] * from_], axis=1)
    right = np.concatenate([none, flat, -to[:, 1:] * from_], axis=1)
    rows = np.concatenate([down, right])
    found, *_ = np.linalg.lstsq(rows, np.concatenate([to[:, 0], to[:, 1]]), rcond=None)
    return np.asarray(found)
