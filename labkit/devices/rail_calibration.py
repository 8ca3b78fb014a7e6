"""Which way a rail runs, and the range when it stands at 0, from a few ranges measured by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labkit.devices.protocols import Travel
from labkit.errors import DataError, PlanError

TAPE_MM = 3.0
"""Measured by hand, a range may err by so much."""

ENDLESS_MM = 1e5
SHARES = (0.1, 0.5, 0.9)
"""Where along its travel a rail is measured, unless positions are given."""


@dataclass(frozen=True, slots=True)
class RailZero:
    """range = range_at_zero_mm + direction * position, with the standard error of the zero and each reading's misfit.

    std_mm is the scatter's, None for fewer than three readings; `scale` is how far the rail moved for each mm that it reports.
    """

    direction: Literal[1, -1]
    range_at_zero_mm: float
    std_mm: float | None
    scale: float
    misfit_mm: tuple[float, ...]


def stops(travel: Travel, asked_mm: Sequence[float]) -> tuple[float, ...]:
    """Positions to measure at. Raises PlanError where there are fewer than two, or one outside the travel."""
    if asked_mm:
        if len(set(asked_mm)) < 2:
            raise PlanError(f"--at {asked_mm[0]:g}: give two positions or more, far apart")
        for mm in asked_mm:
            if not travel.low_mm <= mm <= travel.high_mm:
                raise PlanError(f"--at {mm:g}: the rail goes from {travel.low_mm:g} to {travel.high_mm:g} mm")
        return tuple(asked_mm)
    if travel.high_mm - travel.low_mm > ENDLESS_MM:
        raise PlanError(
            "this rail does not report its travel: give positions to measure at, such as --at 10 --at 200 --at 390"
        )
    return tuple(round(travel.low_mm + share * (travel.high_mm - travel.low_mm), 1) for share in SHARES)


def find_zero(positions_mm: Sequence[float], ranges_mm: Sequence[float]) -> RailZero:
    """Direction and zero from (n,) rail positions and (n,) ranges measured there, in mm.

    Raises DataError for fewer than two places, or for a rail that moves otherwise than it reports by more than a tape errs.
    """
    at, ranges = np.asarray(positions_mm, dtype=float), np.asarray(ranges_mm, dtype=float)
    span_mm = float(np.ptp(at)) if at.size else 0.0
    if span_mm < 2 * TAPE_MM:
        raise DataError(f"the places measured lie {span_mm:g} mm apart: take some at least {2 * TAPE_MM:g} mm apart")
    slope = float(np.polynomial.Polynomial.fit(at, ranges, 1).convert().coef[1])
    if abs(abs(slope) - 1) > 2 * TAPE_MM / span_mm:
        raise DataError(
            f"the range changed by {slope:.3f} mm for each mm of the rail: allowed is 1 or -1 within "
            f"{2 * TAPE_MM / span_mm:.2g}; measure again, or correct the rail's steps per mm"
        )
    direction: Literal[1, -1] = 1 if slope > 0 else -1
    zeros = ranges - direction * at
    std_mm = float(np.std(zeros, ddof=1) / np.sqrt(zeros.size)) if zeros.size > 2 else None
    misfit = tuple(float(value) for value in zeros - zeros.mean())
    return RailZero(direction, float(zeros.mean()), std_mm, abs(slope), misfit)
