"""Where to climb from: wavefronts that other frames predict, a sweep over defocus, a small problem near focus, chance.

Each function yields states of the first frame for a climb over the whole likelihood, the most promising first. None is at
zero: there the likelihood has a saddle, every even mode's derivative vanishes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import process_time

import numpy as np

from labkit.estimation.climb import Problem, Solution, State, maximize
from labkit.estimation.residual_tests import judge
from labkit.estimation.settings import SETTINGS
from labkit.estimation.sketches import Sketches, sweep
from labkit.estimation.small_problem import PhaseRetrieval, Retrieved
from labkit.imaging.optics import Optics
from labkit.types import Floats


@dataclass
class Log:
    """What a search has met so far.

    Attributes
    ----------
    most : starts that the search may make
    ends_at : process time after which no start is made, the user's cap
    progress : called with what is done
    starts : made so far
    tried : states that were climbed from over the whole likelihood, and the log-likelihood where each climb ended
    others : modes, waves RMS, and minus the log-likelihood of optima that starts led to
    returns : starts that came back to the best optimum
    """

    most: int
    ends_at: float
    progress: Callable[[str], None]
    starts: int = 0
    tried: list[tuple[State, float]] = field(default_factory=list)
    others: list[tuple[Floats, float]] = field(default_factory=list)
    returns: int = 0

    @property
    def late(self) -> bool:
        """Whether the user's cap is reached."""
        return process_time() > self.ends_at

    @property
    def over(self) -> bool:
        """Whether no further start is to be made."""
        return self.late or self.settled or self.starts >= self.most

    @property
    def settled(self) -> bool:
        """Whether starts came back to the best optimum often enough."""
        return self.returns >= SETTINGS.enough_returns

    def best(self) -> list[State]:
        """States whose climbs ended in the best optimum of the whole likelihood."""
        least = max((value for _, value in self.tried), default=0.0) - SETTINGS.same_optimum
        return [state for state, value in self.tried if value > least]

    def met(self, end: Solution) -> None:
        """Note where a start ended, unless that is known."""
        if all(abs(end.objective + misfit) > SETTINGS.same_optimum for _, misfit in self.others):
            self.others.append((end.state.waves, -end.objective))


def settled(sketches: Sketches, state: State) -> State:
    """A state that other frames predict, its pose and light settled."""
    return settle(sketches.problem(state, sketches.band), state)


def at_known_modes(sketches: Sketches, state: State, log: Log) -> Iterator[State]:
    """Where the modes but defocus are predicted: the best two values of a sweep over defocus."""
    for swept_state in sweep(sketches, state)[:2]:
        log.starts += 1
        yield searched_from(sketches.problem(swept_state, sketches.band), swept_state).state


def swept(sketches: Sketches, first: State, log: Log, *, doubt_near_focus: bool) -> Iterator[State]:
    """From nothing: the ends of the best values of a sweep, in part of the band; near focus those of the small problem too.

    doubt_near_focus: near focus wrong optima are so close that the residuals of one range hardly tell them apart.
    """
    log.progress("defocus sweep")
    given = sweep(sketches, first)[: SETTINGS.tried]
    near = sketches.near(given[0])
    end = searched_from(sketches.problem(given[0], sketches.band), given[0])
    log.starts += 1
    plausible = _excess(sketches, end.state) < SETTINGS.plausible_share * _excess(sketches, given[0])
    if plausible and not (doubt_near_focus and sketches.near(end.state)):
        yield end.state
    if near and not log.over:
        posed = settled(sketches, given[0])
        yield from retrieved(sketches, posed, [state.waves for state in given], log)
    ends = [end]
    for state in given[1:]:
        ends.append(searched_from(sketches.problem(state, sketches.band), state))
        log.starts += 1
    best = max(ends, key=lambda one: one.objective).state
    log.returns = max(log.returns, sum(_near(one.state, best) for one in ends) - 1)
    if best is not end.state or not plausible:
        yield best
    if log.over:
        return
    if not sketches.near(best):
        yield from at_random(sketches, best, log)
    elif not near:
        yield from retrieved(sketches, best, [], log)


def retrieved(sketches: Sketches, state: State, given: Sequence[Floats], log: Log) -> Iterator[State]:
    """Optima of the small problem at a state's pose, the best first, until starts come back to the best.

    What comes back is what leads to the best optimum of the whole likelihood.
    """
    small = PhaseRetrieval.prepare(sketches.optics, sketches.target, sketches.frame, sketches.noise, state)
    before, made = log.starts, Retrieved(tuple(given))
    rng = np.random.default_rng(sketches.seed)
    while not (log.late or log.settled):
        made = small.to_next_candidate(made, rng)
        log.starts = before + made.starts
        log.others = [(optimum.state.waves, optimum.misfit / 2) for optimum in made.optima]
        if made.candidate is not None:
            log.progress(f"start {log.starts}")
            yield made.candidate
        best = log.best()
        log.returns = sum(optimum.met for optimum in made.optima if any(optimum.state is one for one in best))
        if made.candidate is None:
            break


def at_random(sketches: Sketches, state: State, log: Log) -> Iterator[State]:
    """From reversed defocus and at random, until the best end of one frame comes back time and again."""
    problem = sketches.problem(state, 1.0)
    best = maximize(problem, state, max_steps=SETTINGS.search_steps, tolerance=SETTINGS.settled_stds)
    log.met(best)
    origin, made, log.returns = best.state, 0, 0
    rng = np.random.default_rng(sketches.seed)
    while not log.over:
        end = searched_from(problem, further_start(origin, made, sketches.optics, rng))
        made += 1
        log.starts += 1
        log.met(end)
        log.progress(f"start {log.starts} of {log.most} at most")
        if end.objective > best.objective + SETTINGS.same_optimum:
            best, log.returns = end, 0
            yield end.state
        elif end.objective > best.objective - SETTINGS.same_optimum:
            log.returns += 1


def settle(problem: Problem, start: State) -> State:
    """Climb a few steps in pose, light and noise alone."""
    return maximize(problem, start, free_waves=False, max_steps=4, tolerance=1.0).state


def searched_from(problem: Problem, start: State) -> Solution:
    """Climb from a start, pose and light first.

    All freed at once, from a pose a pixel off, ended in a wrong minimum of an easy frame.
    """
    return maximize(problem, settle(problem, start), max_steps=SETTINGS.search_steps, tolerance=SETTINGS.settled_stds)


def further_start(origin: State, made: int, optics: Optics, rng: np.random.Generator) -> State:
    """The start after `made` others: defocus reversed, which leads out of half of the wrong optima, then at random."""
    defocus = optics.noll[0] == 4
    if defocus and made == 0:
        return replace(origin, waves=origin.waves * np.where(np.arange(origin.waves.size) == 0, -1.0, 1.0))
    direction = rng.normal(size=origin.waves.size)
    waves = direction / np.linalg.norm(direction) * rng.uniform(*SETTINGS.start_waves)
    waves *= optics.wavelength_um / optics.reference_um
    if defocus and rng.random() < 0.5:
        waves[0] = origin.waves[0]
    return replace(origin, waves=waves)


def _near(state: State, other: State) -> bool:
    """Whether two states have one wavefront."""
    return bool(np.linalg.norm(state.waves - other.waves) < SETTINGS.other_optimum_waves)


def _excess(sketches: Sketches, state: State) -> float:
    """Variance that a state leaves unexplained in part of the band."""
    problem = sketches.problem(state, sketches.band)
    return judge(problem, state, problem.relative(state)).excess
