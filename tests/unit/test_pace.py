"""Time left: by the steps that are done, counted down, never nothing while there is more."""

import numpy as np
import pytest

from labkit.jobs.pace import Pace, in_words


def test_no_time_is_named_before_a_step_is_done() -> None:
    pace = Pace()
    assert pace.left_s(0.0) is None
    pace.at(2, 13, 0.0)  # two were there already
    assert pace.left_s(90.0) is None
    pace.at(3, 13, 100.0)
    assert pace.left_s(100.0) == 1000.0


def test_time_left_falls_all_the_time_and_never_to_nothing() -> None:
    pace = Pace()
    pace.at(0, 13, 0.0)
    pace.at(5, 13, 50.0)  # 10 s each; the sixth takes ten times as long
    left = [pace.left_s(50.0 + t) or 0.0 for t in range(100)]
    assert left[0] == 80.0
    assert np.all(np.diff(left) < 0)
    assert np.diff(left)[0] == pytest.approx(
        -1, abs=0.06
    )  # at first as a clock does: exp(-0.1) is 0.905
    assert min(left) > 70.0  # seven more steps


def test_a_last_step_that_takes_longer_than_others_leaves_a_time_that_nobody_knows() -> (
    None
):
    pace = Pace()
    pace.at(0, 2, 0.0)
    pace.at(1, 2, 10.0)
    left = [pace.left_s(10.0 + t) for t in range(50)]
    assert left[0] == 10.0
    # never "1 s" for 40 s: at exp(-1) of a step it is known no longer
    assert min(one for one in left if one is not None) == pytest.approx(10 * np.exp(-1))
    assert left[11:] == [None] * 39
    pace.at(2, 2, 61.0)
    assert pace.left_s(61.0) is None


def test_time_on_hold_counts_for_nothing() -> None:
    pace = Pace()
    pace.at(0, 10, 0.0)
    pace.at(1, 10, 2.0)
    pace.hold(2.0)
    assert pace.left_s(100.0) is None
    pace.go_on(1002.0)
    assert pace.left_s(1002.0) == 18.0
    pace.at(2, 10, 1004.0)
    assert pace.left_s(1004.0) == 16.0


def test_more_steps_than_thought_are_more_time() -> None:
    pace = Pace()
    pace.at(0, 2, 0.0)
    pace.at(1, 2, 10.0)
    pace.at(2, 5, 20.0)
    assert pace.left_s(20.0) == 30.0


def test_steps_that_took_long_at_first_are_forgotten() -> None:
    pace = Pace()
    pace.at(0, 20, 0.0)
    pace.at(1, 20, 120.0)
    for done in range(2, 13):
        pace.at(done, 20, 120.0 + done)
    # the later half of twelve steps: 1 s each; the mean of all would leave 88 s
    assert pace.left_s(132.0) == 8.0


def test_no_time_is_named_for_steps_whose_number_is_not_known() -> None:
    pace = Pace()
    pace.at(0, 0, 0.0)
    pace.at(1, 0, 60.0)
    assert pace.left_s(60.0) is None
    pace.at(2, 9, 100.0)  # what follows takes a pace of its own
    assert pace.left_s(101.0) is None
    pace.at(3, 9, 101.0)
    assert pace.left_s(101.0) == 6.0


def test_another_count_begins_anew() -> None:
    pace = Pace()
    pace.at(0, 3, 0.0)
    pace.at(3, 3, 3.0)
    pace.at(0, 15, 4.0)
    assert pace.left_s(90.0) is None


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "1 s"),
        (89.0, "89 s"),
        (90.0, "1 min 30 s"),
        (180, "3 min"),
        (1000, "17 min"),
        (5399, "1 h 30 min"),
    ],
)
def test_times_are_said_as_people_say_them(seconds: float, words: str) -> None:
    assert in_words(seconds) == words
