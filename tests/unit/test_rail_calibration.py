"""The rail's zero and direction from ranges measured by hand."""

import numpy as np
import pytest

from labkit.devices.protocols import Travel
from labkit.devices.rail_calibration import find_zero, stops
from labkit.errors import DataError, PlanError


@pytest.mark.parametrize("direction", [1, -1])
def test_direction_and_zero_are_found_exactly_where_the_tape_is_exact(direction: int) -> None:
    at = [-280.0, -150.0, -20.0]
    found = find_zero(at, [3100.0 + direction * mm for mm in at])
    assert found.direction == direction
    assert found.range_at_zero_mm == pytest.approx(3100.0)
    assert found.std_mm == pytest.approx(0.0, abs=1e-9)
    assert found.scale == pytest.approx(1.0)


def test_the_standard_error_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(5)
    at = np.linspace(0, 400, 5)
    trials = [find_zero(at.tolist(), (2950 + at + rng.normal(0, 0.5, 5)).tolist()) for _ in range(1000)]
    zeros = [trial.range_at_zero_mm for trial in trials]
    # 0.5 mm over the root of five; a std of 1000 draws has 2.2 % of relative error: allow four of them
    assert np.std(zeros) == pytest.approx(0.5 / np.sqrt(5), rel=0.09)
    told = [trial.std_mm for trial in trials if trial.std_mm is not None]
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(0.5 / np.sqrt(5), rel=0.09)


def test_two_readings_give_no_standard_error() -> None:
    assert find_zero([0, 100], [3000, 3101]).std_mm is None


@pytest.mark.parametrize(
    ("at", "ranges", "words"),
    [
        ([], [], "0 mm apart"),
        ([10, 12], [3000, 3002], "at least 6 mm apart"),
        ([0, 100, 200], [3000, 3200, 3400], "changed by 2.000 mm for each mm"),
        ([0, 100, 200], [3000, 3010, 3020], "changed by 0.100 mm"),
    ],
)
def test_readings_that_tell_no_zero_are_refused(at: list[float], ranges: list[float], words: str) -> None:
    with pytest.raises(DataError, match=words):
        find_zero(at, ranges)


def test_measured_places_lie_along_the_travel_or_where_asked() -> None:
    assert stops(Travel(0, 300), []) == (30, 150, 270)
    assert stops(Travel(0, 300), [5, 200]) == (5, 200)


@pytest.mark.parametrize(
    ("travel", "asked", "words"),
    [
        (Travel(0, 300), [400, 5], "--at 400: the rail goes from 0 to 300 mm"),
        (Travel(0, 300), [5, 5], "two positions or more"),
        (Travel(-1e6, 1e6), [], "does not report its travel"),
    ],
)
def test_places_that_cannot_be_measured_at_are_refused(travel: Travel, asked: list[float], words: str) -> None:
    with pytest.raises(PlanError, match=words):
        stops(travel, asked)
