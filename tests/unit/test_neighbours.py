"""The light of a grid's other targets, against the halo of a point of light."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.analysis.neighbours import halo_of, halo_of_neighbours
from labkit.target.target import CellTarget
from labkit.types import Floats

WHITE = CellTarget(np.ones((3, 3)), (1.0, 1.0))
CUT = slice(0, 40), slice(0, 50)


def square(row: float, column: float, side: float) -> Floats:
    """Corners of a square about a middle, pixels."""
    around = 0.5 * side * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    return np.asarray(around + np.array([row, column]), dtype=np.float64)


def test_a_small_neighbour_far_away_is_a_point_of_light() -> None:
    own, other = square(20.0, 25.0, 30.0), square(20.0, 225.0, 4.0)
    light = halo_of_neighbours(WHITE, {(0, 0): own, (0, 1): other}, (0, 0), CUT)
    rows, columns = np.mgrid[CUT]
    away = np.hypot(rows - 20.0, columns - 225.0)
    # E(r) of a perfect lens falls short of 1 by 2 lambda N / (pi² r): its slope over 2 pi r
    np.testing.assert_allclose(light, 16 / (np.pi * away) ** 3, rtol=1e-3)


def test_only_the_eight_tiles_around_count() -> None:
    near, far = square(20.0, 125.0, 30.0), square(20.0, 225.0, 30.0)
    alone = halo_of_neighbours(WHITE, {(0, 1): near}, (0, 0), CUT)
    both = halo_of_neighbours(WHITE, {(0, 1): near, (0, 2): far}, (0, 0), CUT)
    np.testing.assert_array_equal(alone, both)


@pytest.mark.parametrize("tile", [None, (4, 4)])
def test_without_neighbours_there_is_no_light(tile: tuple[int, int] | None) -> None:
    light = halo_of_neighbours(WHITE, {(0, 0): square(20.0, 25.0, 30.0)}, tile, CUT)
    assert light.shape == (40, 50)
    assert not light.any()


def test_a_dark_target_on_white_takes_light_away() -> None:
    cells = np.array([[1.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    other = square(20.0, 95.0, 30.0)
    bright = halo_of([(CellTarget(cells, (1.0, 1.0)), other)], CUT)
    dark = halo_of([(CellTarget(1 - cells, (1.0, 1.0), surround=1.0), other)], CUT)
    assert bright.min() > 0
    np.testing.assert_allclose(dark, -bright, rtol=1e-9)
