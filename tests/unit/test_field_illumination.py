"""Relative illumination by flats, against the law that made them."""

import numpy as np
import pytest

from labkit.field.illumination import measure_illumination
from labkit.optics.field import FieldFrame
from labkit.types import Floats

FRAME = FieldFrame((512, 768), 5.2)
GREEN = [(slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))]
CORNERS = np.array([[0, 0], [0, 767], [511, 767], [511, 0]])


def law(places_px: Floats) -> Floats:
    """Return cos⁴ of a wide lens whose light is centred 0.3 mm to the right, relative."""
    away = FRAME.heights_mm(places_px) - [0.0, 0.3]
    return np.asarray((1 + (away**2).sum(axis=-1) / 6.0**2) ** -2)


def a_flat(rng: np.random.Generator, mean: float = 8000.0) -> Floats:
    places = np.stack(np.meshgrid(np.arange(512.0), np.arange(768.0), indexing="ij"), -1)
    return rng.poisson(mean * law(places)).astype(float)


def test_the_light_at_each_place_is_that_of_the_law() -> None:
    rng = np.random.default_rng(1)
    centre = law(FRAME.centre_px)
    places = rng.uniform([0, 0], [511, 767], (200, 2))
    found = measure_illumination(a_flat(rng), GREEN, 5.2)
    percent, _ = found.percent(places)
    assert np.abs(percent - 100 * law(places) / centre).max() < 0.1
    corners, errors = found.corners_percent
    assert np.abs(corners - 100 * law(CORNERS) / centre).max() < 0.1
    assert np.all((errors > 0.02) & (errors < 0.1))
    value, error = found.percent(FRAME.centre_px)
    assert value == pytest.approx(100)
    assert error == pytest.approx(0, abs=1e-9)
    assert found.lit_share == 1


def test_pulls_are_unit_normal() -> None:
    """20 flats; the four corners of each are nearly independent."""
    pulls = []
    for seed in range(20):
        found = measure_illumination(a_flat(np.random.default_rng(seed)), GREEN, 5.2)
        percent, errors = found.corners_percent
        pulls.append((percent - 100 * law(CORNERS) / law(FRAME.centre_px)) / errors)
    # the std of 80 pulls has 8 % of error: three of them
    assert np.std(pulls) == pytest.approx(1, abs=0.24)
    assert abs(np.mean(pulls)) < 0.35


def test_two_greens_of_different_gain_have_one_illumination() -> None:
    flat = a_flat(np.random.default_rng(2))
    one = measure_illumination(flat, GREEN, 5.2).corners_percent[0]
    flat[GREEN[1]] *= 1.05
    other = measure_illumination(flat, GREEN, 5.2).corners_percent[0]
    assert other == pytest.approx(one, abs=0.02)


def test_places_without_light_have_large_errors() -> None:
    flat = a_flat(np.random.default_rng(3))
    flat[:, 500:] = np.nan
    found = measure_illumination(flat, GREEN, 5.2)
    assert found.lit_share == pytest.approx(500 / 768, abs=0.03)
    _, errors = found.corners_percent
    assert errors[1] > 5 * errors[0]


def test_a_dark_flat_is_refused() -> None:
    flat = np.full((512, 768), np.nan)
    flat[:40, :40] = 100
    with pytest.raises(ValueError, match="lit blocks"):
        measure_illumination(flat, GREEN, 5.2)
