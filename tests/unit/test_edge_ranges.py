"""Ranges from defocus: against the golden session's own law, and what tells the sides of best focus apart."""

import numpy as np
import pytest

from labkit.edges.ranges import FocusLaw, Side, edge_range
from labkit.optics.lens import ThinLens
from tests.golden.simulate import REFERENCE_NM, defocus_waves

LENS = ThinLens(60.0, 4.0, 1.08)
FOCI = {"R": 1531.0, "G": 1524.0, "B": 1538.0}


def law(*names: str, zero_mm: float = 0.0, **std: float) -> FocusLaw:
    order = ("f", "n", "mp", "zero")
    covariance = np.diag([std.get(name, 0.0) ** 2 for name in (*order, *names)])
    foci = np.array([FOCI[name] - zero_mm for name in names])
    return FocusLaw(LENS, names, foci, covariance, REFERENCE_NM, zero_mm=zero_mm)


def sides(*waves: float, std: float = 0.003, below: float = 0.0) -> list[Side]:
    return [Side(w, std, -below * k) for k, w in enumerate(waves)]


@pytest.mark.parametrize("range_mm", [1100.0, 1510.0, 2500.0, 40_000.0])
def test_a_range_comes_back_from_the_golden_sessions_law(range_mm: float) -> None:
    waves = defocus_waves(range_mm, FOCI["G"])
    found = edge_range(law("G"), [("G", sides(waves))])
    assert found.range_mm.value == pytest.approx(range_mm, rel=1e-9)
    step = 1e-4 * range_mm
    slope = (defocus_waves(range_mm + step, FOCI["G"]) - waves) / step
    assert found.range_mm.std == pytest.approx(
        0.003 / slope, rel=2e-3
    )  # and the law's bend over that step
    assert found.other is None


def test_one_colour_has_two_ranges_of_which_both_are_reported() -> None:
    waves = defocus_waves(1700.0, FOCI["G"])
    found = edge_range(law("G"), [("G", sides(waves, -waves))])
    assert found.range_mm.value == pytest.approx(1700.0)
    assert found.other is not None
    assert defocus_waves(found.other.value, FOCI["G"]) == pytest.approx(-waves)


def test_a_side_that_the_picture_excludes_is_not() -> None:
    waves = defocus_waves(1700.0, FOCI["G"])
    assert edge_range(law("G"), [("G", sides(waves, -waves, below=30.0))]).other is None


@pytest.mark.parametrize("range_mm", [1300.0, 1527.0, 1900.0])
def test_colours_of_different_best_focus_tell_the_sides_apart(range_mm: float) -> None:
    every = [(name, sides(w := defocus_waves(range_mm, FOCI[name]), -w)) for name in FOCI]
    found = edge_range(law(*FOCI), every)
    assert found.range_mm.value == pytest.approx(range_mm)
    assert found.other is None


def test_beyond_infinity_nothing_stands() -> None:
    waves = defocus_waves(1e9, FOCI["G"]) + 0.1
    found = edge_range(law("G"), [("G", sides(waves, -waves))])
    assert found.range_mm.value < FOCI["G"]
    assert found.other is None
    assert np.isnan(edge_range(law("G"), [("G", sides(waves))]).range_mm.value)


def test_errors_of_the_lens_are_in_the_ranges() -> None:
    waves = defocus_waves(2500.0, FOCI["G"])

    def std(**of: float) -> float:
        return edge_range(law("G", **of), [("G", sides(waves, std=1e-9))]).range_mm.std

    # 1 / range is 1 / focus less a blur over f^2: a best focus moves by 1 / focus^2, a blur of 1 % more by 1 % of the
    # difference assert std(G=1.0) == pytest.approx((2500 / 1524) ** 2, rel=0.01)
    assert std(n=0.01) == pytest.approx(0.01 * 2500**2 * (1 / 1524 - 1 / 2500), rel=0.05)
    # a common zero moves best focus and takes itself off the range
    assert std(zero=1.0) == pytest.approx((2500 / 1524) ** 2 - 1, rel=0.02)


def test_ranges_are_on_the_scale_that_best_focus_is_on() -> None:
    waves = defocus_waves(1700.0, FOCI["G"])
    assert edge_range(
        law("G", zero_mm=3.0), [("G", sides(waves))]
    ).range_mm.value == pytest.approx(1697.0)


def test_errors_that_colours_have_in_common_do_not_average_out() -> None:
    every = [(name, sides(defocus_waves(1900.0, FOCI[name]), std=0.03)) for name in FOCI]
    alone = edge_range(law("G"), every[1:2]).range_mm.std
    apart, alike = (
        edge_range(law(*FOCI), every, c).range_mm.std
        for c in (np.eye(3), np.full((3, 3), 0.99))
    )
    assert apart == pytest.approx(alone / np.sqrt(3), rel=0.05)
    assert alike == pytest.approx(alone, rel=0.2)
