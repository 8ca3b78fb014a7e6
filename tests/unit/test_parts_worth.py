"""What parts and modes are worth to a session's fits, and what they cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from labkit.estimation.camera import (
    Fitted,
    Parts,
    chance_gain,
    cost,
    extended,
    summed_score_tests,
    wald_losses,
)
from tests.lens_samples import MODE_STD, measured
from tests.optimum_samples import optimum
from tests.unit.test_camera_choice import OPTICS, Fits, score_test, with_scores


def test_fits_add_up_what_they_call_for() -> None:
    both = summed_score_tests([("G", with_scores(veil=4.0)), ("R", with_scores(veil=4.0))])
    assert both["veil"].gain == pytest.approx(8.0)
    against = optimum(OPTICS, 3200.0, scores={"veil": score_test(4.0, -1.0)})
    assert (
        summed_score_tests([("G", with_scores(veil=4.0)), ("G", against)])["veil"].gain
        == 0.0
    )


def test_each_channel_has_a_spectrum_of_its_own() -> None:
    fits = [
        ("G", with_scores(spectrum=4.0)),
        ("G", with_scores(spectrum=4.0)),
        ("R", with_scores(spectrum=9.0)),
    ]
    (both,) = summed_score_tests(fits).values()
    np.testing.assert_allclose(both.step, np.sqrt([8.0, 18.0]))
    assert both.gain == pytest.approx(8.0 + 9.0)


def test_parts_that_some_fits_were_not_asked_about_are_not_summed() -> None:
    assert [
        *summed_score_tests(
            [("G", with_scores(veil=4.0, smear=1.0)), ("G", with_scores(smear=1.0))]
        )
    ] == ["smear"]


def test_modes_are_summed_over_the_fits_that_were_tested_for_them() -> None:
    with_modes = with_scores(veil=3.0, modes_16_21=9.0)
    tests = summed_score_tests([("G", with_scores(veil=3.0)), ("G", with_modes)])
    assert {name: test.gain for name, test in tests.items()} == pytest.approx(
        {"veil": 6.0, "modes_16_21": 9.0}
    )


def test_what_no_camera_has_gains_nothing() -> None:
    assert score_test(1000.0, -1.0).gain == 0.0  # a camera that swallows stray light


def test_the_worth_of_parts_is_the_misfit_of_their_numbers() -> None:
    of = optimum(
        OPTICS.with_parts(["low_pass_filter"]).with_parts(["diffusion"]), 3200.0
    ).measured
    values = of.values.copy()
    values[2:5] = 0.01, -0.01, 0.04  # known to 0.01 each
    fits = [replace(of, values=values)] * 2
    assert wald_losses(fits) == pytest.approx({"low_pass_filter": 2.0, "diffusion": 16.0})


def test_modes_are_worth_what_they_have_in_common() -> None:
    of = measured(np.zeros(3), dict.fromkeys(range(16, 22), MODE_STD))
    # each number is one standard error
    assert wald_losses([of]) == pytest.approx({"modes_16_21": 3.0})
    assert wald_losses([of] * 4) == pytest.approx({"modes_16_21": 4 * 3.0})
    opposite = replace(of, values=-of.values)
    assert wald_losses([of, opposite] * 2) == pytest.approx({"modes_16_21": 0.0})


def test_a_rarer_part_costs_more_than_a_commoner_one_that_blurs_alike() -> None:
    plain, diffusion, smear = (
        cost(Parts([name])) for name in ("low_pass_filter", "diffusion", "smear")
    )
    assert cost(Parts(["veil"])) == plain == chance_gain(2)
    assert diffusion == smear == plain + 4.5
    assert cost(Parts(["veil", "diffusion"])) == plain + diffusion


@pytest.mark.parametrize("numbers", [1, 2, 6, 13])
def test_numbers_that_are_not_there_gain_their_cost_once_in_20_000_sessions(
    numbers: int,
) -> None:
    tail = stats.chi2(numbers).sf(2 * chance_gain(numbers))
    assert tail == pytest.approx(1 / 20_000, rel=1e-6)


def test_modes_of_several_orders_cost_what_as_many_numbers_of_one_group_do() -> None:
    lower, both = Parts(["modes_16_21"]), Parts(["modes_16_21", "modes_22_28"])
    assert cost(lower) == chance_gain(6)
    assert cost(both) == pytest.approx(chance_gain(13))
    # one more number, of which 22 together would cost 0.8 more than 21
    three = extended(both, "modes_29_36")
    assert cost(extended(three, "modes_37_37")) == pytest.approx(cost(three) + 4.5)
    assert extended(Parts(["veil"]), "modes_22_28") == both | {"veil"}


@pytest.mark.parametrize(
    ("apart", "taken_off"),
    # two numbers of 0.5 known to 0.01 each, in three fits: one is off by so many errors
    [(0.0, 0.0), (3.0, 3.0), (100.0, chance_gain(6) - chance_gain(2))],
)
def test_what_fits_gain_by_numbers_of_their_own_is_taken_off(
    apart: float, taken_off: float
) -> None:
    fits = Fits({("low_pass_filter",): 10.0}, {})
    ends = fits.refit(range(3), Parts(["low_pass_filter"]))
    values = ends[0].measured.values.copy()
    values[2] += 0.01 * apart
    ends[0] = replace(ends[0], measured=replace(ends[0].measured, values=values))
    plain = Fitted(Parts(), {k: fits.end(Parts()) for k in range(3)})
    with_filter = Fitted(Parts(["low_pass_filter"]), ends)
    assert with_filter.gain(plain) == pytest.approx(30.0 - taken_off)
    assert plain.gain(with_filter) == pytest.approx(taken_off - 30.0)
