"""Camera parts in the session's loop: in all fits or in none, and what a plain session is told of them. Searches are played."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labkit.estimation.estimate import Estimate, LocalFit
from labkit.estimation.local import Found
from labkit.estimation.scores import ScoreTest
from labkit.estimation.searches import Task
from labkit.plan import Plan
from labkit.results.model import PartTried
from tests.optimum_samples import PLAN, RANGES_MM, Play, optimum, played, range_of

SCORE_TEST = ScoreTest(np.array([20.0]), np.eye(1))
"""A gain of 200 is promised."""


def names(of: Task | LocalFit) -> list[str]:
    """Of the parts of its optics."""
    return [part.name for part in of.optics.parts]


def session(
    height: Callable[[Task], float],
    *,
    plan: Plan = PLAN,
    plain: bool = False,
    explained: Callable[[Task], bool] = lambda task: True,
    part: str = "smear",
) -> tuple[Estimate, Play]:
    """Fits at the two ends that call for a part. height: log-likelihood of a task's optimum."""

    def ends(task: Task) -> Found:
        scores = {} if task.optics.parts else {part: SCORE_TEST}
        made = optimum(
            task.optics,
            range_of(task),
            square=0.5,
            height=height(task),
            explained=explained(task),
            scores=scores,
        )
        return Found((made,))

    play = Play(ends)
    return played(play, ranges_mm=RANGES_MM[::3], plan=plan, plain=plain), play


def by_smear(task: Task) -> float:
    return 100.0 * names(task).count("smear")


def by_obstruction(task: Task) -> float:
    return 100.0 * names(task).count("obstruction")


def test_a_part_that_the_fits_need_is_in_all_of_them() -> None:
    found, play = session(by_smear)
    assert [names(fit) for fit in found.fits] == [["smear"]] * 2
    assert found.tried == (PartTried("smear", 200.0, adopted=True),)
    assert (found.missing, found.with_missing) == ((), ())
    assert found.lens is not None
    assert found.lens.value("part", "smear.rows_px2") == pytest.approx(0.5)
    again = play.batches[1]
    assert [task.guesses.state is not None for task in again] == [True, True]


def test_the_same_session_without_the_parts_that_were_found_is_told_too() -> None:
    found, _ = session(by_smear)
    assert found.stated_camera is not None
    assert [names(fit) for fit in found.stated_camera.fits] == [[], []]
    assert found.stated_camera.lens is not None
    assert found.stated_camera.lens.model.parts == ()


def test_a_camera_that_explains_nothing_without_the_parts_is_not_told_of() -> None:
    found, _ = session(by_smear, explained=lambda task: names(task) == ["smear"])
    assert [names(fit) for fit in found.fits] == [["smear"]] * 2
    assert found.stated_camera is None
    plain, _ = session(
        by_smear, plain=True, explained=lambda task: names(task) == ["smear"]
    )
    assert [names(fit) for fit in plain.fits] == [[], []]


def test_a_pupil_that_was_found_is_the_lens_s_and_no_session_is_made_without_it() -> None:
    found, play = session(by_obstruction, part="obstruction")
    assert [names(fit) for fit in found.fits] == [["obstruction"]] * 2
    assert found.stated_camera is None
    assert [len(batch) for batch in play.batches] == [2, 2]
    plain, _ = session(by_obstruction, part="obstruction", plain=True)
    assert [names(fit) for fit in plain.fits] == [[], []]


def test_a_plain_session_has_no_part_in_the_end_and_the_fits_with_it_beside_it() -> None:
    plain, _ = session(by_smear, plain=True)
    assert [names(fit) for fit in plain.fits] == [[], []]
    assert plain.tried == (PartTried("smear", 200.0, adopted=False),)
    assert plain.missing == ("smear",)
    assert [
        fit and [part.name for part in fit.optics.parts] for fit in plain.with_missing
    ] == [["smear"]] * 2


def test_a_session_whose_parts_gain_nothing_is_not_fitted_without_any() -> None:
    found, _ = session(lambda task: 0.0)
    assert found.stated_camera is None
    assert found.tried == (PartTried("smear", 400.0, adopted=False),)
    assert [names(fit) for fit in found.fits] == [[], []]


def test_a_part_that_the_plan_wants_fitted_stays_where_it_does_nothing() -> None:
    tables = PLAN.model_dump(mode="json", exclude_none=True)
    plan = Plan.from_tables(
        tables | {"sensor": tables["sensor"] | {"low_pass_filter": {"spread_px": "fit"}}}
    )
    found, play = session(lambda task: 1.0, plan=plan)
    assert all(
        names(task) == ["low_pass_filter"] for batch in play.batches for task in batch
    )
    assert [fit.optimum.measured.parts[0] for fit in found.fits] == [
        "low_pass_filter.rows_px2"
    ] * 2
    assert found.stated_camera is None


def test_what_a_part_would_gain_is_summed_over_all_fits_once_they_are_there() -> None:
    """It hardly shows far from focus, where the first fits are."""

    def ends(task: Task) -> Found:
        gain = 2.0 if range_of(task) == 3010.0 else 0.1
        scores = {"veil": ScoreTest(np.array([np.sqrt(2 * gain)]), np.eye(1))}
        return Found((optimum(task.optics, range_of(task), scores=scores),))

    (tried,) = played(Play(ends), "GRB").tried
    assert (tried.name, tried.adopted) == ("veil", False)
    assert tried.gain == pytest.approx((9 * np.sqrt(0.1) + 3 * np.sqrt(2.0)) ** 2 / 12)
