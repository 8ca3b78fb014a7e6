"""In which order a session's fits are made, and from what each begins; the fits themselves are played."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.analysis.local_fits import PATIENCE_S, Task
from labkit.analysis.observe import Observation
from labkit.analysis.wavefronts import ANCHOR_S, fit_session
from labkit.errors import FitError, LostTasksError
from labkit.estimation.climb import NoisePrior, State
from labkit.estimation.expansion import Measured
from labkit.estimation.residual_tests import Verdict
from labkit.estimation.scores import Call
from labkit.imaging.warp import Pose
from labkit.inference.fit import WavefrontFit
from labkit.plan import Plan
from labkit.target import CellTarget
from tests.lens_samples import covariance, laws
from tests.plans import PORTRAIT

NOISE = NoisePrior(0.5, 0.01, 4.0, 0.02)
TARGET = CellTarget(np.eye(2), (9.0, 9.0), 0.0)
POSE = Pose.from_corners(np.array([[0.0, 0], [0, 9], [9, 9], [9, 0]]), (9.0, 9.0))
LIGHTS = [{"name": name, "wavelength_nm": nm} for name, nm in (("G", 550.0), ("R", 620.0), ("B", 470.0))]
FIT = {"zernike_noll": [4, 4], "reference_wavelength_nm": 550.0}
PLAN = Plan.from_tables({**PORTRAIT, "channel": LIGHTS, "fit": FIT})
RANGES_MM = (2900.0, 3010.0, 3100.0, 3200.0)
FOCUS_MM = 3000.0

Batch = list[Task]


def observations(channels: str = "G") -> list[Observation]:
    return [Observation(r, r, c, ("a.dng",), (), (), NOISE, ((0, 0),), 1) for r in RANGES_MM for c in channels]


def true_values(task: Task) -> Any:
    """Waves, ln cone, ln scale of a lens as engraved."""
    return np.array(laws(task.observation.range_mm, FOCUS_MM, FOCUS_MM, 70.0, 2.8, 1.0))


def as_found(task: Task, settled: bool) -> WavefrontFit:
    """A fit that has found the wavefront, or that has found another when its time was up."""
    values = true_values(task) + (0.0 if settled else np.array([0.3, 0.2, 0.0]))
    spread = covariance(float(values[0]))
    state = State(values[:1], (POSE,), np.ones(1), np.zeros(1), NOISE.centre)
    measured = Measured((4,), values, spread, np.zeros((3, 3)))
    verdict = Verdict(0.5 if settled else 0.0, settled, 0.0, 0.0)
    return WavefrontFit(
        (4,),
        state,
        spread[:1, :1],
        replace(task.optics, f_number=2.8),
        measured,
        measured,
        0.0,
        1.0,
        verdict,
        1,
        (),
        (np.ones(1),),
        0.0,
        cut_short=not settled,
    )


def made(settles: Callable[[Task], bool], channels: str = "G") -> list[Batch]:
    """The batches of tasks that a session is fitted by, where a fit shows if `settles` says so."""
    batches = list[Batch]()

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        if tasks:
            batches.append(list(tasks))
        yield from enumerate(as_found(task, settles(task)) for task in tasks)

    fit_session(observations(channels), PLAN, TARGET, run, lambda done, of, what: None)
    return batches


def ranges(batch: Batch) -> list[float | None]:
    return [task.observation.range_mm for task in batch]


def test_both_ends_come_first_and_predict_the_rest() -> None:
    anchors, rest = made(lambda task: True)
    assert ranges(anchors) == [2900.0, 3200.0]
    assert ranges(rest) == [3010.0, 3100.0]
    assert all(not task.starts and not task.alike for task in anchors)
    for task in rest:
        assert task.starts[0][0] == pytest.approx(true_values(task)[0], abs=7e-4)


def test_one_range_of_a_colour_predicts_its_others() -> None:
    ends, leaders, rest = made(lambda task: True, "GRB")
    assert [task.label for task in ends] == ["G at 2900 mm", "G at 3200 mm"]
    # the shortest wavelength, which takes the longest, first
    assert [task.label for task in leaders] == ["B at 3200 mm", "G at 3010 mm", "G at 3100 mm", "R at 3200 mm"]
    assert [len(task.alike) for task in leaders] == [1, 0, 0, 1]
    assert [task.label for task in rest] == [f"{c} at {r} mm" for c in "BR" for r in (2900, 3010, 3100)]
    for task in rest:
        assert task.starts[0][0] == pytest.approx(true_values(task)[0], abs=7e-4)


def test_colours_of_an_unknown_range_are_fitted_like_the_first() -> None:
    batches = list[Batch]()

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        batches.append(list(tasks))
        yield from enumerate(replace(as_found(at_3_m(task), settled=True), optics=task.optics) for task in tasks)

    def at_3_m(task: Task) -> Task:
        return replace(task, observation=replace(task.observation, range_mm=3000.0))

    unknown = [replace(o, range_mm=None, measured_range_mm=None) for o in observations("GRB")[:3]]
    fit_session(unknown, PLAN, TARGET, run, lambda done, of, what: None)
    first, rest = filter(None, batches)
    assert [task.label for task in first] == ["G"]
    assert [(task.label, len(task.alike)) for task in rest] == [("B", 1), ("R", 1)]


def test_what_a_part_would_gain_is_summed_over_all_fits_once_they_are_there() -> None:
    """It hardly shows far from focus, where the first fits are."""

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for index, task in enumerate(tasks):
            gain = 2.0 if task.observation.range_mm == 3010.0 else 0.1
            calls = {"veil": Call(np.array([np.sqrt(2 * gain)]), np.eye(1))}
            yield index, replace(as_found(task, settled=True), calls=calls)

    tried = fit_session(observations("GRB"), PLAN, TARGET, run, lambda done, of, what: None).tried
    assert [(part.name, part.adopted) for part in tried] == [("veil", False)] * 2
    mean = (9 * np.sqrt(0.1) + 3 * np.sqrt(2.0)) ** 2 / 12
    assert [part.gain for part in tried] == pytest.approx([0.2, mean])


def test_progress_counts_what_is_fitted_again_and_says_what_is_done() -> None:
    said = list[tuple[int, int, str]]()

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        yield from enumerate(as_found(task, settled=task.patience_s > ANCHOR_S) for task in tasks)

    fit_session(observations(), PLAN, TARGET, run, lambda done, of, what: said.append((done, of, what)))
    first = said[0]
    assert first == (0, 4, "searching from nothing: G at 2900 mm, G at 3200 mm")
    # nothing is under way where all is done, and what begins says so: the ends are fitted twice, so that all is more than four
    assert all(done < of for done, of, what in said if ":" in what)
    assert [done for done, _, _ in said] == sorted(done for done, _, _ in said)
    assert said[-1][1] > 4


def test_an_end_that_does_not_show_soon_begins_from_the_other() -> None:
    anchors, again, rest = made(lambda task: task.observation.range_mm != 3200.0 or bool(task.alike))
    assert [task.patience_s for task in anchors] == [ANCHOR_S, ANCHOR_S]
    (task,) = again
    assert ranges(again) == [3200.0]
    # one range tells neither best focus nor which twin is right: its modes are known, defocus is not
    assert task.starts == ()
    assert abs(task.alike[0][0]) == pytest.approx(abs(true_values(anchors[0])[0]))
    assert task.patience_s == PATIENCE_S
    assert all(task.starts for task in rest)


def test_where_neither_end_shows_both_are_searched_for_as_long_as_patience_lasts() -> None:
    batches = made(lambda task: task.patience_s > ANCHOR_S)
    assert [ranges(batch) for batch in batches] == [[2900.0, 3200.0], [2900.0, 3200.0], [3010.0, 3100.0]]
    assert all(task.patience_s == PATIENCE_S and not task.alike for task in batches[1])


def test_of_two_fits_that_disagree_the_likelier_modes_are_found() -> None:
    """Near focus a search ended in another optimum, and was accepted: begun from the other's modes it finds a better one."""
    plan = Plan.from_tables({**PORTRAIT, "fit": {"zernike_noll": [4, 5]}})
    batches = list[Batch]()

    def fitted(task: Task) -> WavefrontFit:
        near = task.observation.range_mm == 3010.0
        wrong = near and not task.alike
        waves, cone, scale = true_values(task)
        values = np.array([waves + 0.1 * wrong, 0.05 - 0.2 * wrong, cone, scale])
        spread = np.diag([0.0, 1e-6, 0.0, 0.0])
        spread[np.ix_([0, 2, 3], [0, 2, 3])] = covariance(float(waves))
        state = State(values[:2], (POSE,), np.ones(1), np.zeros(1), NOISE.centre)
        measured, verdict = Measured((4, 5), values, spread, np.zeros((4, 4))), Verdict(0.5, True, 0.0, 0.0)
        optics = replace(task.optics, f_number=2.8)
        height = -500.0 if wrong else 0.0
        return WavefrontFit(
            (4, 5), state, spread[:2, :2], optics, measured, measured, height, 1.0, verdict, 1, (), (np.ones(1),), 0.0
        )

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        batches.append(list(tasks))
        yield from enumerate(map(fitted, tasks))

    two = [o for o in observations() if o.range_mm in (3010.0, 3200.0)]
    session = fit_session(two, plan, TARGET, run, lambda done, of, what: None)
    assert [f.fit.waves[1] for f in session.fits] == pytest.approx([0.05, 0.05])
    assert session.lens is not None
    assert session.lens.model.shared
    assert [ranges(batch) for batch in batches if batch] == [[3010.0, 3200.0]] * 2


def test_a_fit_whose_process_is_killed_costs_no_other_one() -> None:
    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        killed = [task for task in tasks if task.observation.range_mm == 3010.0]
        for index, task in enumerate(tasks):
            if task not in killed:
                yield index, as_found(task, True)
        if killed:
            raise LostTasksError([(task, "killed") for task in killed])

    fits = fit_session(observations(), PLAN, TARGET, run, lambda done, of, what: None)
    assert [f.task.observation.range_mm for f in fits.fits] == [2900.0, 3100.0, 3200.0]
    assert fits.lost == ("G at 3010 mm is left out: killed; close other programs and fit again",)
    assert fits.lens is not None


def test_where_all_processes_are_killed_it_is_said() -> None:
    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        raise LostTasksError([(task, "killed") for task in tasks])
        yield

    with pytest.raises(
        FitError,
        match="no wavefront could be fitted: G at 2900 mm is left out: killed; close other programs and fit again; G at",
    ):
        fit_session(observations(), PLAN, TARGET, run, lambda done, of, what: None)


def test_fits_that_their_model_does_not_explain_have_its_errors_in_the_session() -> None:
    """All are rejected and vouch for each other, with errors of noise alone ten times too small."""

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for index, task in enumerate(tasks):
            fit = as_found(task, True)
            spread = fit.measured.covariance
            poor = replace(fit.measured, covariance=100 * spread, model=99 * spread)
            yield index, replace(fit, poor=poor, verdict=replace(fit.verdict, accepted=explained))

    stds = []
    for explained in (True, False):
        lens = fit_session(observations(), PLAN, TARGET, run, lambda done, of, what: None).lens
        assert lens is not None
        stds.append(lens.std("best focus", "G"))
        unit = np.eye(len(lens.model.columns))[lens.model.index("best focus", "G")]
        shares = lens.contributions(unit)
        assert (shares["model"] > shares["photons"]) is not explained
    assert stds[1] > 3 * stds[0]
