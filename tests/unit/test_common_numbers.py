"""Numbers that sessions of one lens share: their joint covariance holds between sessions, and follows what plans state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from labkit.analysis.common_numbers import common_numbers
from labkit.catalogue.compare import Comparison, compare_results
from labkit.estimation.estimate import Estimate
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated
from labkit.results.model import CommonNumbers
from labkit.uncertain import Uncertain
from tests.lens_samples import laws as true_laws
from tests.lens_samples import lens_of, measured, observed, stated
from tests.results_samples import some_results

RANGES_MM = (980.0, 1010.0, 1040.0)
FOCUS_MM = 1010.0
LONGER_UM = {"R": -12.0, "G": 0.0, "B": 15.0}
"""Focal lengths, less green's."""
F_MM, F_NUMBER, PUPILS = 70.0, 2.8, 0.97
MODES = {5: 0.03, 7: -0.02, 8: 0.05}
APART = {"R": -0.004, "G": 0.0, "B": 0.006}
"""What a colour's modes have more, waves. Where colours share a mode, two sessions agree better than their errors say."""
FLOORS = [SETTINGS.defocus_floor_waves, 0.0, 0.0, 0.0, 0.0, SETTINGS.size_floor]


def a_plan(focal_mm: float = F_MM, f_number: float = F_NUMBER) -> Stated:
    return stated(
        focal_mm,
        f_number,
        focal_length=Uncertain(focal_mm, 0.02 * F_MM, "mm"),
        f_number=Uncertain(f_number, 0.03 * F_NUMBER),
    )


def a_session(
    plan: Stated,
    rng: np.random.Generator | None = None,
    coma: float = 0.0,
    pupils: float = PUPILS,
) -> CommonNumbers:
    """A session of the lens, with noise and a tape that errs; without a generator neither."""
    zero_mm = 0.0 if rng is None else rng.normal(0, plan.range_zero_std_mm)
    every = []
    for range_mm in RANGES_MM:
        for colour, longer_um in LONGER_UM.items():
            green_mm = FOCUS_MM + zero_mm
            own_mm = 1 / (F_MM + 1e-3 * longer_um) - 1 / F_MM + 1 / green_mm
            at = (range_mm + zero_mm, 1 / own_mm, green_mm)
            clean = np.array(true_laws(*at, F_MM, F_NUMBER, pupils))
            modes = {j: waves + APART[colour] for j, waves in MODES.items()}
            one = measured(clean, modes | {8: modes[8] + coma})
            if rng is not None:
                noise = one.covariance + np.diag(np.square(FLOORS))
                moved = rng.multivariate_normal(one.values, noise)
                one = replace(one, values=moved)
            every.append(observed(range_mm, colour, one))
    found = common_numbers(Estimate((), lens_of(every, plan)))
    assert found is not None
    return found


def compared(a: CommonNumbers, b: CommonNumbers) -> Comparison:
    return compare_results(some_results(common=a), some_results(common=b))


def test_the_numbers_are_those_of_the_lens() -> None:
    found = a_session(a_plan())
    numbers = dict(zip(found.names, found.values.tolist(), strict=True))
    # colours of an order are drawn together, by 7e-5
    assert numbers["waves.B.8"] == pytest.approx(0.056, abs=1.4e-4)
    assert numbers["best_focus_mm.G"] == pytest.approx(1010.0, abs=1e-3)
    assert numbers["colour_um.B"] == pytest.approx(15.0, abs=1e-3)
    assert numbers["ln_pupil_magnification"] == pytest.approx(np.log(PUPILS), abs=1e-3)
    assert "colour_um.G" not in numbers


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("focal_length", a_plan(focal_mm=1.002 * F_MM)),
        ("f-number", a_plan(f_number=1.003 * F_NUMBER)),
    ],
)
def test_numbers_move_with_what_the_plan_states(name: str, other: Stated) -> None:
    here, there = a_session(a_plan()), a_session(other)
    one = here.stated[name]
    stds = (there.stated[name].value - one.value) / one.std
    moved = (there.values - here.values) / np.sqrt(np.diag(here.covariance))
    predicted = stds * one.moves / np.sqrt(np.diag(here.covariance))
    np.testing.assert_allclose(moved, predicted, atol=0.01 * np.abs(predicted).max())


def test_what_is_left_without_the_stated_numbers_is_a_covariance() -> None:
    found = a_session(a_plan())
    left = found.covariance - sum(
        np.outer(one.moves, one.moves) for one in found.stated.values()
    )
    scale = np.sqrt(np.diag(found.covariance))
    assert np.linalg.eigvalsh(left / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.slow
def test_two_sessions_of_one_lens_have_uniform_p_values_and_coma_is_found() -> None:
    rng = np.random.default_rng(3)
    same, decentred = [], []
    for _ in range(200):
        engraved = (rng.normal(F_MM, 0.02 * F_MM), rng.normal(F_NUMBER, 0.03 * F_NUMBER))
        plan, pupils = a_plan(*engraved), rng.uniform(0.7, 1.4)
        first, second, other = (
            a_session(plan, rng, coma, pupils) for coma in (0.0, 0.0, 0.01)
        )
        same.append(compared(first, second).p_value)
        decentred.append(compared(first, other).p_value)
    assert stats.kstest(same, "uniform").pvalue > 0.05
    assert np.mean(np.array(decentred) < 0.01) >= 0.95
