"""Sizes in pictures beside what plan and ranges state: mistakes are told, what is honestly uncertain is not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from labkit.errors import DataError
from labkit.finder.plausibility import Sight, refuse_contradictions
from labkit.plan import Plan
from tests.plans import SMALL, Tables, plan_text, simulated

STATED: Tables = {
    "lens": {"focal_length_mm": 70.0, "f_number": 2.8},
    "sensor": {"pixel_pitch_um": 4.78},
    "target": {"size_mm": 46.8},
}
RANGES = (3000.0, 3200.0, 3300.0)


def plan(**tables: Mapping[str, object]) -> Plan:
    return Plan.parse(plan_text(SMALL, STATED, tables), Path())


def side_px(
    true_mm: float, focal_mm: float = 70.0, mp: float = 1.0, best_mm: float = 3000.0
) -> float:
    """Of a target of 46.8 mm, by chief rays: distance of the sensor from the exit pupil over that from the entrance pupil."""
    behind = best_mm * focal_mm / (best_mm - focal_mm) + (mp - 1) * focal_mm
    return 46.8 * behind / mp / (true_mm - focal_mm + focal_mm / mp) / 4.78e-3


def sight(stated_mm: float, side: float) -> Sight:
    return Sight(stated_mm, np.array([[0, 0], [0, side], [side, side], [side, 0.0]]) + 40)


def told(
    stated: Plan, *sights: Sight, size_mm: tuple[float, float] | None = None
) -> str | None:
    try:
        refuse_contradictions(sights, stated, size_mm or (stated.target.size_mm,) * 2)
    except DataError as error:
        return str(error)
    return None


def test_what_agrees_is_not_told() -> None:
    assert told(plan(), *(sight(mm, side_px(mm)) for mm in RANGES)) is None
    assert told(plan()) is None


def in_light(**wavelength_nm: float) -> Plan:
    return plan().replace(
        channel=[{"name": c, "wavelength_nm": nm} for c, nm in wavelength_nm.items()]
    )


@pytest.mark.parametrize(
    ("light", "first", "second"),
    [
        ({"R": 455.0, "G": 535.0, "B": 640.0}, "R", "B"),
        ({"R": 535.0, "G": 640.0, "B": 455.0}, "R", "G"),
        ({"R": 640.0, "G": 455.0, "B": 535.0}, "G", "B"),
    ],
)
def test_exchanged_wavelengths_are_told(
    light: dict[str, float], first: str, second: str
) -> None:
    problem = told(in_light(**light))
    assert problem is not None
    assert f"channel {first} has wavelength_nm = {light[first]:g}" in problem
    assert f"channel {second} has {light[second]:g}" in problem
    assert problem.endswith("exchange them")


@pytest.mark.parametrize(
    "light",
    [
        {"R": 640.0, "G": 535.0, "B": 455.0},
        {"R": 594.0, "G": 512.0, "B": 472.0},
        {"R": 590.0, "G": 590.0, "B": 590.0},  # one narrow light, which all filters leak
        {"R": 850.0, "G": 850.0, "B": 850.0},  # infrared passes all of them
        {"R": 700.0, "G": 850.0, "B": 940.0},
        {"G": 640.0, "B": 455.0},
    ],
)
def test_wavelengths_that_may_be_right_are_not_told(light: dict[str, float]) -> None:
    assert told(in_light(**light)) is None


@pytest.mark.parametrize("mp", [0.6, 1.0, 1.6])
@pytest.mark.parametrize(
    ("focal_mm", "tape_mm", "near_mm", "share"),
    [
        (70 * 1.06, 30, 3000, 1.0),  # engraving and tape three of their standard errors off
        (70 * 0.94, -30, 3000, 1.0),
        (70 * 1.06, 30, 400, 1.0),
        (70 * 0.94, -30, 400, 1.0),
        (70 * 0.72, 0, 400, 1.0),  # focusing inside has taken 28 % of the focal length
        (70, 0, 3000, np.cos(np.radians(40))),  # turned by 40 degrees
    ],
)
def test_what_is_honestly_uncertain_is_not_told(
    focal_mm: float, tape_mm: float, near_mm: float, share: float, mp: float
) -> None:
    ranges = [near_mm * (1 + step) for step in (0, 0.04, 0.1)]
    sides = [np.sqrt(share) * side_px(mm + tape_mm, focal_mm, mp, near_mm) for mm in ranges]
    assert told(plan(), *map(sight, ranges, sides)) is None


@pytest.mark.parametrize(
    ("tables", "told_mm", "told_size"),
    [
        ({"target": {"size_mm": 4.68}}, "363 mm", "46.8 mm"),
        ({"target": {"size_mm": 23.4}}, "1535 mm", "46.8 mm"),
        (
            {"sensor": {"pixel_pitch_um": 9.56}},
            "1535 mm",
            "93.6 mm",
        ),  # one colour plane's, of a file with all of them
        ({"lens": {"focal_length_mm": 28.0}}, "1200 mm", "119 mm"),
    ],
)
def test_a_number_of_the_plan_that_is_off_by_a_factor_is_told(
    tables: Mapping[str, Mapping[str, object]], told_mm: str, told_size: str
) -> None:
    message = told(plan(**tables), sight(3000.0, side_px(3000.0)))
    assert message is not None
    assert f"it spans 234, as it would at {told_mm}, or one of {told_size} there" in message
    assert "check target.size_mm, lens.focal_length_mm = " in message
    assert "\n" not in message


def test_ranges_in_centimetres_are_told() -> None:
    message = told(plan(), *(sight(mm / 10, side_px(mm)) for mm in RANGES))
    assert message is not None
    assert (
        "at 320 mm a target of 46.8 mm would span 2,741 pixels; it spans 219, as it would at 3195 mm"
        in message
    )
    assert "range_mm in the imported CSV" in message


@pytest.mark.parametrize("typed_mm", [300.0, 2300.0, 3020.0, 32000.0])
def test_one_range_that_the_others_contradict_is_named(typed_mm: float) -> None:
    sights = [
        sight(typed_mm if mm == 3200 else mm, side_px(mm)) for mm in (*RANGES, 3400.0)
    ]
    message = told(plan(), *sights)
    assert message is not None
    assert message.startswith(
        f"at {typed_mm:g} mm the target spans 219 pixels, as it would at 320"
    )
    assert "by its sizes at 3000, 3300, 3400 mm; check range_mm" in message


def test_two_ranges_that_contradict_each_other_are_both_named() -> None:
    message = told(plan(), sight(3000.0, side_px(3000.0)), sight(3300.0, side_px(3000.0)))
    assert message is not None
    assert (
        "in pixels: 234 at 3000 mm, 234 at 3300 mm; check range_mm in the imported CSV"
        in message
    )


def test_a_range_within_the_focal_length_is_told() -> None:
    message = told(plan(), sight(70.0, 234.0))
    assert message is not None
    assert "range_mm = 70" in message
    # just beyond it pupil and tape could be anything, but no picture is so large
    assert told(plan(), *(sight(mm, 234.0) for mm in (71.0, 72.0))) is not None


def test_a_long_target_is_measured_along_its_first_axis() -> None:
    tall, wide = side_px(3000.0), 3 * side_px(3000.0)
    corners = np.array([[0, 0], [0, wide], [tall, wide], [tall, 0.0]])
    assert told(plan(), Sight(3000.0, corners), size_mm=(46.8, 3 * 46.8)) is None


def test_rail_and_corners_are_named_where_the_plan_has_them() -> None:
    corners = {"corners_px": [[0, 0], [0, 9], [9, 9], [9, 0]]}
    bench = Plan.parse(
        plan_text(SMALL, STATED, simulated([3000], 2950.0), {"target": corners}), Path()
    )
    message = told(bench, sight(3000.0, 9.0))
    assert message is not None
    assert (
        "rail.ranges_mm, rail.range_at_zero_mm and rail.direction, target.corners_px"
        in message
    )
