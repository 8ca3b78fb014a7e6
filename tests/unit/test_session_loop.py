"""In which order a session's searches are made, and from what each begins; the searches themselves are played."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labkit.errors import FitError
from labkit.estimation.local import Found
from labkit.estimation.observation import Observation
from labkit.estimation.scores import ScoreTest
from labkit.estimation.searches import Task
from labkit.estimation.session import estimate
from labkit.estimation.settings import SETTINGS
from labkit.estimation.split import second_camp
from labkit.plan import Plan
from tests.lens_samples import best_focus
from tests.optimum_samples import (
    PLAN,
    POSE,
    RANGES_MM,
    TARGET,
    Play,
    observations,
    optimum,
    played,
    range_of,
    right,
    true_values,
)

NEAR = 3010.0
"""The range next to focus."""


def test_both_ends_come_first_and_predict_the_rest() -> None:
    play = Play()
    played(play)
    anchors, rest = play.batches
    assert [task.label for task in anchors] == ["G at 2900 mm", "G at 3200 mm"]
    assert [task.label for task in rest] == ["G at 3010 mm", "G at 3100 mm"]
    assert all(task.guesses.starts == task.guesses.modes == () for task in anchors)
    for task in rest:
        (start,) = task.guesses.starts
        np.testing.assert_allclose(start, true_values(range_of(task))[:2], atol=7e-4)


def test_one_range_of_a_colour_predicts_its_others() -> None:
    play = Play()
    played(play, "GRB")
    # the shortest wavelength, which takes the longest, first
    assert play.labels == [
        ["G at 2900 mm", "G at 3200 mm"],
        ["B at 3200 mm", "G at 3010 mm", "G at 3100 mm", "R at 3200 mm"],
        [f"{c} at {r:g} mm" for c in "BR" for r in RANGES_MM[:-1]],
    ]
    leaders, rest = play.batches[1:]
    assert [(len(task.guesses.modes), len(task.guesses.starts)) for task in leaders] == [
        (1, 0),
        (0, 1),
        (0, 1),
        (1, 0),
    ]
    for task in rest:
        assert task.guesses.starts[0][0] == pytest.approx(
            true_values(range_of(task))[0], abs=7e-4
        )


def test_a_climb_begins_at_the_cone_that_the_others_measured() -> None:
    play = Play()
    played(play)
    anchors, rest = play.batches
    assert all(task.guesses.f_number_std > 0.02 for task in anchors)
    for task in rest:
        assert np.log(task.optics.f_number) == pytest.approx(true_values(NEAR)[2], abs=1e-6)
        assert task.guesses.f_number_std == SETTINGS.shared_f_number_std


def test_a_climb_from_a_prediction_begins_at_the_poses_that_another_channel_found() -> None:
    """In the same photographs, whose cuts begin at other pixels."""
    play = Play()
    seen = [
        replace(one, origin_px=(10, 20)) if one.channel == "B" else one
        for one in observations("GB")
    ]
    estimate(seen, PLAN, dict.fromkeys("GB", TARGET), play, lambda done, of, what: None)
    leaders, rest = play.batches[1:]
    assert all(task.guesses.poses == () for task in leaders)
    for task in rest:
        (pose,) = task.guesses.poses
        np.testing.assert_allclose(pose.corners_px(), POSE.corners_px() - [10, 20])


def test_colours_of_an_unknown_range_are_fitted_like_the_first() -> None:
    play = Play(lambda task: Found((optimum(task.optics, 3200.0),)))
    unknown = [
        replace(one, range_mm=None, measured_range_mm=None)
        for one in observations("GRB", (3200.0,))
    ]
    found = estimate(
        unknown, PLAN, dict.fromkeys("GRB", TARGET), play, lambda done, of, what: None
    )
    assert play.labels == [["G"], ["B", "R"]]
    assert [len(task.guesses.modes) for task in play.batches[1]] == [1, 1]
    assert found.lens is None
    assert len(found.fits) == 3


def wrong_at_first(label: str) -> Play:
    """Searches of which one ends in another optimum, whose residuals do not show it, until it begins from a prediction."""

    def ends(task: Task) -> Found:
        wrong = task.label == label and not task.guesses.starts
        off = (0.1, -0.2) if wrong else (0.0, 0.0)
        return Found(
            (optimum(task.optics, range_of(task), off=off, height=-500.0 * wrong),)
        )

    return Play(ends)


@pytest.mark.parametrize(
    ("channels", "label"), [("G", "G at 2900 mm"), ("GB", "B at 3200 mm")]
)
def test_a_wrong_optimum_is_fitted_again_from_the_prediction_and_then_belongs(
    channels: str, label: str
) -> None:
    play = wrong_at_first(label)
    session = played(play, channels)
    (again,) = play.batches[-1]
    assert again.label == label
    truth = true_values(range_of(again))[:2]
    np.testing.assert_allclose(again.guesses.starts[0], truth, atol=7e-4)
    (refitted,) = session.refitted_members
    assert session.fits[refitted].label == label
    np.testing.assert_allclose(session.fits[refitted].optimum.waves, truth)
    assert session.outliers == ()
    assert len(session.members) == len(session.fits)


def test_a_tile_at_a_wrong_optimum_is_fitted_again_before_its_neighbours_begin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        Observation, "place", property(lambda one: (0.0, 0.1 * one.tile[1]))
    )
    tiles = [
        replace(one, tile=(0, column), photograph_px=(100, 300))
        for one in observations("G", RANGES_MM[::3])
        for column in range(3)
    ]
    play = wrong_at_first("G at 3200 mm, tile (0, 0)")
    estimate(tiles, PLAN, {"G": TARGET}, play, lambda done, of, what: None)
    first, again, *_ = play.labels
    assert first == ["G at 2900 mm, tile (0, 0)", "G at 3200 mm, tile (0, 0)"]
    assert set(again) <= set(first)


SMEARED = {"smear": ScoreTest(np.full(3, 15.0), np.eye(3))}
"""A score test that promises a log-likelihood of 340 for a smear."""


def test_a_wrong_optimum_calls_for_no_part_before_it_is_fitted_again() -> None:
    """At 2900 mm, unexplained; with a smear it would gain all that it lacks."""

    def ends(task: Task) -> Found:
        wrong = range_of(task) == RANGES_MM[0] and not task.guesses.starts
        smeared = any(part.name == "smear" for part in task.optics.parts)
        return Found(
            (
                optimum(
                    task.optics,
                    range_of(task),
                    off=(0.1, -0.2) if wrong else (0.0, 0.0),
                    height=-500.0 * (wrong and not smeared),
                    explained=smeared or not wrong,
                    unexplained=500.0 * (wrong and not smeared),
                    scores=SMEARED if wrong and not smeared else {},
                ),
            )
        )

    play = Play(ends)
    session = played(play)
    assert not any(task.optics.parts for batch in play.batches for task in batch)
    assert all(fit.optimum.verdict.accepted for fit in session.fits)
    assert session.outliers == ()


@pytest.mark.parametrize(("range_mm", "early"), [(3200.0, True), (2900.0, False)])
def test_the_other_fits_have_a_part_from_the_start_if_an_anchor_far_from_focus_shows_it(
    range_mm: float, early: bool
) -> None:
    """Of the anchors that at 3200 mm is 1.07 waves from focus, that at 2900 mm 0.59; both are explained."""

    def ends(task: Task) -> Found:
        smeared = any(part.name == "smear" for part in task.optics.parts)
        shown = range_of(task) == range_mm and not smeared
        scores = SMEARED if shown else {"smear": ScoreTest(np.zeros(3), np.eye(3))}
        height = -340.0 * shown
        return Found(
            (
                optimum(
                    task.optics,
                    range_of(task),
                    square=0.5,
                    height=height,
                    scores={} if smeared else scores,
                ),
            )
        )

    play = Play(ends)
    played(play)
    firsts = [task for batch in play.batches for task in batch if range_of(task) == NEAR]
    assert bool(firsts[0].optics.parts) is early


def test_a_fit_that_began_from_the_prediction_and_ended_elsewhere_does_not_belong() -> None:
    def ends(task: Task) -> Found:
        off = (0.1, -0.2) if range_of(task) == NEAR else (0.0, 0.0)
        return Found((optimum(task.optics, range_of(task), off=off),))

    play = Play(ends)
    session = played(play)
    expanded = [[task.guesses.held for task in batch] for batch in play.batches]
    assert expanded[2:] == [[True]]
    assert not any(expanded[0] + expanded[1])
    assert session.outliers == (1,)
    assert session.refitted_members == ()
    assert session.lens is not None
    assert best_focus(session.lens, "G").value == pytest.approx(3000.0, abs=1e-3)


def test_the_less_likely_optimum_of_a_search_is_chosen_where_the_others_predict_it() -> (
    None
):
    def ends(task: Task) -> Found:
        wrong = optimum(task.optics, range_of(task), off=(0.1, -0.2), height=3.0)
        return (
            Found((wrong, *right(task).optima)) if range_of(task) == NEAR else right(task)
        )

    session = played(Play(ends))
    np.testing.assert_allclose(session.fits[1].optimum.waves, true_values(NEAR)[:2])


def test_signs_are_turned_until_defocus_grows_with_range() -> None:
    session = played(
        Play(lambda task: Found((optimum(task.optics, range_of(task)).canonical(),)))
    )
    waves = [fit.optimum.waves[0] for fit in session.fits]
    np.testing.assert_allclose(waves, [true_values(r)[0] for r in RANGES_MM])


def test_a_lone_anchor_leaves_its_sign_open_and_no_prediction_is_sure() -> None:
    """Its nearest neighbour is far from focus by either sign, and is swept; then the sign is known."""
    ranges_mm = (2900.0, 2915.0, 2930.0, 3200.0)
    play = Play(lambda task: None if range_of(task) == ranges_mm[-1] else right(task))
    session = played(play, ranges_mm=ranges_mm)
    (swept,) = play.batches[1]
    assert swept.label == "G at 2915 mm"
    assert swept.guesses.modes
    assert not swept.guesses.starts
    ((predicted,),) = (task.guesses.starts for task in play.batches[2])
    np.testing.assert_allclose(predicted[0], true_values(2930.0)[0], rtol=0.01)
    assert all(fit.optimum.verdict.accepted for fit in session.fits)


def test_where_nothing_is_explained_and_one_range_seen_the_search_goes_deep() -> None:
    """Then no other range tells a wrong optimum."""
    play = Play(
        lambda task: Found(
            (optimum(task.optics, range_of(task), explained=False, unexplained=50.0),)
        )
    )
    played(play, ranges_mm=(3200.0,))
    assert [task.guesses.deep for batch in play.batches for task in batch] == [True]


def test_where_the_ends_contradict_each_other_both_are_searched_further() -> None:
    """Residuals of none are noise: the optima may be wrong, or the model poor."""

    def ends(task: Task) -> Found:
        found = task.guesses.deep or task.guesses.starts
        off = (0.0, 0.0) if found else (0.0, 6.0 * (range_of(task) > 3000))
        return Found(
            (
                optimum(
                    task.optics,
                    range_of(task),
                    off=off,
                    height=100.0 * bool(found),
                    explained=False,
                ),
            )
        )

    play = Play(ends)
    session = played(play)
    assert play.labels[:2] == [["G at 2900 mm", "G at 3200 mm"]] * 2
    assert [[task.guesses.deep for task in batch] for batch in play.batches[:2]] == [
        [False] * 2,
        [True] * 2,
    ]
    assert session.members == (0, 1, 2, 3)


@pytest.mark.parametrize("returns", [0, 1])
def test_ends_that_confirm_each_other_are_searched_no_further_though_the_model_is_poor(
    returns: int,
) -> None:
    """Unless no second start came back to them: then the ends may be wrong, each in the other's way."""

    def unexplained(task: Task) -> Found:
        return Found(
            (optimum(task.optics, range_of(task), explained=False, unexplained=200.0),),
            returns=returns,
        )

    play = Play(unexplained)
    session = played(play)
    assert any(task.guesses.deep for batch in play.batches for task in batch) is (
        returns == 0
    )
    assert session.members == (0, 1, 2, 3)


def test_fits_that_their_model_does_not_explain_have_its_errors_in_the_session() -> None:
    stds = []
    for explained in (True, False):
        lens = played(Play(partial(judged, explained=explained))).lens
        assert lens is not None
        stds.append(best_focus(lens, "G").std)
        shares = lens.contributions(lens.model.best_focus("G"))
        assert (shares["model"] > shares["photons"]) is not explained
    assert stds[1] > 3 * stds[0]


def judged(task: Task, *, explained: bool) -> Found:
    """The right optimum, whose residuals are noise or not."""
    return Found((optimum(task.optics, range_of(task), explained=explained),))


def test_a_camera_number_of_one_channel_is_not_taken_for_another_ones() -> None:
    """The width of red light is fitted, that of green is not: fits begin at the f-number all the same."""
    tables = PLAN.model_dump(mode="json", exclude_none=True)
    lights = [
        light | ({"width_nm": "fit"} if light["name"] == "R" else {})
        for light in tables["channel"]
    ]
    play = Play()
    played(play, "GR", plan=Plan.from_tables(tables | {"channel": lights}))
    later = [task for batch in play.batches[1:] for task in batch]
    assert {len(task.optics.camera_labels) for task in later} == {0, 1}
    for task in later:
        assert np.log(task.optics.f_number) == pytest.approx(
            true_values(range_of(task))[-2], abs=5e-3
        )


@pytest.mark.parametrize(
    ("turned", "agree"), [((2950.0, 3050.0, 3150.0), True), ((3050.0,), False)]
)
def test_outliers_that_follow_a_lens_of_their_own_are_a_second_camp(
    turned: tuple[float, ...], agree: bool
) -> None:
    """The lens was focused anew for some of the ranges: by 0.3 waves, with 0.05 of astigmatism."""

    def ends(task: Task) -> Found:
        off = (-0.3, 0.05) if range_of(task) in turned else (0.0, 0.0)
        return Found((optimum(task.optics, range_of(task), off=off),))

    session = played(Play(ends), ranges_mm=sorted((*RANGES_MM, *turned)))
    assert {session.fits[k].observation.range_mm for k in session.outliers} == set(turned)
    assert session.lens is not None
    assert second_camp(session) is agree


def test_a_search_whose_process_is_killed_costs_no_other_one() -> None:
    session = played(Play(lambda task: None if range_of(task) == NEAR else right(task)))
    assert [fit.observation.range_mm for fit in session.fits] == [2900.0, 3100.0, 3200.0]
    assert session.lost == ("G at 3010 mm is left out: killed",)
    assert session.lens is not None
    assert session.lens.measured.used.tolist() == [True, False, True, True]


def test_where_all_processes_are_killed_it_is_said() -> None:
    with pytest.raises(
        FitError,
        match="no wavefront could be fitted: G at 2900 mm is left out: killed; G at",
    ):
        played(Play(lambda task: None))


def backwards(count: int) -> Sequence[int]:
    return range(count)[::-1]


def shuffled(count: int) -> Sequence[int]:
    order: list[int] = np.random.default_rng(count).permutation(count).tolist()
    return order


@pytest.mark.parametrize("order", [backwards, shuffled])
def test_results_do_not_depend_on_which_search_ends_first(
    order: Callable[[int], Sequence[int]],
) -> None:
    plays = [
        wrong_at_first("B at 3200 mm"),
        replace(wrong_at_first("B at 3200 mm"), order=order),
    ]
    first, other = (played(play, "GRB") for play in plays)
    assert plays[0].labels == plays[1].labels
    assert first.lens is not None
    assert other.lens is not None
    np.testing.assert_array_equal(first.lens.theta, other.lens.theta)
    assert [fit.label for fit in first.fits] == [fit.label for fit in other.fits]


def test_progress_counts_what_is_fitted_again_and_says_what_is_done() -> None:
    said = list[tuple[int, int, str]]()
    play = wrong_at_first("G at 2900 mm")
    estimate(
        observations(),
        PLAN,
        {"G": TARGET},
        play,
        lambda done, of, what: said.append((done, of, what)),
    )
    # how many steps follow the search from nothing is known, how long they take is not
    assert said[0] == (0, 0, "searching from nothing: G at 2900 mm, G at 3200 mm")
    later = [(done, of) for done, of, what in said if not what.startswith("searching")]
    assert later[0] == (2, 5)  # two fits, and the results
    # nothing is under way where all is done, and what begins says so: one is fitted twice, so that all is more than five
    assert all(done < of for done, of in later)
    assert [done for done, _, _ in said] == sorted(done for done, _, _ in said)
    assert said[-1][:2] == (5, 6)
