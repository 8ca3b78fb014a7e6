"""Two sessions compared: p-values are uniform for one lens, whatever both sessions were told, and another lens is found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from labkit.catalogue.compare import Comparison, compare_results
from labkit.catalogue.pictures import comparison_picture
from labkit.errors import DataError
from labkit.optics.metrics import opd_map
from labkit.results import Results
from labkit.results.model import CommonNumbers, StatedNumber
from labkit.types import Floats
from tests.results_samples import PLAN, a_wavefront, some_results

NAMES = ("waves.R.5", "waves.R.8", "f_number", "best_focus_mm.R")
TRUE = np.array([0.03, -0.04, 2.8, 2987.0])
OWN_STD = np.array([0.001, 0.002, 0.01, 0.4])
MOVES = np.array([0.004, -0.003, 0.08, 0.1])
"""Of the numbers, for an engraving that is off by one standard error."""


def common(
    values: Floats = TRUE, moves: Floats = MOVES, own: Floats = OWN_STD, stated: float = 2.8
) -> CommonNumbers:
    covariance = np.diag(own**2) + np.outer(moves, moves)
    return CommonNumbers(
        NAMES, values, covariance, {"f-number": StatedNumber(stated, 0.084, moves)}
    )


def results(values: Floats = TRUE, **changed: Any) -> Results:
    return some_results(common=common(values, **changed))


def drawn(rng: np.random.Generator, engraving: float, moves: Floats) -> Results:
    values = TRUE + engraving * moves + OWN_STD * rng.normal(size=4)
    return results(values, moves=moves)


def test_p_values_of_one_lens_are_uniform_though_both_plans_err_alike() -> None:
    rng = np.random.default_rng(1)
    p_values = []
    for _ in range(400):
        engraving = rng.normal()
        pair = drawn(rng, engraving, MOVES), drawn(rng, engraving, 0.5 * MOVES)
        p_values.append(compare_results(*pair).p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.05


def test_errors_of_different_engravings_are_independent() -> None:
    apart = np.sqrt(2 * (OWN_STD**2 + MOVES**2))[:3]
    pair = compare_results(results(), results(stated=2.9))
    stds = [one.difference.std for one in pair.differences][:3]
    assert stds == pytest.approx(apart)


def test_an_engraving_that_both_plans_state_cancels() -> None:
    pair = compare_results(results(), results())
    stds = [one.difference.std for one in pair.differences][:3]
    assert stds == pytest.approx(np.sqrt(2) * OWN_STD[:3])
    assert pair.p_value == 1
    assert pair.freedom == 3


def test_the_wavelengths_of_two_cameras_err_apart() -> None:
    pair = [results(), results()]
    for one in pair:
        assert one.common is not None
        stated = {"wavelength.R": one.common.stated["f-number"]}
        object.__setattr__(one.common, "stated", stated)
    same = compare_results(*pair).differences[0].difference.std
    other = compare_results(*pair, same_camera=False).differences[0].difference.std
    assert other == pytest.approx(np.sqrt(2 * (OWN_STD[0] ** 2 + MOVES[0] ** 2)))
    assert same < other


def test_a_number_that_only_the_plans_state_is_not_counted() -> None:
    own = np.array([0.001, 0.002, 0.0, 0.4])
    pair = compare_results(results(own=own), results(own=own))
    assert pair.freedom == 2


def test_coma_of_a_hundredth_of_a_wave_is_another_lens() -> None:
    moved = TRUE + np.array([0.0, 0.02, 0.0, 0.0])
    pair = compare_results(results(), results(moved), names=("before", "after"))
    assert pair.chi2 == pytest.approx(0.02**2 / (2 * OWN_STD[1] ** 2))
    assert not pair.same
    assert pair.largest.name == "waves.R.8"
    assert pair.headline.startswith(
        "before and after are not of one lens, or it changed (p = "
    )


def test_where_the_lens_was_focused_is_tested_only_if_it_stayed() -> None:
    moved = TRUE + np.array([0.0, 0.0, 0.0, 5.0])
    pair = compare_results(results(), results(moved))
    assert pair.same
    focus = pair.differences[-1]
    assert not focus.tested
    # two tapes of 10 mm, beyond the errors on the stated scale
    assert focus.difference.std == pytest.approx(np.sqrt(200 + 2 * 0.4**2))
    stayed = compare_results(results(), results(moved), same_focus=True)
    assert not stayed.same
    assert stayed.freedom == 4


def test_waves_are_compared_at_one_wavelength() -> None:
    plan = PLAN.replace(fit={"reference_wavelength_nm": 900.0})
    half = TRUE * [0.5, 0.5, 1.0, 1.0]
    other = some_results(plan=plan, common=common(half))
    assert compare_results(results(), other).p_value == pytest.approx(1)


def open_sign(values: Floats) -> Results:
    wavefronts = (a_wavefront(sign_open=True),)
    return some_results(wavefronts=wavefronts, common=common(values))


def test_of_two_twins_the_nearer_is_compared() -> None:
    turned = TRUE * [-1.0, 1.0, 1.0, 1.0]
    pair = compare_results(open_sign(TRUE), open_sign(turned))
    assert pair.p_value == pytest.approx(1)
    assert [one.tested for one in pair.differences] == [True, True, True, False]


def test_results_of_an_earlier_version_are_compared_by_their_wavefronts() -> None:
    pair = compare_results(some_results(), some_results())
    assert [one.name for one in pair.differences] == [
        f"waves.{channel}.{j}" for channel in "RB" for j in (5, 8)
    ]
    assert "A holds no joint covariance" in pair.notes[0]


def noted(pair: Comparison, words: str) -> bool:
    return any(words in note for note in pair.notes)


def test_what_the_p_value_does_not_allow_for_is_said() -> None:
    stopped = some_results(plan=PLAN.replace(lens={"f_number": 4.0}), common=common())
    assert noted(compare_results(results(), stopped), "f/2.8 and f/4")
    near = results(TRUE - np.array([0.0, 0.0, 0.0, 1000.0]))
    assert noted(compare_results(near, results()), "focused at 1987 and 2987 mm")
    assert compare_results(results(), results()).notes == ()


def test_sessions_without_a_number_in_common_are_named() -> None:
    other = some_results(
        wavefronts=(a_wavefront(channel="G"),),
        common=CommonNumbers(("waves.G.5",), np.zeros(1), np.eye(1)),
    )
    with pytest.raises(DataError, match="A and B have no channel with the same modes"):
        compare_results(results(), other)


def test_the_map_is_the_wavefronts_difference() -> None:
    moved = TRUE + np.array([0.0, 0.01, 0.0, 0.0])
    pair = compare_results(results(), results(moved))
    made = opd_map(pair.wavefronts["R"], 21).value
    coma = opd_map(a_wavefront(waves=np.array([0.0, 0.0, 0.01])).fitted, 21).value
    np.testing.assert_allclose(made, coma, atol=1e-12)
    assert comparison_picture(pair).startswith(b"<?xml")
