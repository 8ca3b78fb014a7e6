"""Strehl ratio and MTF through focus against closed forms, the same at one defocus, and drawn wavefronts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from labkit.optics.mtf import Direction, mtf
from labkit.optics.strehl import strehl
from labkit.optics.through_focus import (
    FocusDepth,
    depth_of_focus,
    mtf_through_focus,
    sensor_shift_um,
    strehl_through_focus,
)
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import modes_at
from labkit.types import Floats

NOLL = tuple(range(4, 16))
WAVES = np.array([0.7, 0.05, -0.03, 0.02, -0.03, 0.02, 0.0, 0.03, -0.01, 0.02, 0.01, -0.02])
STD = 0.002
GRID = np.linspace(-0.3, 0.3, 31)


def fitted(waves: Floats = WAVES) -> FittedWavefront:
    return FittedWavefront(
        NOLL, np.asarray(waves, float), STD**2 * np.eye(12), 600.0, 450.0, 2.8
    )


def with_defocus(waves: Floats, defocus: float) -> FittedWavefront:
    return fitted(np.array([defocus, *waves[1:]]))


def depth(waves: Floats = WAVES) -> FocusDepth:
    found = depth_of_focus(fitted(waves), strehl_through_focus(fitted(waves), GRID))
    assert found is not None
    return found


def test_a_perfect_lens_has_the_squared_sinc_and_the_depth_of_its_closed_form() -> None:
    curve = strehl_through_focus(fitted(0 * WAVES), GRID)
    # peak to valley of the phase is sqrt(12) rms: Born and Wolf §8.8.2
    np.testing.assert_allclose(
        curve.value, np.sinc(np.sqrt(12) * GRID * 0.45 / 0.6) ** 2, atol=1e-9
    )
    found = depth(0 * WAVES)
    edge = brentq(lambda x: np.sinc(x) ** 2 - 0.8, 0.1, 0.9) / np.sqrt(12) * 0.6 / 0.45
    assert (found.near.value, found.far.value) == pytest.approx((-edge, edge), rel=1e-3)
    assert found.highest.value == pytest.approx(0.0, abs=1e-6)
    # +- 2 lambda N^2, near enough: a quarter wave of 0.6 um at f/2.8
    assert sensor_shift_um(fitted(), found.span.value) == pytest.approx(
        4 * 0.6 * 2.8**2, rel=0.04
    )


@pytest.mark.parametrize("at", [0, 10, 15, 23, 30])
def test_each_point_is_the_strehl_ratio_of_that_defocus(at: int) -> None:
    curve = strehl_through_focus(fitted(), GRID)
    assert curve.value[at] == pytest.approx(
        strehl(with_defocus(WAVES, GRID[at])).value, abs=1e-7
    )


def test_of_an_image_that_falls_apart_the_highest_maximum_counts_at_every_defocus() -> None:
    split = np.array([0.0, 0.35, 0.02, 0.01, 0.03, 0.01, -0.02, 0.09, 0.0, -0.14, 0.0, 0.0])
    x, y = np.mgrid[-1:1:65j, -1:1:65j]
    inside = x**2 + y**2 < 1
    modes = modes_at(NOLL, x[inside], y[inside])
    tilts = np.mgrid[-2:2:41j, -2:2:41j].reshape(
        2, -1
    )  # of all places of the image, pi a step at the rim at most
    thrown = np.exp(2j * np.pi * tilts.T @ np.array([x[inside], y[inside]]))
    grid = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])
    waves = np.array([[d, *split[1:]] for d in grid]) * 0.45 / 0.6
    highest = np.max(
        np.abs(thrown @ np.exp(2j * np.pi * waves @ modes).T / inside.sum()) ** 2, axis=0
    )
    assert strehl_through_focus(fitted(split), grid).value == pytest.approx(
        highest, rel=0.03
    )  # samples miss so much


@pytest.mark.parametrize("direction", ["x", "y", 30.0])
def test_each_point_is_the_mtf_of_that_defocus(direction: Direction | float) -> None:
    curve = mtf_through_focus(fitted(), 80.0, direction, GRID)
    for k in (0, 15, 23):
        one = mtf(with_defocus(WAVES, GRID[k]), 80.0, direction)
        assert curve.value[k] == pytest.approx(float(one.value), abs=1e-8)
    focused = mtf(fitted().without((4,)), 80.0, direction)
    assert curve.std[15] == pytest.approx(float(focused.std), rel=1e-6)


@pytest.mark.slow
def test_errors_are_slopes_times_the_errors_of_the_modes() -> None:
    step, here = 1e-4, depth()
    moved = [depth(WAVES + step * (np.arange(12) == mode)) for mode in range(1, 12)]
    for name in ("near", "far", "highest", "span"):
        slopes = [
            (getattr(one, name).value - getattr(here, name).value) / step for one in moved
        ]
        # differences to one side, and a spline between points: some per cent
        assert getattr(here, name).std == pytest.approx(
            STD * float(np.linalg.norm(slopes)), rel=0.03
        )


def test_a_curve_that_ends_within_the_depth_of_focus_has_none() -> None:
    assert (
        depth_of_focus(
            fitted(), strehl_through_focus(fitted(), np.linspace(-0.02, 0.02, 9))
        )
        is None
    )
