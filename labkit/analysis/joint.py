"""A climb over all frames of a session at once: does the estimate from two levels lose anything?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.lens_fit import LensFit, fit_lens
from labkit.analysis.local_fits import LocalFit, Task, problem_at
from labkit.analysis.session_fits import SessionFits
from labkit.errors import LostTasksError
from labkit.execute import Run
from labkit.imaging.optics import Optics
from labkit.inference.cone import Measured, expand
from labkit.inference.fisher_scoring import Start, State
from labkit.types import Floats, Progress

ROUNDS = 6
SETTLED_STDS = 0.02  # the climb ends with a step shorter than this in every number


@dataclass(frozen=True)
class Leg:
    """One member's part of a step: where it stands, and the values, as of `Measured`, that the session's step gives it. poor:
    whether the model does not explain its frames."""

    task: Task
    state: State
    optics: Optics
    values: Floats
    poor: bool


@dataclass(frozen=True)
class Reached:
    """Where a leg ended, and what the likelihood is about it."""

    state: State
    optics: Optics
    measured: Measured
    log_likelihood: float


@dataclass(frozen=True)
class Joint:
    """The end of the climb. lens: the session there; differences: from the two levels, in standard errors, by number;
    log_likelihoods: of all frames, after each step."""

    lens: LensFit
    differences: dict[str, float]
    log_likelihoods: tuple[float, ...]


def climb(session: SessionFits, run: Run, progress: Progress) -> Joint:
    """Gauss-Newton over everything at once, from the two levels' end.

    The numbers of the session are few, and each frame's own (pose, light, noise) touch no other: eliminated member by member,
    they leave the session's least squares, with each member's likelihood expanded anew about where the session has it.
    Raises ValueError for a session without a lens.
    """
    if session.lens is None:
        raise ValueError("the fits have no lens in common: there is nothing to climb together")
    first = lens = session.lens
    places, likelihoods = [(f.fit.state, f.fit.optics) for f in _members(session)], list[float]()
    for done in range(ROUNDS):
        progress(done, ROUNDS, "climbing jointly")
        before, reached = lens, _all_reached(session, lens, places, run)
        places = [(r.state, r.optics) for r in reached]
        likelihoods.append(sum(r.log_likelihood for r in reached) - 0.5 * _prior_chi2(lens))
        lens = _lens_of(reached, first)
        if max(_differences(lens, before).values()) < SETTLED_STDS:
            break
    return Joint(lens, _differences(lens, first), tuple(likelihoods))


def refined(session: SessionFits, run: Run) -> SessionFits:
    """With the lens after the climb's first step, where parts of the camera were fitted.

    In squares of a filter's spread a likelihood is less of a parabola than in all else, and the session's spread lies beyond
    what some fits alone make of it.
    """
    if session.lens is None or not any(f.fit.optics.shared or f.fit.optics.panel for f in _members(session)):
        return session
    places = [(f.fit.state, f.fit.optics) for f in _members(session)]
    try:
        reached = _all_reached(session, session.lens, places, run)
    except LostTasksError:  # for lack of memory: the two levels' end stays
        return session
    return replace(session, lens=_lens_of(reached, session.lens))


def _members(session: SessionFits) -> list[LocalFit]:
    return [session.fits[k] for k in session.members]


def _all_reached(
    session: SessionFits, lens: LensFit, places: Sequence[tuple[State, Optics]], run: Run
) -> list[Reached]:
    """From where members stand, at a lens's values for them."""
    members, values = lens.model.members, lens.model.predicted(lens.theta)
    legs = [
        Leg(fit.task, state, optics, value, bool(member.measured.model.size))
        for fit, (state, optics), value, member in zip(_members(session), places, values, members, strict=True)
    ]
    done = dict(run(reach, legs))
    return [done[k] for k in range(len(legs))]


def _lens_of(reached: Sequence[Reached], like: LensFit) -> LensFit:
    """By the laws of another, of the same members where they have got to."""
    members = [replace(m, measured=r.measured) for m, r in zip(like.model.members, reached, strict=True)]
    return fit_lens(members, like.model.stated, shared=like.model.shared, paraxial=like.model.paraxial)


def reach(leg: Leg) -> Reached:
    """Step a member's own parameters to where they are likeliest at the session's values, and expand there."""
    state, optics = expand(problem_at(leg.task, leg.optics, leg.state), Start(leg.state)).at(leg.values)
    problem = problem_at(leg.task, optics, state)
    expansion = expand(problem, Start(state))
    measured = expansion.measured()
    return Reached(state, optics, expansion.poor(measured) if leg.poor else measured, expansion.objective)


def _prior_chi2(lens: LensFit) -> float:
    rest = lens.residuals[-len(lens.model.columns) :]
    return float(rest @ rest)


def _differences(one: LensFit, other: LensFit) -> dict[str, float]:
    """Of every number, in standard errors."""
    names = [" ".join(map(str, (c.kind, *c.of))) for c in one.model.columns]
    std = np.sqrt(np.diag(other.covariance))
    return dict(zip(names, np.abs((one.theta - other.theta) / std).tolist(), strict=True))
