"""Where to maximise the likelihood from: a plain loop over a record of what was tried.

No start is ever at zero: there the likelihood has a saddle, every even mode's derivative vanishes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from labkit.imaging.optics import Optics
from labkit.imaging.parts import Part
from labkit.imaging.warp import Pose
from labkit.inference.cone import Freed, free_cone
from labkit.inference.fisher_scoring import Problem, Solution, Start, State, maximize
from labkit.inference.goodness_of_fit import Verdict, judge
from labkit.inference.missing_parts import calls
from labkit.inference.phase_retrieval import PhaseRetrieval, Retrieved
from labkit.inference.sketch import Sketches, sweep
from labkit.types import Floats

# RMS of random starts, at the light's own wavelength; about half of them end in the best optimum
RANDOM_WAVES = (0.1, 0.3)
SEARCH_STEPS = 25  # of a maximisation while searching: those that end in the best optimum take 10 to 20
SEARCH_TOLERANCE = 0.3  # standard errors; a sketch's optimum is 0.001 to 0.002 waves, about one, from the whole band's
SWEPT = 3  # best values of the sweep that are started from: the right one was among them on every session tried
PLAUSIBLE = 0.005  # of a sweep's excess variance is left by right optima of sketches, more by wrong ones
PREDICTED_WAVES = 0.04  # RMS, of an end's modes from those predicted: wrong optima are farther
ALIKE = 2  # the same where the other modes are known
# starts that come back to the best optimum: then it is returned, accepted or not. A better one to which as many starts lead
# has escaped that many with a chance of 1 in 2^8
ENOUGH = 8
CALLED_FOR = 10.0  # log-likelihood that parts of a camera must gain: chance gains as much once in 20 000 pictures
SAME_OPTIMUM = 0.5  # log-likelihoods that differ by less, which is one standard error, belong to one optimum


@dataclass(frozen=True)
class Outcome:
    """A maximum of the whole likelihood with its cone freed, judged."""

    freed: Freed
    verdict: Verdict

    @property
    def relative(self) -> Sequence[Floats]:
        """Images (pixels,) of the used pixels of each frame."""
        return self.freed.solution.relative


@dataclass(frozen=True, eq=False)
class Record:
    """What a search has done so far.

    given: states to start from, the most promising first; band: share of the pass band of the problems they are for.
    ends: of maximisations from the first of them. starts: made so far. optima: (waves, minus log-likelihood) of those that
    further starts ended in. best: the likeliest maximum of the whole likelihood, None before the first. tried: states that the
    whole likelihood was maximised from, and the log-likelihood reached. returns: starts that came back to the best.
    """

    given: tuple[State, ...]
    band: float = 1.0
    ends: tuple[Solution, ...] = ()
    starts: int = 0
    optima: tuple[tuple[Floats, float], ...] = ()
    best: Outcome | None = None
    tried: tuple[tuple[State, float], ...] = ()
    returns: int = 0

    @property
    def settled(self) -> bool:
        """Whether starts came back to the best maximum often enough: then it is returned, accepted or not."""
        return self.returns >= ENOUGH

    @property
    def accepted(self) -> bool:
        """Whether the best maximum is believed: then the search is over."""
        return self.best is not None and self.best.verdict.accepted


@dataclass(frozen=True, eq=False)
class Search:
    """What does not change in a search. whole: the problem of all frames; f_number_std: relative error of its cone; poses: as
    first known, one a frame; first: a state of the first frame without wavefront; rng: for random starts; max_starts: about
    so many, where the best is rejected; ends_at: no start is made after this `process_time`, which no busy machine shortens;
    missing: parts of a camera that are tried where residuals reject an optimum, so that a poor model is not taken for a wrong
    optimum; alone: whether no frames of other ranges will tell a wrong optimum."""

    whole: Problem
    f_number_std: float
    sketches: Sketches
    poses: Sequence[Pose]
    first: State
    rng: np.random.Generator
    max_starts: int
    ends_at: float
    missing: tuple[Part, ...]
    alone: bool
    progress: Callable[[str], None]

    def run(self, given: Sequence[State], alike: Sequence[State] = ()) -> Record:
        """The record of a search from states that other frames of the lens predict, or else from a sweep over defocus.

        alike: states whose defocus is not known: the other modes are tried at each defocus of a sweep. Where none of all
        these leads to an end that is accepted, or is as predicted, the search is as from nothing.
        """
        record = Record(())
        for predicted, state in self._predicted(given, alike):
            record = self._tried(replace(record, starts=record.starts + 1), state)
            if record.accepted or (record.best is not None and _as_predicted(record.best, predicted)):
                return record
        for step in (self._swept, self._retrieved_near_focus, self._best_of_given, self._from_further_starts):
            if record.accepted or record.settled or (self.late and record.best is not None):
                break
            record = step(record)
        return record

    @property
    def late(self) -> bool:
        """Whether the search has had its time."""
        return process_time() > self.ends_at

    def _predicted(self, given: Sequence[State], alike: Sequence[State]) -> Iterator[tuple[State, State]]:
        """What is predicted, and where to begin: there with its pose settled, or, where a defocus is not known, at the ends in
        sketches of the best of a sweep."""
        sketches = self.sketches
        for state in given:
            yield state, settle(sketches.problem(state, sketches.band), state)
        for one in alike:
            for state in sweep(sketches, one)[:ALIKE]:
                yield one, _searched_from(sketches.problem(state, sketches.band), state).state

    def _swept(self, record: Record) -> Record:
        """Where no state is given: the sweep's best, the first of them carried on if its sketch is plausible.

        Not of a lone frame near focus: there wrong optima are so close that its residuals hardly tell them.
        """
        if record.given:
            return record
        self.progress("defocus sweep")
        sketches = self.sketches
        given = tuple(sweep(sketches, self.first)[:SWEPT])
        end = _searched_from(sketches.problem(given[0], sketches.band), given[0])
        record = replace(record, given=given, band=sketches.band, ends=(end,), starts=record.starts + 1)
        plausible = self._excess(end.state) < PLAUSIBLE * self._excess(given[0])
        doubtful = self.alone and sketches.near(end.state)
        return self._tried(record, end.state) if plausible and not doubtful else record

    def _retrieved_near_focus(self, record: Record) -> Record:
        """Near focus: from the small problem, begun at the given wavefronts."""
        first = record.given[0]
        if not self.sketches.near(first):
            return record
        settled = settle(self.sketches.problem(first, self.sketches.band), first)
        return self._retrieved(record, settled, [state.waves for state in record.given])

    def _best_of_given(self, record: Record) -> Record:
        """The likeliest end of maximisations from all given states."""
        rest = record.given[len(record.ends) :]
        ends = [_searched_from(self.sketches.problem(state, record.band), state) for state in rest]
        record = replace(record, ends=(*record.ends, *ends), starts=record.starts + len(ends))
        return self._tried(record, _likeliest(record.ends))

    def _from_further_starts(self, record: Record) -> Record:
        """Far from focus the small problem is not small, and whole maximisations stay."""
        best = _likeliest(record.ends)
        if not self.sketches.near(best):
            return self._maximised_again(record, best)
        return record if self.sketches.near(record.given[0]) else self._retrieved(record, best, [])

    def _retrieved(self, record: Record, state: State, given: Sequence[Floats]) -> Record:
        """Candidates of the small problem at a state's pose, until one is accepted."""
        sketches, before, retrieved = self.sketches, record.starts, Retrieved(tuple(given))
        small = PhaseRetrieval.prepare(sketches.optics, sketches.target, sketches.frame, sketches.noise, state)
        while not (record.accepted or record.settled or self.late):
            retrieved = small.to_next_candidate(retrieved, self.rng)
            if retrieved.candidate is None:
                break
            optima = tuple((o.state.waves, o.misfit / 2) for o in retrieved.optima)
            record = replace(record, starts=before + retrieved.starts, optima=optima)
            self.progress(f"start {record.starts}")
            record = _with_returns(self._tried(record, retrieved.candidate), retrieved)
        return record

    def _maximised_again(self, record: Record, state: State) -> Record:
        """From reversed defocus and from random starts, until an end is accepted or the best comes back time and again."""
        sketches, problem = self.sketches, self.sketches.problem(state, 1.0)
        best = maximize(problem, state, max_steps=SEARCH_STEPS, tolerance=SEARCH_TOLERANCE)
        record = replace(record, optima=((best.state.waves, -best.objective),))
        origin, made = best.state, 0
        while not (record.accepted or record.settled or self.late) and record.starts < self.max_starts:
            end = _searched_from(problem, _further_start(origin, made, sketches.optics, self.rng))
            made += 1
            record = _with_optimum(replace(record, starts=record.starts + 1), end)
            self.progress(f"start {record.starts} of {self.max_starts} at most")
            if end.objective > best.objective + SAME_OPTIMUM:
                best = end
                record = replace(self._tried(record, end.state), returns=0)
            elif end.objective > best.objective - SAME_OPTIMUM:
                record = replace(record, returns=record.returns + 1)
        return record

    def _excess(self, sketched: State) -> float:
        """Of variance, in a sketch: what a state leaves unexplained."""
        problem = self.sketches.problem(sketched, self.sketches.band)
        return judge(problem, sketched, problem.relative(sketched)).excess

    def _tried(self, record: Record, candidate: State) -> Record:
        """The record after the whole likelihood was maximised from a state of the first frame, all poses first, and judged."""
        self.progress("at full resolution")
        drift, as_many = candidate.poses[0].v - self.poses[0].v, np.ones(len(self.poses))
        state = replace(
            candidate,
            poses=(candidate.poses[0], *(p.moved(drift) for p in self.poses[1:])),
            scales=candidate.scales * as_many,
            ambients=candidate.ambients * as_many,
        )
        if len(self.poses) > 1:
            rough = self.sketches.problem(candidate, self.sketches.band)
            state = settle(replace(rough, frames=self.whole.frames), state)
        outcome = self._freed(self.whole, state)
        if not outcome.verdict.accepted and self.missing:
            outcome = self._with_missing(outcome)
        record = replace(record, tried=(*record.tried, (candidate, outcome.freed.solution.objective)))
        if record.best is not None and outcome.freed.solution.objective <= record.best.freed.solution.objective:
            return record
        return replace(record, best=outcome)

    def _freed(self, problem: Problem, state: State) -> Outcome:
        """The maximum near a state, judged."""
        freed = free_cone(problem, Start(state), self.f_number_std)
        if not freed.solution.converged:
            near = maximize(problem, state, exact=False)
            freed = free_cone(problem, near.begun or Start(near.state), self.f_number_std)
        return Outcome(freed, judge(freed.expansion.problem, freed.solution.state, freed.solution.relative))

    def _with_missing(self, plain: Outcome) -> Outcome:
        """The maximum with the missing parts free, if it then is believed. It is sought where slopes promise what is needed."""
        self.progress("with parts of the camera")
        model, state = self.whole.model, plain.freed.solution.state
        have = model.optics.parts
        missing = tuple(part for part in self.missing if part.name not in {one.name for one in have})
        if not missing:
            return plain
        promised = calls(plain.freed.expansion, [part.name for part in missing], self.f_number_std)
        if max(call.gain for call in promised.values()) < CALLED_FOR:
            return plain
        problem = replace(self.whole, model=model.shaped(replace(model.optics, parts=(*have, *missing))))
        outcome = self._freed(problem, state)
        gained = outcome.freed.solution.objective - plain.freed.solution.objective
        return plain if gained < CALLED_FOR or not outcome.verdict.accepted else outcome


def _as_predicted(best: Outcome, state: State) -> bool:
    """Whether an end has the modes that were predicted, defocus apart: then its residuals judge the model."""
    return float(np.linalg.norm((best.freed.solution.state.waves - state.waves)[1:])) < PREDICTED_WAVES


def settle(problem: Problem, start: State) -> State:
    """Pose, light and noise alone, a few steps."""
    return maximize(problem, start, free_waves=False, max_steps=4, tolerance=1.0).state


def _searched_from(problem: Problem, start: State) -> Solution:
    """Pose and light first: all freed at once, from a pose a pixel off, ended in a wrong minimum of an easy frame."""
    return maximize(problem, settle(problem, start), max_steps=SEARCH_STEPS, tolerance=SEARCH_TOLERANCE)


def _likeliest(ends: Sequence[Solution]) -> State:
    return max(ends, key=lambda end: end.objective).state


def _with_optimum(record: Record, end: Solution) -> Record:
    """The record with an end among its optima, unless it is one of them."""
    if any(abs(end.objective + misfit) <= SAME_OPTIMUM for _, misfit in record.optima):
        return record
    return replace(record, optima=(*record.optima, (end.state.waves, -end.objective)))


def _with_returns(record: Record, retrieved: Retrieved) -> Record:
    """The record, its returns those starts of the small problem whose ends led to the best maximum of the whole likelihood."""
    assert record.best is not None
    least = record.best.freed.solution.objective - SAME_OPTIMUM
    best = [state for state, objective in record.tried if objective > least]
    return replace(record, returns=sum(o.met for o in retrieved.optima if any(o.state is state for state in best)))


def _further_start(origin: State, made: int, optics: Optics, rng: np.random.Generator) -> State:
    """Where else to look: defocus reversed, which leads out of half of the wrong optima, then at random."""
    defocus = optics.noll[0] == 4
    if defocus and made == 0:
        return replace(origin, waves=origin.waves * np.where(np.arange(origin.waves.size) == 0, -1.0, 1.0))
    direction = rng.normal(size=origin.waves.size)
    waves = direction / np.linalg.norm(direction) * rng.uniform(*RANDOM_WAVES)
    waves *= optics.wavelength_um / optics.reference_um
    if defocus and rng.random() < 0.5:
        waves[0] = origin.waves[0]
    return replace(origin, waves=waves)
