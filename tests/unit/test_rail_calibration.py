"""The rail's zero and direction from ranges measured by hand."""

import numpy as np
import pytest

from labkit.devices.protocols import Travel
from labkit.devices.rail_calibration import (
    find_zero,
    measure,
    misfitting,
    read_range,
    stations,
)
from labkit.errors import DataError, PlanError


@pytest.mark.parametrize("direction", [1, -1])
def test_direction_and_zero_are_found_exactly_where_the_tape_is_exact(
    direction: int,
) -> None:
    at = [-280.0, -150.0, -20.0]
    found = find_zero(at, [3100.0 + direction * mm for mm in at])
    assert found.direction == direction
    assert found.range_at_zero_mm == pytest.approx(3100.0)
    assert found.std_mm == pytest.approx(0.0, abs=1e-9)
    assert found.scale == pytest.approx(1.0)


def test_the_standard_error_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(5)
    at = np.linspace(0, 400, 5)
    trials = [
        find_zero(at.tolist(), (2950 + at + rng.normal(0, 0.5, 5)).tolist())
        for _ in range(1000)
    ]
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
def test_readings_that_tell_no_zero_are_refused(
    at: list[float], ranges: list[float], words: str
) -> None:
    with pytest.raises(DataError, match=words):
        find_zero(at, ranges)


def test_measured_places_lie_along_the_travel_or_where_asked() -> None:
    assert stations(Travel(0, 300), []) == (30, 150, 270)
    assert stations(Travel(0, 300), [5, 200]) == (5, 200)


@pytest.mark.parametrize(
    ("travel", "asked", "words"),
    [
        (Travel(0, 300), [400, 5], "--at 400: the rail goes from 0 to 300 mm"),
        (Travel(0, 300), [5, 5], "two positions or more"),
        (Travel(-1e6, 1e6), [], "does not report its travel"),
    ],
)
def test_places_that_cannot_be_measured_at_are_refused(
    travel: Travel, asked: list[float], words: str
) -> None:
    with pytest.raises(PlanError, match=words):
        stations(travel, asked)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "1.75",
            "1.75 mm is not beyond the focal length, 50 mm; if metres were meant, type 1750",
        ),
        ("50", "not beyond the focal length, 50 mm$"),
        ("a lot", "'a lot' is no range: type a number of mm"),
        ("nan", "is no range"),
    ],
)
def test_what_cannot_be_a_range_is_refused_at_once(text: str, words: str) -> None:
    with pytest.raises(DataError, match=words):
        read_range(text, 50.0)


def test_a_range_may_have_its_unit_and_a_decimal_comma() -> None:
    assert read_range(" 1750,5 mm", 50.0) == 1750.5


def test_the_reading_that_misfits_is_known_by_the_others() -> None:
    at = [30.0, 150.0, 270.0]
    assert misfitting(at, [3030.0, 3150.0, 3270.0]) == ()
    assert misfitting(at, [3030.0, 1150.0, 3270.0]) == (1,)
    assert misfitting(at, [3030.0, 3150.0, 3370.0]) == (2,)
    assert misfitting([0.0, 100.0], [3000.0, 3200.0]) == (0, 1)


def test_with_several_readings_of_one_kind_the_direction_does_not_matter() -> None:
    assert misfitting([30.0, 150.0, 270.0], [3270.0, 3450.0, 3030.0]) == (1,)


class Carriage:
    """A rail that goes wherever it is sent."""

    def __init__(self) -> None:
        self.went: list[float] = []

    def move_to(self, position_mm: float) -> float:
        self.went.append(position_mm)
        return position_mm


def test_only_the_reading_that_misfits_is_asked_for_again() -> None:
    rail, answers, said = Carriage(), iter([3030.0, 1150.0, 3270.0, 3150.0]), list[str]()
    at, ranges = measure(rail, [30.0, 150.0, 270.0], lambda _: next(answers), said.append)  # type: ignore[arg-type]
    assert (at, ranges) == ([30, 150, 270], [3030, 3150, 3270])
    assert rail.went == [30, 150, 270, 150]
    assert said == ["1150 mm at 150 mm: this does not fit the others; once more"]


def test_who_measures_the_same_again_is_not_asked_for_ever() -> None:
    answers, said = iter([3000.0, 3200.0, 3000.5, 3200.5]), list[str]()
    _, ranges = measure(Carriage(), [0.0, 100.0], lambda _: next(answers), said.append)  # type: ignore[arg-type]
    assert ranges == [3000.5, 3200.5]
    assert len(said) == 1
