"""Which of a fit and its twin is the right one, over random sessions whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.analysis.lens_model import Member
from labkit.analysis.twins import choose_twins, twin
from labkit.estimation.expansion import Measured
from tests.lens_samples import covariance, laws, stated

NOLL = (4, 6, 7, 11)


def fits_of(ranges: list[float], focus_mm: float, modes: list[float], channel: str = "G") -> list[Member]:
    """Of a 70 mm f/2.8 lens. modes: astigmatism, coma, spherical."""
    made = []
    for r in ranges:
        waves, cone, scale = laws(r, focus_mm, focus_mm, 70.0, 2.8, 0.985)
        cov = np.diag([0.0, *[1e-6] * 3, 0.0, 0.0])
        cov[np.ix_([0, 4, 5], [0, 4, 5])] = covariance(waves)
        made.append(Member(channel, r, r, Measured(NOLL, np.array([waves, *modes, cone, scale]), cov, 0 * cov)))
    return made


@pytest.mark.parametrize("seed", range(6))
def test_signs_undo_a_random_choice_of_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.sort(rng.uniform(2000, 2300, 5)).tolist()
    truth = fits_of(ranges, float(rng.uniform(2050, 2250)), rng.normal(0, 0.05, 3).tolist())
    flips = rng.choice([-1, 1], 5).tolist()
    found, open_ = choose_twins([twin(m, s) for m, s in zip(truth, flips, strict=True)], stated(70.0, 2.8))
    assert found == flips
    assert open_ == []


def test_a_twin_has_its_even_modes_reversed() -> None:
    (one,) = fits_of([2100.0], 2000.0, [0.01, 0.02, 0.03])
    turned = twin(one, -1).measured
    np.testing.assert_allclose(turned.values / one.measured.values, [-1, -1, 1, -1, 1, 1])
    # defocus and the cone go together: with the sign of defocus
    assert turned.covariance[0, 4] == -one.measured.covariance[0, 4]
    assert twin(one, 1) is one


def test_all_ranges_on_one_side_of_focus_still_tell_it() -> None:
    truth = fits_of([2100.0, 2200.0, 2300.0], 2000.0, [0.0, 0.0, 0.0])
    assert choose_twins([twin(m, -1) for m in truth], stated(70.0, 2.8)) == ([-1, -1, -1], [])


def test_ranges_too_close_together_leave_the_sign_open() -> None:
    truth = fits_of([30_000.0, 30_001.0], 28_000.0, [0.01, 0.0, 0.02])
    assert choose_twins(truth, stated(70.0, 2.8))[1] == ["G"]


def test_at_one_range_colours_are_turned_alike() -> None:
    green = fits_of([2100.0], 2000.0, [0.01, 0.02, 0.05])
    red = fits_of([2100.0], 2005.0, [0.01, 0.02, 0.05], "R")
    signs, open_ = choose_twins([green[0], twin(red[0], -1)], stated(70.0, 2.8))
    assert signs == [1, -1]
    assert open_ == []


def test_a_colour_of_one_range_is_turned_as_another_is_there() -> None:
    green = fits_of([1900.0, 2100.0], 2000.0, [0.01, 0.02, 0.05])
    red = fits_of([2100.0], 2005.0, [0.01, 0.02, 0.05], "R")
    assert choose_twins([twin(red[0], -1), *green], stated(70.0, 2.8)) == ([-1, 1, 1], [])
