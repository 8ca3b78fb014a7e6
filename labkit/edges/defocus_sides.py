"""Possible sides of best focus of a defocus, and its errors near best focus, where the likelihood is no parabola.

Near best focus the information on defocus vanishes, and the curvature at the likeliest value is no guide: both sides of best
focus run together, or one hides as a shoulder of the other. So the likelihood is followed along defocus, all else fitted at
each value. The error of a side is the RMS distance of its values from the likeliest, all being equally likely beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from labkit.edges.edge_fit import ROUGHLY, EdgeFit, EdgeState, fit_edges
from labkit.edges.ranges import Side, symmetric_error
from labkit.types import Floats

DEEPEST = 8.0  # fall of a log-likelihood beyond which values are excluded
VALLEY = 0.3  # depth of a log-likelihood's valley that parts two sides
PROBED, BENT = 2.0, 0.6
"""Distance in standard errors by the curvature, and departure of the log-likelihood from a parabola there."""

WIDEST = 0.1  # waves RMS: a larger error by the curvature shows that the information has vanished
STEPS = 0.5 ** np.arange(1.0, 5.0)
"""Steps in errors by the curvature; each is tried if the step before gave too few values."""

ENOUGH = 8  # values within half of DEEPEST
MOST_VALUES, FINE = 40, 2001  # on either side; of the curve through them


def sides_of(ends: Sequence[EdgeFit]) -> tuple[Side, ...]:
    """Return the sides of the ends of a fit with a common defocus, likelier first."""
    sides: list[Side] = []
    straight = []
    followed: list[tuple[float, float]] = []

    def known(end: EdgeFit) -> bool:
        return any(low <= end.defocus()[0] <= high for low, high in followed)

    for end in ends:
        if _is_parabola(end, 0):
            straight.append(end)
        elif not known(end):
            values, likelihood = _profile(end, 0)
            followed.append((values[0], values[-1]))
            sides += _sides(values, likelihood)
    sides += [side_of(end) for end in straight if not known(end)]
    return _likelier_first(sides)


def side_of(fit: EdgeFit, depth: int = 0) -> Side:
    """Return the side of a fit, its error by the curvature, or by the square of defocus if no other mode is known."""
    value, std = fit.defocus(depth)
    if not np.any(fit.problem.lens.mean):
        std = symmetric_error(value, std)
    return Side(value, std, fit.objective)


def near_focus(fit: EdgeFit, depth: int = 0) -> tuple[Side, ...] | None:
    """Return the sides near a fit's own, likelier first; None away from focus, where `side_of` suffices."""
    return None if _is_parabola(fit, depth) else _sides(*_profile(fit, depth))


def _is_parabola(fit: EdgeFit, depth: int) -> bool:
    """Return whether the likelihood falls on either side as its curvature predicts, or both sides are the same by symmetry."""
    if not np.any(fit.problem.lens.mean):
        return True
    best, std = fit.defocus(depth)
    if not std < WIDEST:
        return False
    ends = [_held(fit, fit.state, depth, best + by * std) for by in (-PROBED, PROBED)]
    return all(abs(fit.objective - end.objective - PROBED**2 / 2) < BENT for end in ends)


def _profile(fit: EdgeFit, depth: int) -> tuple[Floats, Floats]:
    """Return values of defocus, ascending, and the log-likelihood of each."""
    best, std = fit.defocus(depth)
    found = {best: fit}
    for step in STEPS * np.fmin(std, WIDEST):
        for sign in (-1, 1):  # outwards, until values are excluded
            for value in best + sign * step * np.arange(1, MOST_VALUES):
                if value not in found:
                    nearest = min(found, key=lambda known: abs(known - value))
                    found[value] = _held(fit, found[nearest].state, depth, value)
                top = max(of.objective for of in found.values())
                if top - found[value].objective > DEEPEST:
                    break
        values = np.array(sorted(found))
        likelihood = np.array([found[value].objective for value in values])
        if np.sum(likelihood > likelihood.max() - DEEPEST / 2) >= ENOUGH:
            break
    return values, likelihood


def _held(fit: EdgeFit, start: EdgeState, depth: int, value: float) -> EdgeFit:
    """Fit everything else at a defocus."""
    defoci = start.defoci.copy()
    defoci[depth] = value
    held = (int(start.places.defoci[depth]),)
    return fit_edges(fit.problem, replace(start, defoci=defoci), ROUGHLY, held=held)


def _sides(values: Floats, likelihood: Floats) -> tuple[Side, ...]:
    """Return the sides of a likelihood known at some values, likelier first."""
    at = np.linspace(values[0], values[-1], FINE)
    log = CubicSpline(values, likelihood)(at)
    top = int(np.argmax(log))
    valleys = []
    for outwards in (np.arange(top, -1, -1), np.arange(top, FINE)):
        climbs = log[outwards] - np.minimum.accumulate(log[outwards])
        other = int(np.argmax(climbs))
        if climbs[other] > VALLEY and log[outwards[other]] > log[top] - DEEPEST:
            valleys.append(int(outwards[np.argmin(log[outwards[: other + 1]])]))
    sides = []
    for part in np.split(np.arange(FINE), sorted(valleys)):
        best = part[np.argmax(log[part])]
        weight = np.exp(log[part] - log[best])
        variance = weight @ (at[part] - at[best]) ** 2 / weight.sum()
        sides.append(Side(float(at[best]), float(np.sqrt(variance)), float(log[best])))
    return _likelier_first(sides)


def _likelier_first(sides: Sequence[Side]) -> tuple[Side, ...]:
    return tuple(sorted(sides, key=lambda side: -side.log_likelihood))
