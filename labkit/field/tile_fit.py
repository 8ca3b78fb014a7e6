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
    DEPTHS,
    FIFTH,
    HOMOGRAPHY,
    RADIAL,
    SHARED,
    TILE_GROWTH,
    TileModel,
)
from labkit.field.tile_places import affine_rows, usual_covariances
from labkit.types import Bools, Floats, Integers

COMPLEX_STEP = 1e-30
"""Of derivatives by complex steps, which lose no digits however small the step."""

VALUES = 6
"""Of an observation: the place of a tile's middle, and the linear map about the middle."""

MIDDLE, LINEAR = slice(0, 2), slice(2, 6)

USUAL_DEPTH = 1.0
"""Prior standard deviation of the relative change of depth from the middle of the target to its corner."""

USUAL_DISTORTION = 0.2
"""Prior standard deviation of each term of distortion in the corner of the frame, of the corner's image height."""

USUAL_DECENTRE = 0.2
"""Prior standard deviation of the distortion's centre, of half the frame's diagonal."""

USUAL_CURVATURE_PER_MM = 1e-3
"""Prior standard deviation of a print's curvature: a radius of a metre."""

USUAL_GROWTH = 0.01
"""Prior standard deviation of the tiles' size over that of the plan, at the stated pitch: ink spreads, panels round."""

USUAL_COLOUR = 0.01
"""Prior standard deviation of lateral colour in the corner of the frame, of the corner's image height."""

APART_P = 1e-4
"""Probability that a session without outliers sets any tile apart."""

ITERATIONS, SETTLED_STEP = 30, 1e-4
"""Most steps, and the step, in standard errors, after which the numbers have settled."""

EQUAL_VALUES = 4
"""Values that speak for equal variances of middles and linear maps."""

SETTLED_SCALE = 1e-3
"""Relative change of a variance that has settled."""

LEAST_SCALE = 1e-16
"""Variance of the corners, px squared, that stands for rounding errors."""


@dataclass(frozen=True, eq=False)
class TileFit:
    """The likeliest numbers of a model.

    Parameters
    ----------
    model : whose numbers
    fitted : (size,) numbers fitted
    numbers, covariance : (size,), (size, size), with the residuals' scale in the latter; 0 where not fitted
    pulls : (n, 6) residuals of the tiles' middles and linear maps, in standard errors, independent but for the fit
    residual_px : (n, 8) corners as observed less those of the model
    apart : (n,) observations that contradict the others, and were left out
    spare : observations' values less fitted numbers
    """

    model: TileModel
    fitted: Bools
    numbers: Floats
    covariance: Floats
    pulls: Floats
    residual_px: Floats
    apart: Bools
    spare: int

    def p_value(self, which: Integers) -> float:
        """Return the probability of some numbers as far from zero if all of them are zero: Wald's test, with Fisher's
        distribution."""
        if self.spare <= 0:
            return 1.0
        values = self.numbers[which]
        inverse = _inverse(self.covariance[np.ix_(which, which)])
        square = float(values @ inverse @ values) / len(which)
        return float(f_ratio.sf(square, len(which), self.spare))


def fit_tiles(model: TileModel, fitted: Bools, apart: Bools) -> TileFit:
    """Fit the numbers that `fitted` (size,) marks to the observations that `apart` (n,) does not mark.

    Middles and linear maps of the tiles have each a variance of their own, by what is left
    of them: a print's or a blur's error of size need not be one of place.
    """
    numbers = _start(model)
    whitening = _whitening(model)
    free = np.flatnonzero(fitted)
    known = prior_std(model)[free] ** -2
    scales = np.ones(VALUES)
    for _ in range(ITERATIONS):
        left, rows = _whitened(model, numbers, whitening)
        root = np.sqrt(scales)
        inside = (rows[~apart] / root[:, None])[:, :, free]
        flat = inside.reshape(-1, len(free))
        covariance = _inverse(flat.T @ flat + np.diag(known))
        slope = flat.T @ (left[~apart] / root).ravel() - numbers[free] * known
        step = covariance @ slope
        numbers[free] += step
        bound = np.einsum("nvi,ij,nvj->v", inside, covariance, inside, optimize=True)
        before, scales = scales, _scales(model, left[~apart], bound)
        settled = np.abs(step) <= SETTLED_STEP * np.sqrt(np.diag(covariance))
        if np.all(settled) and np.allclose(scales, before, rtol=SETTLED_SCALE):
            break
    left, _ = _whitened(model, numbers, whitening)
    everywhere = np.zeros((model.size, model.size))
    everywhere[np.ix_(free, free)] = covariance
    return TileFit(
        model,
        fitted,
        numbers,
        everywhere,
        left / np.sqrt(scales),
        _residual_px(model, numbers),
        apart,
        VALUES * int((~apart).sum()) - len(free),
    )


def _scales(model: TileModel, left: Floats, bound: Floats) -> Floats:
    """Return the variance (6,) of residuals (n, 6) over the stated one, for middles and for linear maps.

    bound : (6,) values that the fitted numbers take up. Few values to spare hardly tell the
    two variances apart, which are then alike: each begins with `EQUAL_VALUES` values of the
    variance of both. Where all covariances are stated none is less than 1.
    """
    stated = all(p.covariance_px2 is not None for p in model.places)
    squares = (left**2).sum(axis=0)
    spare = len(left) - bound
    if spare.sum() < 1:
        return np.ones(VALUES)
    both = squares.sum() / spare.sum()
    scales = np.empty(VALUES)
    for part in (MIDDLE, LINEAR):
        total = squares[part].sum() + EQUAL_VALUES * both
        scales[part] = total / (spare[part].sum() + EQUAL_VALUES)
    return np.maximum(scales, 1.0 if stated else LEAST_SCALE)


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
        squares = (fit.pulls**2).sum(axis=1)
        usual = np.median(squares[~apart]) / chi2.median(VALUES)
        largest = chi2.isf(APART_P / len(apart), VALUES) * usual
        wrong = ~apart & (squares > largest)
        if not wrong.any() or 4 * (1 + apart.sum()) > len(apart):
            return fit
        apart = apart.copy()
        apart[np.argmax(np.where(wrong, squares, 0.0))] = True


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
    return np.asarray((observed - corners).reshape(-1, 8))


def _whitened(
    model: TileModel, numbers: Floats, whitening: Floats
) -> tuple[Floats, Floats]:
    """Return residuals (n, 6) and their derivatives (n, 6, size), both in standard errors."""
    rows = np.zeros((len(model.places), 8, model.size))
    for places in _independent(model):
        moved = numbers.astype(complex)
        moved[places[places >= 0]] += 1j * COMPLEX_STEP
        slope = np.imag(model.corners_mm(moved)).reshape(-1, 8) / COMPLEX_STEP
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
    """Return matrices (n, 6, 8) that turn the corners into six values with independent errors of size one."""
    corners = np.stack([p.corners_px for p in model.places])
    covariances = usual_covariances(corners)
    for k, place in enumerate(model.places):
        if place.covariance_px2 is not None:
            covariances[k] = place.covariance_px2
    rows = affine_rows(corners)
    six = rows @ covariances @ rows.swapaxes(1, 2)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(six), rows))


def prior_std(model: TileModel) -> Floats:
    """Return the standard deviation (size,) of each number before the photographs; infinite for linear maps and places."""
    corner_mm = model.frame.radius_mm
    std = np.full(model.size, np.inf)
    for station in range(len(model.ranges_mm)):
        std[model.homography(station)][list(DEPTHS)] = USUAL_DEPTH
    shared = std[model.shared]
    shared[list(RADIAL)] = USUAL_DISTORTION / corner_mm**2
    shared[list(DECENTRE)] = USUAL_DISTORTION * USUAL_DECENTRE / corner_mm
    shared[list(FIFTH)] = USUAL_DISTORTION / corner_mm**4
    shared[list(BEND)] = USUAL_CURVATURE_PER_MM
    shared[list(TILE_GROWTH)] = USUAL_GROWTH
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
        numbers[model.homography(station)] = linear_homography(on_target, seen)
    return numbers


def linear_homography(from_: Floats, to: Floats) -> Floats:
    """Return the eight numbers of the homography between points (n, 2), by linear least squares."""
    ones = np.ones((len(from_), 1))
    flat = np.concatenate([from_, ones], axis=1)
    none = np.zeros_like(flat)
    down = np.concatenate([flat, none, -to[:, :1] * from_], axis=1)
    right = np.concatenate([none, flat, -to[:, 1:] * from_], axis=1)
    rows = np.concatenate([down, right])
    found, *_ = np.linalg.lstsq(rows, np.concatenate([to[:, 0], to[:, 1]]), rcond=None)
    return np.asarray(found)
