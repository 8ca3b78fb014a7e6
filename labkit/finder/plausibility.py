"""Check whether the target's sizes in the pictures agree with plan and ranges.

The check comes before any fit: a fit would search for long, then reject, and could not name the reason. Numbers wrong by a
factor are reported. Uncertain numbers are not, for a fit estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot, log, sqrt
from statistics import fmean

import cv2
import numpy as np

from labkit.errors import DataError
from labkit.plan import Plan
from labkit.types import Floats

SHORTENED = 0.7
"""Share of its engraved focal length that an internally focusing lens may keep at close range; a tilt of the target reduces
sizes less."""

REFOCUSED = 0.03
"""Relative change of size between ranges that the ranges do not explain: tilts of a few degrees, a touched lens."""

CORNERS_PX = 2.0
"""Error of the sides of a found target, pixels, before a fit refines them."""

STDS = 3.0
"""Standard errors of stated numbers allowed."""

FILTERS_NM = {"R": (570.0, 720.0), "G": (480.0, 600.0), "B": (380.0, 520.0)}
"""Light that the colours of filter arrays pass, broadly: light between two colours is in the bands of both."""


@dataclass(frozen=True, slots=True)
class Sight:
    """The target in a picture: stated range, and corners (4, 2) as (row, column)."""

    range_mm: float
    corners_px: Floats


@dataclass(frozen=True, slots=True)
class _Size:
    """Size at a range: approximate distance from the entrance pupil, and side of the target in the picture."""

    range_mm: float
    away_mm: float
    side_px: float

    @property
    def constant(self) -> float:
        """Distance times size: the same at every range, except for small errors."""
        return self.away_mm * self.side_px


def refuse_contradictions(
    sights: Sequence[Sight], plan: Plan, size_mm: tuple[float, float]
) -> None:
    """Refuse sizes in the pictures that contradict the ranges, or the plan's numbers; and wavelengths exchanged.

    Parameters
    ----------
    sights : the target in all pictures with a known range
    plan : lens, sensor, target and rail
    size_mm : (height, width) of the target

    Raises
    ------
    DataError : one line about the contradiction
    """
    ranges = sorted({sight.range_mm for sight in sights})
    if ranges and ranges[0] <= plan.lens.focal_length_mm:
        raise DataError(
            f"range_mm = {ranges[0]:g}: a target there, not beyond lens.focal_length_mm = {plan.lens.focal_length_mm:g}, "
            f"makes no picture; check both"
        )
    sizes = [_size(range_mm, sights, plan, size_mm) for range_mm in ranges]
    problem = (
        _among_colours(plan) or _among_ranges(sizes, plan) or _with_the_plan(sizes, plan)
    )
    if problem:
        raise DataError(problem)


def _among_colours(plan: Plan) -> str | None:
    """Describe two wavelengths of which each is light of the other's filter, and none of its own; None without such."""
    light = {c.name: c.wavelength_nm for c in plan.channel if c.name in FILTERS_NM}
    for one, other in combinations(light, 2):
        if all(
            _passes(there, light[here]) and not _passes(here, light[here])
            for here, there in ((one, other), (other, one))
        ):
            return (
                f"channel {one} has wavelength_nm = {light[one]:g} and channel {other} has {light[other]:g}, light that only "
                "the other's filter passes: exchange them"
            )
    return None


def _passes(colour: str, wavelength_nm: float) -> bool:
    low_nm, high_nm = FILTERS_NM[colour]
    return low_nm < wavelength_nm < high_nm


def _size(
    range_mm: float, sights: Sequence[Sight], plan: Plan, size_mm: tuple[float, float]
) -> _Size:
    """Average the size over all pictures at a range; the side is along the target's first axis, whatever its proportions."""
    areas = [
        cv2.contourArea(sight.corners_px.astype(np.float32))
        for sight in sights
        if sight.range_mm == range_mm
    ]
    side_px = sqrt(fmean(areas) * size_mm[0] / size_mm[1])
    return _Size(range_mm, range_mm - plan.lens.focal_length_mm, side_px)


def _among_ranges(sizes: Sequence[_Size], plan: Plan) -> str | None:
    """Describe a range that the others contradict, for any lens, sensor and target; None without contradiction."""
    pairs = [set(pair) for pair in combinations(sizes, 2) if not _agree(*pair, plan)]
    if not pairs:
        return None
    lone = [one for one in sizes if len(sizes) > 2 and all(one in pair for pair in pairs)]
    if len(lone) != 1:
        seen = ", ".join(f"{one.side_px:.0f} at {one.range_mm:g} mm" for one in sizes)
        return f"the ranges contradict the sizes of the target in the pictures, in pixels: {seen}; check {_where_ranges(plan)}"
    (odd,) = lone
    others = [one for one in sizes if one is not odd]
    named = (
        ", ".join(f"{one.range_mm:g}" for one in others)
        if len(others) < 6
        else f"{len(others)} other ranges"
    )
    away_mm = fmean(one.constant for one in others) / odd.side_px
    return (
        f"at {odd.range_mm:g} mm the target spans {odd.side_px:,.0f} pixels, as it would at "
        f"{away_mm + plan.lens.focal_length_mm:.0f} mm by its sizes at {named}{' mm' if len(others) < 6 else ''}; "
        f"check {_where_ranges(plan)}"
    )


def _agree(one: _Size, other: _Size, plan: Plan) -> bool:
    """Return whether sizes at two ranges are inverse to distances, within errors of the range zero and of the pupil's place."""
    zero_mm = STDS * plan.fit.range_zero_std_mm + plan.lens.focal_length_mm
    allowed = REFOCUSED + zero_mm * abs(1 / one.away_mm - 1 / other.away_mm)
    allowed += CORNERS_PX * (1 / one.side_px + 1 / other.side_px)
    allowed += STDS * plan.fit.range_std_mm * hypot(1 / one.away_mm, 1 / other.away_mm)
    return abs(log(one.constant / other.constant)) < allowed


def _with_the_plan(sizes: Sequence[_Size], plan: Plan) -> str | None:
    """Describe a size at a typical range that contradicts the plan's numbers; None without contradiction."""
    if not sizes:
        return None
    focal = plan.lens.stated_focal_length
    size = plan.target.stated_size
    constant = focal.value * size.value / (plan.sensor.pixel_pitch_um * 1e-3)
    typical = sorted(sizes, key=lambda one: one.constant)[len(sizes) // 2]
    seen_mm = constant / typical.side_px
    zero_mm = STDS * plan.fit.range_zero_std_mm
    nearest_mm = min(
        max(seen_mm, typical.away_mm - zero_mm), typical.away_mm + zero_mm
    )  # that the tape allows
    uncertain = hypot(focal.std / focal.value, size.std / size.value)
    if (
        abs(log(seen_mm / nearest_mm))
        < -log(SHORTENED) + STDS * uncertain + CORNERS_PX / typical.side_px
    ):
        return None
    return (
        f"at {typical.range_mm:g} mm a target of {size.value:g} mm would span {constant / typical.away_mm:,.0f} pixels; "
        f"it spans {typical.side_px:,.0f}, as it would at {seen_mm + focal.value:.0f} mm, or one of "
        f"{size.value * typical.away_mm / seen_mm:.3g} mm there: check target.size_mm, lens.focal_length_mm = {focal.value:g}, "
        f"sensor.pixel_pitch_um = {plan.sensor.pixel_pitch_um:g} and {_where_ranges(plan)}"
    )


def _where_ranges(plan: Plan) -> str:
    """Name the plan's keys that state ranges, and corners if stated."""
    corners = "" if plan.target.corners_px is None else ", target.corners_px"
    if plan.rail is None:
        return f"range_mm in the imported CSV{corners}"
    return f"rail.ranges_mm, rail.range_at_zero_mm and rail.direction{corners}"
