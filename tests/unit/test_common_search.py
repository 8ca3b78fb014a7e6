"""Stations whose first optima contradict each other: which are searched at once, and which ends are fitted (all is played)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.local import Found
from labkit.estimation.residuals import Verdict
from labkit.estimation.searches import Task
from labkit.estimation.settings import SETTINGS
from labkit.estimation.together import Ends, TogetherTask
from labkit.imaging.parts.rim import USUAL_SHARE
from tests.optimum_samples import (
    ASTIGMATISM,
    PLAN,
    Play,
    optimum,
    played,
    range_of,
    true_values,
)

CLEAR = PLAN.replace(lens={"obstruction": 0.0})
"""Else a search with an obstruction comes first."""

STRONG = 0.3
"""Waves RMS of astigmatism by which a first search is off at the far end."""


STRENGTHS = {1: (STRONG,), 2: (ASTIGMATISM,)}
"""Of ends of the first and of the second common search."""

UNEXPLAINED = Verdict(0.0, False, 0.0, 0.0)

AT_ONCE = [["G at 3200 mm"], ["G at 2900 mm", "G at 3100 mm"]]
"""Fits of one end of a common search: the range farthest from focus first."""


def at_odds(task: Task) -> Found:
    """Optima from nothing that contradict each other; from a start, what the start has, explained if it is the right one."""
    begun, at_end = task.guesses.starts, range_of(task) > 3100.0
    off = float(begun[0][1] - ASTIGMATISM) if begun else STRONG * at_end
    explained = bool(begun) and abs(off) < SETTINGS.other_optimum_waves
    least = -500.0 if begun else -900.0
    return Found(
        (
            optimum(
                task.optics,
                range_of(task),
                off=(0.0, off),
                height=0.0 if explained else least - 100.0 * abs(off),
                explained=explained,
            ),
        )
    )


def ended(task: TogetherTask, *astigmatism: float) -> Ends:
    """Ends of a common search, each with an amount of astigmatism."""
    return tuple(
        (task.optics, tuple(np.array([at, amount]) for at in task.defocus))
        for amount in astigmatism
    )


def test_ends_that_contradict_each_other_are_searched_with_a_range_between() -> None:
    play = Play(at_odds, together=lambda task: ended(task, ASTIGMATISM, 0.0))
    session = played(play, plan=CLEAR)
    (common,) = play.common
    # the range between is the third of four; defocus is relative to the nearest
    at = [true_values(r)[0] for r in (2900.0, 3100.0, 3200.0)]
    np.testing.assert_allclose(common.defocus, np.subtract(at, at[0]), rtol=0.03)
    assert play.labels[1:4] == [*AT_ONCE, ["G at 3010 mm"]]
    assert all(fit.optimum.verdict.accepted for fit in session.fits)
    assert not any(task.guesses.deep for batch in play.batches for task in batch)


@pytest.mark.parametrize(
    ("scatter", "climbed"),
    [(0.0, AT_ONCE), (STRONG, [*AT_ONCE, *AT_ONCE, AT_ONCE[0]])],
    ids=["ranges agree", "they do not"],
)
def test_ends_of_a_common_search_are_fitted_until_the_ranges_agree(
    scatter: float, climbed: list[list[str]]
) -> None:
    """Where two agree, the model is poor. An end that is less likely far from focus is fitted there alone."""

    def wrong(task: TogetherTask) -> Ends:
        return tuple(
            (
                task.optics,
                tuple(
                    np.array([at, -STRONG * (1 + end) + k * scatter])
                    for k, at in enumerate(task.defocus)
                ),
            )
            for end in range(3)
        )

    play = Play(at_odds, together=wrong)
    played(play, plan=CLEAR)
    assert len(play.common) == 1
    assert play.labels[1 : 1 + len(climbed)] == climbed
    assert play.labels[1 + len(climbed)] not in AT_ONCE
    assert not any(task.guesses.deep for batch in play.batches for task in batch)


def test_no_further_end_is_fitted_where_one_explains_most_ranges() -> None:
    """The nearest range ends elsewhere, and what it lacks may be a part."""

    def mostly(task: Task) -> Found:
        if task.guesses.starts and range_of(task) < 3000.0:
            off = (0.0, STRONG)
            return Found((optimum(task.optics, range_of(task), off=off, explained=False),))
        return at_odds(task)

    play = Play(mostly, together=lambda task: ended(task, ASTIGMATISM, 0.0))
    played(play, plan=CLEAR)
    assert play.labels[1:3] == AT_ONCE
    assert play.labels[3] not in AT_ONCE


@pytest.mark.parametrize(
    ("scatter", "alone"), [(0.0, False), (STRONG, True)], ids=["agree", "do not"]
)
def test_ends_that_gain_and_confirm_nothing_are_no_answer(
    scatter: float, alone: bool
) -> None:
    """None is explained. Where no two agree, something else is missing than modes, and the first stations are searched on."""

    def gaining(task: Task) -> Found:
        begun, at_end = task.guesses.starts, range_of(task) > 3100.0
        off = float(begun[0][1] - ASTIGMATISM) if begun else STRONG * at_end
        height = -100.0 if begun else -500.0
        end = optimum(
            task.optics, range_of(task), off=(0.0, off), height=height, explained=False
        )
        return Found((end,))

    def together(task: TogetherTask) -> Ends:
        end = (np.array([at, k * scatter]) for k, at in enumerate(task.defocus))
        return ((task.optics, tuple(end)),)

    play = Play(gaining, together=together)
    played(play, plan=CLEAR)
    assert any(task.guesses.deep for batch in play.batches for task in batch) == alone


SHARE = 0.2
"""Of the pupil, obstructed."""


def obstructed(task: Task) -> Found:
    """Optima as `at_odds` without an obstruction, of which none is explained; with one, the right ones."""
    if not any(part.name == "obstruction" for part in task.optics.parts):
        (end,) = at_odds(task).optima
        return Found((replace(end, verdict=UNEXPLAINED, log_likelihood=-300.0),))
    return Found((optimum(task.optics, range_of(task), square=SHARE),))


def test_an_obstruction_is_searched_for_before_all_modes() -> None:
    """Its number is known at the range farthest from focus, where the others begin."""
    play = Play(obstructed, together=lambda task: ended(task, ASTIGMATISM))
    session = played(play)
    (common,) = play.common
    assert [part.name for part in common.optics.parts] == ["obstruction"]
    assert play.labels[1:3] == AT_ONCE
    far, others = play.batches[1], play.batches[2]
    begun = [task.optics.parts[0].values for task in (*far, *others)]
    assert begun == [(USUAL_SHARE,), (SHARE,), (SHARE,)]
    for fit in session.fits:
        assert fit.optimum.verdict.accepted
        assert [part.values for part in fit.optimum.optics.parts] == [(SHARE,)]


def test_an_end_no_likelier_far_from_focus_than_the_first_search_is_not_followed() -> None:
    """The first stations are searched on."""

    def no_likelier(task: Task) -> Found:
        (end,) = at_odds(task).optima
        return Found((replace(end, log_likelihood=-500.0),))

    play = Play(no_likelier, together=lambda task: ended(task, STRONG, -STRONG))
    played(play, plan=CLEAR)
    assert play.labels[1:4] == [AT_ONCE[0], AT_ONCE[0], play.labels[0]]
    assert all(task.guesses.deep for task in play.batches[3])


def test_all_modes_are_searched_for_where_an_obstruction_explains_nothing() -> None:
    play = Play(at_odds, together=lambda task: ended(task, *STRENGTHS[len(play.common)]))
    played(play)
    assert [len(task.optics.parts) for task in play.common] == [1, 0]


def behind_an_eye(share: float) -> Play:
    """Optima that are explained with a cat's eye only, with a share of the pupil obstructed."""

    def cut(task: Task) -> Found:
        names = [part.name for part in task.optics.parts]
        if "cats_eye" not in names:
            (end,) = at_odds(task).optima
            return Found((replace(end, verdict=UNEXPLAINED, log_likelihood=-300.0),))
        numbers = np.array([share] * ("obstruction" in names) + [SHARE] * 3)
        return Found((optimum(task.optics, range_of(task), square=numbers),))

    def together(task: TogetherTask) -> Ends:
        (end,) = ended(task, ASTIGMATISM)
        return ((task.pupils[-1], end[1]),)

    return Play(cut, together=together)


@pytest.mark.parametrize("share", [SHARE, 0.0])
def test_an_eye_that_hides_no_obstruction_is_left_to_the_choice_of_parts(
    share: float,
) -> None:
    """A common search climbs with few modes, which do not tell the sides of an eye apart."""
    session = played(behind_an_eye(share))
    parts = {part.name for fit in session.fits for part in fit.optimum.optics.parts}
    assert parts == ({"obstruction", "cats_eye"} if share else set())


def test_with_an_obstruction_cats_eyes_are_searched_for_on_all_sides() -> None:
    """Neither an obstruction nor all modes explain anything. With a cat's eye, ranges begin in the likeliest pupil."""
    play = behind_an_eye(SHARE)
    played(play)
    alone, _, eyes = play.common
    assert alone.pupils == (alone.optics,)
    assert [part.name for part in eyes.optics.parts] == ["obstruction"]
    assert len({one.parts for one in eyes.pupils}) == len(eyes.pupils) == 8
    with_eye = [
        task.optics.parts
        for batch in play.batches
        for task in batch
        if "cats_eye" in {part.name for part in task.optics.parts}
    ]
    assert with_eye[0] == eyes.pupils[-1].parts
