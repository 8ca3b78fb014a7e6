"""What a missing part would move is a bias of the lens; and the fit with it confirms the optimum. Searches are played."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.doubts import confirmed, shift, with_model_error
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Found, Optimum
from labkit.plan import Plan
from tests.lens_samples import best_focus
from tests.optimum_samples import (
    PLAN,
    RANGES_MM,
    Play,
    optimum,
    played,
    range_of,
    true_values,
)

MOVED = 0.004
"""Waves of defocus."""
ENDS = RANGES_MM[::3]
FILTER = "low_pass_filter"
TABLES = PLAN.model_dump(mode="json", exclude_none=True)
FILTERED = Plan.from_tables(
    TABLES | {"sensor": TABLES["sensor"] | {FILTER: {"spread_px": "fit"}}}
)
"""A plan that wants a filter fitted."""


def moved(here: Optimum, range_mm: float) -> Optimum:
    """The fit with its defocus moved, explained."""
    return optimum(here.optics, range_mm, off=(MOVED, 0.0))


@pytest.fixture(scope="module")
def plain() -> Estimate:
    """Two ranges whose fits call for a part that would move defocus at both."""
    found = played(Play(), ranges_mm=ENDS)
    fuller = tuple(moved(fit.optimum, r) for fit, r in zip(found.fits, ENDS, strict=True))
    return replace(found, missing=("smear",), with_missing=fuller)


def test_the_lens_leans_by_what_the_part_would_move(plain: Estimate) -> None:
    biased = with_model_error(plain).lens
    assert plain.lens is not None
    assert biased is not None
    assert biased.bias is not None
    moves = float(biased.model.best_focus("G") @ biased.bias.theta)
    # both ranges' defocus grows by as much: the crossing moves by that over the slope at focus, about that of the chord
    (near, *_), (far, *_) = map(true_values, ENDS)
    assert moves == pytest.approx(-MOVED / ((far - near) / (ENDS[1] - ENDS[0])), rel=0.05)
    assert best_focus(biased, "G").std > abs(moves) > 3 * best_focus(plain.lens, "G").std


def test_all_that_a_fit_measures_counts_as_moved(plain: Estimate) -> None:
    """Modes, cone and size, each by hand."""
    moves = np.array([MOVED, -0.001, 0.002, 1e-4])
    fuller = []
    for fit in plain.fits:
        there = replace(fit.optimum.measured, values=fit.optimum.measured.values + moves)
        state = replace(fit.optimum.state, waves=there.waves)
        fuller.append(replace(fit.optimum, measured=there, state=state))
    assert plain.lens is not None
    biased = with_model_error(replace(plain, with_missing=tuple(fuller))).lens
    solved = plain.lens.solved
    wanted, _ = solved.normal.solve(
        *solved.pulls(solved.data.pulled(np.array([moves, moves])))
    )
    assert biased is not None
    assert biased.bias is not None
    std = np.sqrt(np.diag(plain.lens.errors))
    np.testing.assert_allclose(
        biased.bias.theta / std, wanted / std, atol=0.05
    )  # to first order


def test_a_part_that_gave_way_to_the_missing_one_is_none_there() -> None:
    """Both fits have a filter, 0.2 pixels squared, and none once they have the part that their model lacked."""
    play = Play(lambda task: Found((optimum(task.optics, range_of(task), square=0.2),)))
    found = played(play, ranges_mm=ENDS, plan=FILTERED)
    without = tuple(
        optimum(fit.optics.without([FILTER]), r)
        for fit, r in zip(found.fits, ENDS, strict=True)
    )
    biased = with_model_error(replace(found, missing=("smear",), with_missing=without)).lens
    assert biased is not None
    assert biased.bias is not None
    rows = biased.model.index("part", f"{FILTER}.rows_px2")
    assert biased.theta[rows] == pytest.approx(0.2)
    assert biased.bias.theta[rows] == pytest.approx(-0.2, rel=1e-3)


def test_a_session_that_lacks_nothing_stays_as_it_is(plain: Estimate) -> None:
    whole = replace(plain, with_missing=(None, None))
    assert with_model_error(whole) is whole
    assert not confirmed(whole, 0)


def test_the_nearer_twin_counts(plain: Estimate) -> None:
    here = plain.fits[0].optimum
    modes, cone = shift(here, moved(here, ENDS[0]).twin())
    np.testing.assert_allclose(modes, [MOVED, 0.0], atol=1e-12)
    assert cone == 0.0


def test_an_optimum_is_confirmed_by_a_fit_that_explains_its_frames(plain: Estimate) -> None:
    assert confirmed(plain, 0)
    fuller = plain.with_missing[0]
    assert fuller is not None
    rejected = replace(fuller, verdict=replace(fuller.verdict, accepted=False))
    assert not confirmed(replace(plain, with_missing=(rejected, None)), 0)


def test_an_optimum_is_not_confirmed_by_a_fit_that_ended_elsewhere(plain: Estimate) -> None:
    elsewhere = optimum(plain.fits[0].optics, ENDS[0], off=(0.0, 0.05))
    assert not confirmed(replace(plain, with_missing=(elsewhere, None)), 0)
