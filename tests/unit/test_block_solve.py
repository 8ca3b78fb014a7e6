"""Elimination group by group gives what one dense least squares gives: numpy.linalg.lstsq over all columns, stacked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from labkit.estimation.block_solve import Data, Normal, Point, solve
from labkit.estimation.held_out import pulls_of_tiles
from labkit.estimation.laws import FOCUS, MAGNIFICATION
from labkit.estimation.lens_fit import LensFit, Measurements, first_point, fit_lens
from labkit.estimation.lens_model import LensModel
from labkit.estimation.settings import SETTINGS
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.lens_samples import COLOURS, laws, measured, reading, stated

MODES = {7: 0.02}
OUT = 5
"""The observation that is left out."""

Tiles = tuple[tuple[int, int] | None, ...]
KINDS = pytest.mark.parametrize(
    "tiles", [(None,), ((0, 0), (0, 1), (1, 1))], ids=["frames", "tiles"]
)
PLAN = stated(60.0, 4.0, f_number=Uncertain(4.0, 0.12), range_std_mm=0.01, size_std=1e-4)


def sampled(
    tiles: Tiles = (None,), magnification: float = 0.97
) -> tuple[LensModel, Measurements]:
    """Noisy fits of a 60 mm lens at four ranges, in three colours, of each tile; one of them is left out."""
    rng, readings, every = np.random.default_rng(8), [], []
    for k, tile in enumerate(tiles):
        for r in np.linspace(470.0, 494.0, 4).tolist():
            for c, focus_mm in zip(COLOURS, (480.0, 482.0, 485.0), strict=True):
                readings.append(reading(r, c, tile))
                there = laws(r, focus_mm + 0.3 * k, 482.0, 60.0, 4.0, magnification)
                every.append(measured(np.array(there), MODES))
    covariance = np.array([one.covariance for one in every])
    values = np.array(
        [rng.multivariate_normal(one.values, one.covariance) for one in every]
    )
    none = np.zeros_like(covariance)
    used = np.arange(len(every)) != OUT
    return LensModel(tuple(readings), (4, *MODES), (), PLAN), Measurements(
        values, covariance, none, none, used
    )


def stacked(fit: LensFit, unknowns: Floats) -> tuple[Floats, Floats]:
    """(rows, unknowns) slopes and (rows,) misfits, whitened, of data and priors: all columns, then each block's in turn."""
    model, measured = fit.model, fit.measured
    common, blocks, own = (
        len(model.columns),
        len(model.channels),
        len(model.local_columns),
    )
    theta, local = unknowns[:common], unknowns[common:].reshape(blocks, own)
    slopes, own_slopes = map(model.seen, model.slopes(theta, local))
    wide = np.zeros((*slopes.shape[:2], blocks, own))
    wide[np.arange(len(slopes)), :, model.blocks[model.exposures]] = own_slopes
    whole = np.concatenate([slopes, wide.reshape(*slopes.shape[:2], -1)], axis=2)[
        measured.used
    ]
    rest = (measured.values - model.predicted(theta, local))[measured.used]
    noise = measured.covariance[measured.used] + np.diag(model.scatter())
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    columns = [*model.columns, *(model.local_columns * blocks)]
    stds = np.array([column.prior_std for column in columns])
    away = np.array([column.value for column in columns]) - unknowns
    rows = np.concatenate([(whitening @ whole).reshape(-1, len(stds)), np.diag(1 / stds)])
    return rows, np.concatenate([(whitening @ rest[..., None]).ravel(), away / stds])


def flat(point: Point) -> Floats:
    return np.concatenate([point.theta, point.own.ravel()])


def dense_estimate(fit: LensFit) -> Floats:
    """(unknowns,) of least misfit by Gauss and Newton."""
    unknowns = flat(first_point(fit.model, fit.measured))
    for _ in range(20):
        rows, misfits = stacked(fit, unknowns)
        scale = 1 / np.linalg.norm(rows, axis=0)
        unknowns = unknowns + scale * np.linalg.lstsq(rows * scale, misfits)[0]
    return unknowns


def dense_covariance(fit: LensFit) -> Floats:
    """(unknowns, unknowns) about the estimate."""
    rows = stacked(fit, flat(fit.solved.point))[0]
    scale = 1 / np.linalg.norm(rows, axis=0)
    root = np.linalg.lstsq(rows * scale, np.eye(len(rows)))[0] * scale[:, None]
    return np.asarray(root @ root.T)


@KINDS
def test_the_estimate_is_that_of_a_dense_least_squares(tiles: Tiles) -> None:
    fit = fit_lens(*sampled(tiles))
    wanted = dense_estimate(fit)
    off = (flat(fit.solved.point) - wanted) / np.sqrt(np.diag(dense_covariance(fit)))
    # its climb ends within 1e-4; rounding of the misfits adds 2.8e-4 at most over forty starts (tiles' weakest combination)
    assert np.abs(off).max() < 4e-4
    misfits = stacked(fit, wanted)[1]
    # rounding of an information that two tiles of three leave singular
    assert fit.chi2 == pytest.approx(misfits @ misfits, rel=1e-8)


@KINDS
def test_covariances_are_those_of_the_dense_equations(tiles: Tiles) -> None:
    fit = fit_lens(*sampled(tiles))
    covariance, common = dense_covariance(fit), len(fit.theta)
    std = np.sqrt(np.diag(covariance))
    unit = np.outer(std, std)
    off = (
        fit.solved.normal.covariance / unit[:common, :common]
        - (covariance / unit)[:common, :common]
    )
    # the condition number of the tiles, 2e9, times the rounding of a number, 2e-16
    assert np.abs(off).max() < 4e-7
    information = -np.linalg.slogdet(covariance / unit)[1] - 2 * np.log(std).sum()
    assert fit.solved.normal.log_determinant() == pytest.approx(information, rel=1e-9)


@KINDS
def test_the_covariance_of_a_prediction_is_that_of_the_dense_equations(
    tiles: Tiles,
) -> None:
    """Of an observation that is left out: of all columns together, and the scatter of the laws."""
    fit = fit_lens(*sampled(tiles))
    common, own = len(fit.theta), len(fit.model.local_columns)
    places = [
        *range(common),
        *(common + fit.model.blocks[fit.model.exposures[OUT]] * own + np.arange(own)),
    ]
    every = np.concatenate([fit.solved.slopes, fit.solved.own_slopes], axis=2)
    whole = fit.model.seen(every)[OUT]
    expected = whole @ dense_covariance(fit)[np.ix_(places, places)] @ whole.T + np.diag(
        fit.model.scatter()
    )
    std = np.sqrt(np.diag(expected))
    off = (fit.predictions[1][OUT] - expected) / np.outer(std, std)
    assert np.abs(off).max() < 1e-7


@KINDS
def test_what_the_others_predict_is_their_dense_estimate(tiles: Tiles) -> None:
    fit = fit_lens(*sampled(tiles))
    without = replace(
        fit.measured, used=fit.measured.used & (np.arange(len(fit.measured.used)) != 0)
    )
    others = replace(fit, measured=without)
    wanted = dense_estimate(others)
    local = wanted[len(fit.theta) :].reshape(fit.solved.point.own.shape)
    predicted, covariance = fit.predictions
    expected = fit.model.predicted(wanted[: len(fit.theta)], local)[0]
    # what is of second order in the change by one observation: measured 4e-6 and 6e-5
    assert np.abs((predicted[0] - expected) / np.sqrt(np.diag(covariance[0]))).max() < 1e-4


def blocks(rng: np.random.Generator) -> tuple[Normal, Floats]:
    """Random normal equations of three columns in common and two in each of four blocks, and the whole matrix."""
    rows = rng.normal(size=(4, 9, 5))
    whole = np.zeros((11, 11))
    for group, each in enumerate(rows):
        at = [0, 1, 2, 3 + 2 * group, 4 + 2 * group]
        whole[np.ix_(at, at)] += each.T @ each
    own = np.array([whole[k : k + 2, k : k + 2] for k in range(3, 11, 2)])
    cross = np.array([whole[:3, k : k + 2] for k in range(3, 11, 2)])
    return Normal(whole[:3, :3], cross, own), whole


def test_normal_equations_in_blocks_are_solved_as_the_whole_matrix_is() -> None:
    rng = np.random.default_rng(2)
    normal, whole = blocks(rng)
    right = rng.normal(size=11)
    common, own = normal.solve(right[:3], right[3:].reshape(4, 2))
    np.testing.assert_allclose(
        [*common, *own.ravel()], np.linalg.solve(whole, right), rtol=1e-10
    )
    np.testing.assert_allclose(normal.covariance, np.linalg.inv(whole)[:3, :3], rtol=1e-10)
    assert normal.log_determinant() == pytest.approx(np.linalg.slogdet(whole)[1])


def test_damping_grows_the_whole_diagonal() -> None:
    normal, whole = blocks(np.random.default_rng(3))
    damped = whole + 0.3 * np.diag(np.diag(whole))
    np.testing.assert_allclose(
        normal.damped(0.3).covariance, np.linalg.inv(damped)[:3, :3], rtol=1e-10
    )


def test_a_column_that_would_leave_its_bounds_ends_there_and_all_others_follow() -> None:
    rng = np.random.default_rng(4)
    normal, whole = blocks(rng)
    right = rng.normal(size=11)
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    low[1] = np.linalg.solve(whole, right)[1] + 0.1
    common, own = normal.solve_within(right[:3], right[3:].reshape(4, 2), low, high)
    left = np.delete(np.arange(11), 1)
    wanted = np.linalg.solve(
        whole[np.ix_(left, left)], right[left] - whole[left, 1] * low[1]
    )
    np.testing.assert_allclose(
        [*common, *own.ravel()], np.insert(wanted, 1, low[1]), atol=1e-9
    )


def test_an_estimate_at_a_bound_is_the_likeliest_within_it() -> None:
    """Pupils more unlike than a lens has: their magnification stays at the bound, and all else is as likely as it can be."""
    model, of = sampled(magnification=30.0)
    model = replace(model, stated=replace(PLAN, focal_length=Uncertain(60.0, 1e-9)))
    fit = fit_lens(model, of)
    assert fit.value(MAGNIFICATION) == np.log(SETTINGS.magnification_bounds[1])

    def misfits(unknowns: Floats) -> Floats:
        return -stacked(fit, unknowns)[1]

    def slopes(unknowns: Floats) -> Floats:
        return stacked(fit, unknowns)[0]

    bounded = least_squares(
        misfits,
        np.array([column.value for column in model.columns]),
        slopes,
        model.bounds(),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-12,
    )
    assert fit.chi2 == pytest.approx(2 * bounded.cost, rel=1e-6)
    std = np.sqrt(np.diag(fit.solved.normal.covariance))
    assert np.abs((fit.theta - bounded.x) / std).max() < 1e-4


def test_an_estimate_does_not_depend_on_where_it_starts() -> None:
    model, of = sampled()
    data = Data.of(model, of.values, of.covariance + np.diag(model.scatter()), of.used)
    start = first_point(model, of)
    ends = []
    for away in (-20.0, 0.0, 40.0):
        theta = start.theta.copy()
        theta[model.index(FOCUS)] += away
        ends.append(solve(model, data, Point(theta, start.own)))
    std = np.sqrt(np.diag(ends[1].normal.covariance))
    assert (
        max(np.abs((end.point.theta - ends[1].point.theta) / std).max() for end in ends)
        < 1e-4
    )


def test_a_tile_held_out_is_predicted_as_by_a_fit_without_it() -> None:
    model, measured = sampled(((0, 0), (0, 1), (1, 1), (1, 0)))
    lens = fit_lens(model, measured)
    pulls = pulls_of_tiles(lens)
    assert len(pulls) == np.count_nonzero(measured.used)
    rows = [k for k, one in enumerate(model.readings) if one.key.tile == (1, 1)]
    used = measured.used & ~np.isin(np.arange(len(model.readings)), rows)
    others = fit_lens(model, replace(measured, used=used), lens.solved.point)
    predicted, covariance = others.predictions
    for k in rows:
        # predictions include the scatter of the laws, the observation's noise is added
        std = np.sqrt(np.diag(covariance[k] + measured.covariance[k]))
        wanted = (measured.values[k] - predicted[k]) / std / lens.birge_ratio
        # the estimate moves along curves, which the closed form takes as straight
        np.testing.assert_allclose(
            pulls[model.readings[k].key], wanted[: len(model.noll)], atol=0.02
        )
