"""Searches as tasks of a run: several of one observation, and lost ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import Found, Guesses
from labkit.estimation.searches import Searches, Task
from labkit.estimation.stated import optics_of
from labkit.estimation.stray_pixels import StrayPixel
from tests.optimum_samples import PLAN, TARGET, Play, observations, right

SLOW, FAST = (replace(optics_of(PLAN, "G"), f_number=n) for n in (5.6, 1.4))


def searches(play: Play) -> Searches:
    return Searches(observations(), {"G": TARGET}, play, lambda done, of, what: None)


def test_two_searches_of_one_observation_are_under_way_together() -> None:
    def ends(task: Task) -> Found:
        return Found((replace(right(task).best, optics=task.optics),))

    play = Play(ends, order=lambda tasks: range(tasks)[::-1])
    wanted = [(1, SLOW, Guesses()), (1, FAST, Guesses())]
    found = searches(play).each(wanted, "fitting")
    assert [len(batch) for batch in play.batches] == [2]
    assert [one.best.optics for one in found if one] == [SLOW, FAST]


def test_of_two_searches_of_one_observation_one_may_be_lost() -> None:
    def ends(task: Task) -> Found | None:
        return None if task.optics == SLOW else right(task)

    search = searches(Play(ends))
    first, second = search.each([(1, SLOW, Guesses()), (1, FAST, Guesses())], "fitting")
    assert first is None
    assert second is not None
    assert search.left_out == []


def test_an_observation_whose_only_search_is_lost_is_left_out() -> None:
    search = searches(Play(lambda task: None))
    assert search({1: (SLOW, Guesses())}, "fitting") == {}
    assert search.left_out == ["G at 3010 mm is left out: killed"]


def test_stray_pixels_that_a_search_finds_are_left_out_of_later_ones() -> None:
    def ends(task: Task) -> Found:
        strays = (StrayPixel(0, 1, 2, 30.0),) if task.guesses.deep else ()
        return replace(right(task), strays=strays)

    counts = np.ones((3, 4))
    frame = FrameData(counts, counts > 0, counts, 0 * counts)
    play = Play(ends)
    search = searches(play)
    search.observations[1] = replace(search.observations[1], frames=(frame,))
    search({1: (SLOW, Guesses(deep=True))}, "fitting")
    search({1: (SLOW, Guesses(deep=False))}, "fitting")
    _, (later,) = play.batches
    assert np.argwhere(~later.views.value.frames[0].used).tolist() == [[1, 2]]
    assert search.observations[1].frames == later.views.value.frames
