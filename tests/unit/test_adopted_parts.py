"""Which parts of a camera a session takes in: those that its fits need, not those that only led elsewhere. Fits are played."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labkit.analysis.local_fits import LocalFit, Task
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.wavefronts import fit_session
from labkit.estimation.scores import Call
from labkit.inference.fit import WavefrontFit
from labkit.plan import Plan
from tests.plans import PORTRAIT
from tests.unit.test_wavefronts import TARGET, as_found, observations

PLAN = Plan.from_tables({**PORTRAIT, "fit": {"zernike_noll": [4, 4]}})
CALL = Call(np.array([20.0]), np.eye(1))  # a gain of 200 is promised


def weaker(call: Call) -> Call:
    """By another, with a gain smaller by a tenth."""
    return Call(0.9**0.5 * call.slope, call.information)


def with_parts(fit: WavefrontFit, task: Task, square: float) -> WavefrontFit:
    """The fit with the numbers of its task's parts, all alike and known to 0.01."""
    labels = task.optics.shape_labels
    inserted = np.full(len(labels), 1)
    values = np.insert(fit.measured.values, inserted, square)
    covariance = np.diag(np.insert(np.diag(fit.measured.covariance), inserted, 1e-4))
    others = [0, *range(1 + len(labels), len(values))]
    covariance[np.ix_(others, others)] = fit.measured.covariance
    measured = replace(fit.measured, values=values, covariance=covariance, calibration=0 * covariance, parts=labels)
    return replace(fit, measured=measured, poor=measured)


def session(
    objective: Callable[[Task, bool], float], square: float, plan: Plan = PLAN, diagnose: bool = True
) -> SessionFits:
    """Fits at two ranges. objective: of a task, and of whether it begins at the end of another; square: of their parts."""

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for index, task in enumerate(tasks):
            reached = objective(task, tuple(task.starts) != () and task.missing == ())
            found = with_parts(as_found(task, True), task, square)
            call = CALL if reached <= 0 else Call(0 * CALL.slope, CALL.information)
            calls = dict.fromkeys(("low_pass_filter", "diffusion"), weaker(call)) | {"smear": call}
            yield index, replace(found, objective=reached, calls={} if task.optics.parts else calls)

    return fit_session(observations()[::3], plan, TARGET, run, lambda done, of, what: None, diagnose=diagnose)


def names(of: Task | LocalFit) -> list[str]:
    """Of the parts of its optics."""
    return [part.name for part in (of.optics if isinstance(of, Task) else of.fit.optics).parts]


def adopted(fits: SessionFits) -> list[str]:
    return [tried.name for tried in fits.tried if tried.adopted]


def test_a_part_that_only_led_to_a_better_optimum_is_not_taken_in() -> None:
    """Both first fits are wrong by 100; begun with a smear they end at the right optimum, where the smear does nothing."""
    fits = session(lambda task, again: 100.0 if again else 0.0, square=0.005)
    assert adopted(fits) == []
    assert all(local.fit.measured.parts == () for local in fits.fits)
    assert [local.fit.objective for local in fits.fits] == [100.0, 100.0]


def test_a_part_that_the_fits_need_is_taken_in() -> None:
    fits = session(
        lambda task, again: 100.0 * names(task).count("smear") + 90.0 * ("low_pass_filter" in names(task)), square=0.5
    )
    assert adopted(fits) == ["smear"]
    assert [names(local) for local in fits.fits] == [["smear"]] * 2


def test_a_plain_session_has_no_part_in_the_end_and_the_fits_with_it_beside_it() -> None:
    def reached(task: Task, again: bool) -> float:
        return 100.0 * names(task).count("smear")

    whole, plain = session(reached, square=0.5), session(reached, square=0.5, diagnose=False)
    assert [names(local) for local in plain.fits] == [[], []]
    assert adopted(plain) == []
    assert plain.missing == ("smear",)
    assert [names(local) for local in plain.with_missing if local] == [["smear"]] * 2
    assert [local.task.patience_s for local in plain.fits] == [0.0, 0.0]  # climbed from there, not sought
    assert (whole.missing, whole.with_missing) == ((), (None, None))
    assert whole.without_found is not None
    assert [names(local) for local in whole.without_found.fits] == [[], []]


def test_a_session_that_calls_for_no_part_is_not_fitted_without_any() -> None:
    assert session(lambda task, again: 1.0, square=0.5).without_found is None


def test_a_part_that_is_called_for_and_gains_too_little_is_named_with_the_fits_that_have_it() -> None:
    fits = session(lambda task, again: -1.0 + 2.0 * ("smear" in names(task)), square=0.5)
    assert adopted(fits) == []
    assert fits.missing == ("smear",)
    assert [names(local) for local in fits.with_missing if local] == [["smear"]] * 2


def test_a_more_common_part_takes_the_place_of_one_that_explains_no_more() -> None:
    """Slopes called for a smear; with it, or with a filter, all is explained alike."""
    fits = session(
        lambda task, again: 100.0 * ("smear" in names(task)) + 99.0 * ("low_pass_filter" in names(task)), square=0.5
    )
    assert adopted(fits) == ["low_pass_filter"]
    assert [names(local) for local in fits.fits] == [["low_pass_filter"]] * 2


def test_two_more_common_parts_take_the_place_of_one_that_explains_less() -> None:
    gains = {
        ("low_pass_filter",): 90.0,
        ("diffusion",): 80.0,
        ("smear",): 100.0,
        ("low_pass_filter", "diffusion"): 101.0,
    }
    fits = session(lambda task, again: gains.get(tuple(names(task)), 0.0), square=0.5)
    assert adopted(fits) == ["low_pass_filter", "diffusion"]
    assert [names(local) for local in fits.fits] == [["low_pass_filter", "diffusion"]] * 2
    gains["low_pass_filter", "diffusion"] = 99.0  # of as many numbers: no reason to change
    assert adopted(session(lambda task, again: gains.get(tuple(names(task)), 0.0), square=0.5)) == ["smear"]


def test_a_part_is_held_against_more_common_ones_again_when_another_was_taken_in() -> None:
    """Without the veil a smear explained more than a filter with diffusion does."""
    gains = {
        ("smear",): 100.0,
        ("smear", "veil"): 200.0,
        ("low_pass_filter", "diffusion"): 99.0,
        ("veil", "low_pass_filter", "diffusion"): 250.0,
    }

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for index, task in enumerate(tasks):
            found = with_parts(as_found(task, True), task, 0.5)
            calls = {name: CALL if name == "smear" else weaker(CALL) for name in ("smear", "veil")}
            for name in names(task):
                calls.pop(name, None)
            reached = gains.get(tuple(names(task)), 0.0)
            yield index, replace(found, objective=reached, calls=calls if reached < 250 else {})

    fits = fit_session(observations()[::3], PLAN, TARGET, run, lambda done, of, what: None)
    assert [names(local) for local in fits.fits] == [["veil", "low_pass_filter", "diffusion"]] * 2
    assert [tried.name for tried in fits.tried if tried.adopted] == ["veil", "low_pass_filter", "diffusion"]


def test_a_part_whose_numbers_are_within_their_errors_is_not_taken_in() -> None:
    fits = session(lambda task, again: 100.0 if task.optics.parts else 0.0, square=0.005)
    assert adopted(fits) == []
    assert [local.fit.optics.parts for local in fits.fits] == [(), ()]


def test_what_fits_say_counts_once_while_they_stay_as_they_are() -> None:
    """The model explains neither of them; both are the first fits and all there are."""

    def run(function: Any, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for index, task in enumerate(tasks):
            yield index, replace(as_found(task, False), calls={"veil": Call(np.array([0.0]), np.eye(1))})

    fits = fit_session(observations()[::3], PLAN, TARGET, run, lambda done, of, what: None)
    assert [tried.name for tried in fits.tried] == ["veil"]


def test_a_part_that_the_plan_wants_fitted_stays_where_it_does_nothing() -> None:
    sensor = {**PORTRAIT["sensor"], "low_pass_filter": {"spread_px": "fit"}}
    plan = Plan.from_tables({**PORTRAIT, "sensor": sensor, "fit": {"zernike_noll": [4, 4]}})
    fits = session(lambda task, again: 1.0, square=0.005, plan=plan)
    assert all(local.fit.measured.parts[0].startswith("low_pass_filter") for local in fits.fits)
