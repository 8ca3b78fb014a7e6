"""The compiled spline against scipy's."""

import numpy as np
import pytest
import scipy.ndimage

from labkit.imaging import spline

RASTER = np.random.default_rng(3).normal(size=(90, 70))
ONTO = np.array([[0.61, -0.13, 8.0], [0.09, 0.81, 1.0], [4e-4, -7e-4, 1.0]])
SHAPE = (80, 75)


def places() -> tuple[np.ndarray, np.ndarray]:
    i, j = np.mgrid[: SHAPE[0], : SHAPE[1]]
    y, x, w = np.einsum("ab,bij->aij", ONTO, np.stack([i, j, np.ones(SHAPE)]))
    return y / w, x / w


def test_coefficients_are_scipys() -> None:
    theirs = scipy.ndimage.spline_filter(RASTER, order=5, mode="mirror")
    assert np.abs(spline.coefficients(RASTER) - theirs).max() < 1e-12 * np.abs(theirs).max()


def test_values_are_scipys_where_there_are_six_samples_and_0_elsewhere() -> None:
    y, x = places()
    values = spline.read(spline.coefficients(RASTER), ONTO, SHAPE)
    theirs = scipy.ndimage.map_coordinates(RASTER, np.stack([y, x]), order=5, mode="mirror")
    inside = (y >= 2) & (y < RASTER.shape[0] - 3) & (x >= 2) & (x < RASTER.shape[1] - 3)
    assert 0.5 < inside.mean() < 1
    assert (
        np.abs(values - theirs)[inside].max() < 4e-7 * np.abs(theirs).max()
    )  # 1.8e-7: single precision
    assert not values[~inside].any()


def test_a_spline_goes_through_its_samples_and_holds_fifth_powers() -> None:
    identity = np.eye(3)
    values = spline.read(spline.coefficients(RASTER), identity, RASTER.shape)
    assert np.abs(values - RASTER)[2:-3, 2:-3].max() < 6e-7  # of 4
    t = np.arange(120) / 60 - 1
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    power = spline.read(spline.coefficients(np.outer(t**5, t**5)), half, (119, 119))
    middle = slice(50, 60)  # far from the mirrored borders
    assert power[middle, middle] == pytest.approx(
        np.outer(*[(t[middle] + 1 / 120) ** 5] * 2), abs=2e-15
    )


def test_coefficients_kept_in_single_precision_err_by_less_than_a_spline_does() -> None:
    step = (RASTER > 0).astype(
        np.float64
    )  # black and white: its coefficients overshoot as a target's do not
    kept = spline.along_rows(step).astype(np.float32)
    spline.filter_columns(kept)
    off = spline.read(kept, ONTO, SHAPE) - spline.read(
        spline.coefficients(step), ONTO, SHAPE
    )
    assert np.std(off) < 2e-7
