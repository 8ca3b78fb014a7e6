"""Stations whose first optima contradict each other: which are searched at once, and which ends are fitted (all is played)."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.estimation.local import Found
from labkit.estimation.searches import Task
from labkit.estimation.settings import SETTINGS
from labkit.estimation.together import TogetherTask
from tests.optimum_samples import (
    ASTIGMATISM,
    Ends,
    Play,
    optimum,
    played,
    range_of,
    true_values,
)

STRONG = 0.3
"""Waves RMS of astigmatism by which a first search is off at the far end."""


AT_ONCE = [["G at 3200 mm"], ["G at 2900 mm", "G at 3100 mm"]]
"""Fits of one end of a common search: the range farthest from focus first."""


def at_odds(task: Task) -> Found:
    """Optima from nothing that contradict each other; from a start, what the start has, explained if it is the right one."""
    begun, at_end = task.guesses.starts, range_of(task) > 3100.0
    off = float(begun[0][1] - ASTIGMATISM) if begun else STRONG * at_end
    explained = bool(begun) and abs(off) < SETTINGS.other_optimum_waves
    return Found(
        (
            optimum(
                task.optics,
                range_of(task),
                off=(0.0, off),
                height=0.0 if explained else -500.0 - 100.0 * abs(off),
                explained=explained,
            ),
        )
    )


def ended(task: TogetherTask, *astigmatism: float) -> Ends:
    """Ends of a common search, each with an amount of astigmatism."""
    return tuple(
        tuple(np.array([at, amount]) for at in task.defocus) for amount in astigmatism
    )


def test_ends_that_contradict_each_other_are_searched_with_a_range_between() -> None:
    play = Play(at_odds, together=lambda task: ended(task, ASTIGMATISM, 0.0))
    session = played(play)
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
    """Where all agree, the model is poor. An end that is less likely far from focus is fitted there alone."""

    def wrong(task: TogetherTask) -> Ends:
        return tuple(
            tuple(
                np.array([at, -STRONG * (1 + end) + k * scatter])
                for k, at in enumerate(task.defocus)
            )
            for end in range(3)
        )

    play = Play(at_odds, together=wrong)
    played(play)
    assert len(play.common) == 1
    assert play.labels[1 : 1 + len(climbed)] == climbed
    assert play.labels[1 + len(climbed)] not in AT_ONCE
    assert any(task.guesses.deep for batch in play.batches for task in batch)


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
        return (tuple(end),)

    play = Play(gaining, together=together)
    played(play)
    assert any(task.guesses.deep for batch in play.batches for task in batch) == alone
