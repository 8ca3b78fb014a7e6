"""Determine a rail's direction and range zero from a few ranges measured by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Rail, Travel
from labkit.devices.registry import open_rail
from labkit.errors import DataError, PlanError, shown
from labkit.plan import Plan

TAPE_ERROR_MM = 3.0
"""Measured by hand, a range may err by so much."""

ENDLESS_MM = 1e5
LONGEST_MM = 3e4
"""A longer range is not meant by a number that could be metres."""
TRAVEL_SHARES = (0.1, 0.5, 0.9)
"""Where along its travel a rail is measured, unless positions are given."""


@dataclass(frozen=True, slots=True)
class RailZero:
    """range = range_at_zero_mm + direction * position, with the standard error of the zero and each reading's misfit.

    std_mm follows from the scatter, None for fewer than three readings; `scale` is the
    rail's true movement for each reported mm.
    """

    direction: Literal[1, -1]
    range_at_zero_mm: float
    std_mm: float | None
    scale: float
    misfit_mm: tuple[float, ...]
    positions_mm: tuple[float, ...]


def calibrate_rail(
    plan: Plan | Path | str,
    ask: Callable[[str], float],
    *,
    at_mm: Sequence[float] = (),
    ready: Callable[[str], object] = lambda words: None,
    say: Callable[[str], None] | None = None,
) -> RailZero:
    """Determine a rail's direction and zero: the rail homes and moves, a person measures ranges.

    Parameters
    ----------
    plan : the plan, or its path; it states the rail
    ask : called with a question at each position; returns the range from target to lens, mm
    at_mm : rail positions to measure at; by default three over the travel
    ready : called with what the rail will do, before it moves
    say : called with each reading that does not fit, before it is repeated; None to ask once

    Raises
    ------
    PlanError
        the plan has no rail, or a position is outside the travel
    DataError
        the ranges do not follow from a rail that moves as far as it reports
    DeviceError
        of the rail

    >>> labkit.calibrate_rail("plan.toml", lambda question: float(input(question)))
    """
    plan = plan if isinstance(plan, Plan) else Plan.load(Path(plan))
    if plan.rail is None:
        raise PlanError("the plan has no [rail]")
    with open_rail(plan.rail.address, plan, DeviceContext()) as rail:
        places = stations(rail.travel_mm, at_mm)
        listed = ", ".join(f"{mm:g}" for mm in places)
        ready(f"The rail will home and then move to {listed} mm")
        rail.home()
        positions, ranges = measure(rail, places, ask, say)
    try:
        return find_zero(positions, ranges)
    except DataError as error:
        pairs = zip(positions, ranges, strict=True)
        listed = ", ".join(f"{r:g} at {at:g}" for at, r in pairs)
        raise DataError(f"measured (mm): {listed}; {error}") from error


def stations(travel: Travel, asked_mm: Sequence[float]) -> tuple[float, ...]:
    """Return positions to measure at. Raises PlanError for fewer than two, or outside the travel."""
    if asked_mm:
        if len(set(asked_mm)) < 2:
            raise PlanError(f"--at {asked_mm[0]:g}: give two positions or more, far apart")
        for mm in asked_mm:
            if not travel.low_mm <= mm <= travel.high_mm:
                raise PlanError(
                    f"--at {mm:g}: the rail goes from {travel.low_mm:g} to {travel.high_mm:g} mm"
                )
        return tuple(asked_mm)
    if travel.high_mm - travel.low_mm > ENDLESS_MM:
        raise PlanError(
            "this rail does not report its travel: give positions to measure at, such as --at 10 --at 200 --at 390"
        )
    return tuple(
        round(travel.low_mm + share * (travel.high_mm - travel.low_mm), 1)
        for share in TRAVEL_SHARES
    )


def read_range(text: str, focal_length_mm: float) -> float:
    """Parse a range in mm. Raises DataError for text that is no number, or a range within the focal length."""
    try:
        range_mm = float(text.strip().removesuffix("mm").strip().replace(",", "."))
    except ValueError:
        range_mm = math.nan
    if not math.isfinite(range_mm):
        raise DataError(f"{shown(text)} is no range: type a number of mm, such as 1750")
    if range_mm <= focal_length_mm:
        metres = 1000 * range_mm
        meant = (
            f"; if metres were meant, type {metres:g}"
            if focal_length_mm < metres < LONGEST_MM
            else ""
        )
        raise DataError(
            f"{range_mm:g} mm is not beyond the focal length, {focal_length_mm:g} mm{meant}"
        )
    return range_mm


def measure(
    rail: Rail,
    places: Sequence[float],
    ask: Callable[[str], float],
    say: Callable[[str], None] | None,
) -> tuple[list[float], list[float]]:
    """Return (positions, ranges) in mm, measured at given places by the person who answers `ask`.

    say: called with each misfit, whose readings are then repeated until they agree or are
    confirmed; None to ask once. Raises the errors of the rail and of `ask`.
    """
    positions = [math.nan] * len(places)
    ranges = list(positions)

    def take(k: int) -> float:
        before = ranges[k]
        positions[k] = rail.move_to(places[k])
        ranges[k] = ask(
            f"The rail stands at {positions[k]:.3f} mm. Range from the target to the lens, in mm"
        )
        return before

    for k in range(len(places)):
        take(k)
    while say is not None and (wrong := misfitting(positions, ranges)):
        listed = ", ".join(f"{ranges[k]:g} mm at {positions[k]:g} mm" for k in wrong)
        say(
            f"{listed}: {'this does not fit the others' if len(wrong) == 1 else 'these do not fit each other'}; once more"
        )
        before = {k: take(k) for k in wrong}
        if all(abs(was - ranges[k]) < TAPE_ERROR_MM for k, was in before.items()):
            break
    return positions, ranges


def misfitting(
    positions_mm: Sequence[float], ranges_mm: Sequence[float]
) -> tuple[int, ...]:
    """Return the readings to repeat: a single outlier among agreeing ones, or all."""
    every = range(len(positions_mm))
    if _agree(positions_mm, ranges_mm):
        return ()
    others = {k: [i for i in every if i != k] for k in every}
    suspects = [
        k
        for k, kept in others.items()
        if _agree([positions_mm[i] for i in kept], [ranges_mm[i] for i in kept])
    ]
    return tuple(suspects) if len(suspects) == 1 else tuple(every)


def _agree(positions_mm: Sequence[float], ranges_mm: Sequence[float]) -> bool:
    try:
        find_zero(positions_mm, ranges_mm)
    except DataError:
        return False
    return True


def find_zero(positions_mm: Sequence[float], ranges_mm: Sequence[float]) -> RailZero:
    """Return direction and zero from (n,) rail positions and (n,) ranges measured there, in mm.

    Raises DataError for fewer than two places, for a rail whose scale is wrong by more than
    a tape's error, and for a reading that misfits by as much.
    """
    at = np.asarray(positions_mm, dtype=float)
    ranges = np.asarray(ranges_mm, dtype=float)
    span_mm = float(np.ptp(at)) if at.size else 0.0
    if span_mm < 2 * TAPE_ERROR_MM:
        raise DataError(
            f"the places measured lie {span_mm:g} mm apart: take some at least {2 * TAPE_ERROR_MM:g} mm apart"
        )
    slope = float(np.polynomial.Polynomial.fit(at, ranges, 1).convert().coef[1])
    if abs(abs(slope) - 1) > 2 * TAPE_ERROR_MM / span_mm:
        raise DataError(
            f"the range changed by {slope:.3f} mm for each mm of the rail: allowed is 1 or -1 within "
            f"{2 * TAPE_ERROR_MM / span_mm:.2g}; measure again, or correct the rail's steps per mm"
        )
    direction: Literal[1, -1] = 1 if slope > 0 else -1
    zeros = ranges - direction * at
    std_mm = float(np.std(zeros, ddof=1) / np.sqrt(zeros.size)) if zeros.size > 2 else None
    misfit = tuple(float(value) for value in zeros - zeros.mean())
    worst = max(range(zeros.size), key=lambda k: abs(misfit[k]))
    if abs(misfit[worst]) > 2 * TAPE_ERROR_MM:
        raise DataError(
            f"the {ranges[worst]:g} mm measured at {at[worst]:g} mm are {misfit[worst]:+.1f} mm from where the others have "
            f"them: allowed is {2 * TAPE_ERROR_MM:g}; measure again"
        )
    return RailZero(
        direction,
        float(zeros.mean()),
        std_mm,
        abs(slope),
        misfit,
        tuple(float(mm) for mm in at),
    )
