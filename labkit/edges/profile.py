"""What a picture says of a defocus near best focus, where its likelihood is no parabola.

There the information on defocus vanishes, and with it what the curvature at the likeliest value tells: the two sides of best
focus run together, or one hides as a shoulder of the other. So the likelihood is followed along defocus, all else fitted at
each. A side's error is how far its defoci lie from the likeliest, RMS, every one being as likely beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from labkit.edges.joint import ROUGHLY, EdgeFit, EdgeState, fit_edges
from labkit.edges.ranges import Side, symmetric_error
from labkit.types import Floats

DEEPEST = 8.0  # of a log-likelihood: what is less likely by more is out of the question
VALLEY = 0.3  # of a log-likelihood below the lower of two sides, from which on they are two
PROBED, BENT = 2.0, 0.6
"""Standard errors by the curvature, and how far the log-likelihood may be from a parabola's there."""

WIDEST = 0.1  # waves RMS: a larger error by the curvature is that of information that has vanished
STEPS = 0.5 ** np.arange(1.0, 5.0)
"""Of an error by the curvature, each taken where the one before gave too few values."""

ENOUGH = 8  # values within half of DEEPEST
MOST_VALUES, FINE = 40, 2001  # on either hand; of the curve through them


def sides_of(ends: Sequence[EdgeFit]) -> tuple[Side, ...]:
    """Of the ends of a fit with one defocus, likelier first."""
    sides: list[Side] = []
    followed: list[tuple[float, float]] = []

    def seen(end: EdgeFit) -> bool:
        return any(low <= end.defocus()[0] <= high for low, high in followed)

    straight = [_is_parabola(end, 0) for end in ends]
    for end in (
        end for end, is_straight in zip(ends, straight, strict=True) if not is_straight
    ):
        if not seen(end):
            values, likelihood = _profile(end, 0)
            followed.append((values[0], values[-1]))
            sides += _sides(values, likelihood)
    sides += [
        side_of(end)
        for end, is_straight in zip(ends, straight, strict=True)
        if is_straight and not seen(end)
    ]
    return tuple(sorted(sides, key=lambda side: -side.log_likelihood))


def side_of(fit: EdgeFit, depth: int = 0) -> Side:
    """By the curvature. Where no other even mode is known, only the square of defocus is near zero."""
    value, std = fit.defocus(depth)
    return Side(
        value,
        std if np.any(fit.problem.lens.mean) else symmetric_error(value, std),
        fit.objective,
    )


def near_focus(fit: EdgeFit, depth: int = 0) -> tuple[Side, ...] | None:
    """The side or sides of best focus near a fit's own, likelier first; None away from focus, where `side_of` says it all."""
    return None if _is_parabola(fit, depth) else _sides(*_profile(fit, depth))


def _is_parabola(fit: EdgeFit, depth: int) -> bool:
    """Whether the likelihood falls off on either hand as its curvature has it, or where no other mode is known, both sides of
    best focus then being the same."""
    if not np.any(fit.problem.lens.mean):
        return True
    best, std = fit.defocus(depth)
    if not std < WIDEST:
        return False
    fallen = [
        fit.objective - _held(fit, fit.state, depth, best + by * std)[1]
        for by in (-PROBED, PROBED)
    ]
    return max(abs(of - PROBED**2 / 2) for of in fallen) < BENT


def _profile(fit: EdgeFit, depth: int) -> tuple[Floats, Floats]:
    """Values of defocus, ascending, and the log-likelihood of each."""
    best, std = fit.defocus(depth)
    found = {best: (fit.state, fit.objective)}
    for step in STEPS * np.fmin(std, WIDEST):
        for sign in (-1, 1):
            _follow(fit, depth, found, best + sign * step * np.arange(1, MOST_VALUES))
        values = np.array(sorted(found))
        likelihood = np.array([found[value][1] for value in values])
        if np.sum(likelihood > likelihood.max() - DEEPEST / 2) >= ENOUGH:
            break
    return values, likelihood


def _follow(
    fit: EdgeFit, depth: int, found: dict[float, tuple[EdgeState, float]], values: Floats
) -> None:
    """Add values, one after another, to what was found, until they are out of the question."""
    for value in values:
        nearest = min(found, key=lambda known: abs(known - value))
        found[value] = (
            found[nearest]
            if nearest == value
            else _held(fit, found[nearest][0], depth, value)
        )
        if max(likelihood for _, likelihood in found.values()) - found[value][1] > DEEPEST:
            break


def _held(
    fit: EdgeFit, start: EdgeState, depth: int, value: float
) -> tuple[EdgeState, float]:
    """Everything else fitted to a defocus, and the log-likelihood there."""
    defoci = start.defoci.copy()
    defoci[depth] = value
    place = start.modes.size + start.log_noise.size + depth
    end = fit_edges(
        fit.problem, replace(start, defoci=defoci), tolerance=ROUGHLY, held=(place,)
    )
    return end.state, end.objective


def _sides(values: Floats, likelihood: Floats) -> tuple[Side, ...]:
    at = np.linspace(values[0], values[-1], FINE)
    log = CubicSpline(values, likelihood)(at)
    parts = np.split(np.arange(FINE), _valleys(log))
    return tuple(
        sorted(
            (_about_likeliest(at[part], log[part]) for part in parts),
            key=lambda side: -side.log_likelihood,
        )
    )


def _valleys(log: Floats) -> list[int]:
    """Where the sides part: at the lowest place between the highest and the highest that is beyond a valley."""
    top = int(np.argmax(log))
    found = []
    for beyond in (
        np.arange(top, -1, -1),
        np.arange(top, len(log)),
    ):  # away from the top, on either hand
        climbs = log[beyond] - np.minimum.accumulate(log[beyond])
        other = int(np.argmax(climbs))
        if climbs[other] > VALLEY and log[beyond[other]] > log[top] - DEEPEST:
            found.append(int(beyond[np.argmin(log[beyond[: other + 1]])]))
    return sorted(found)


def _about_likeliest(at: Floats, log: Floats) -> Side:
    """The likeliest value, and how far others lie from it, RMS."""
    best, weight = int(np.argmax(log)), np.exp(log - log.max())
    return Side(
        float(at[best]),
        float(np.sqrt(weight @ (at - at[best]) ** 2 / weight.sum())),
        float(log[best]),
    )
