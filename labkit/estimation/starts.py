"""Starts of climbs: predictions from other frames, a sweep over defocus, a small problem near focus, random wavefronts.

Each function yields states of the first frame for a climb over the whole likelihood, the most promising first. No start is at
zero: the likelihood has a saddle there, for the derivatives by all even modes vanish. Sketches, coarse models of one frame,
make a search quick.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time

import numpy as np

from labkit.estimation.climb import NoisePrior, Problem, Solution, State, maximize
from labkit.estimation.likelihood import FrameData
from labkit.estimation.prior import Prior
from labkit.estimation.residuals import judge
from labkit.estimation.settings import SETTINGS
from labkit.estimation.small_problem import PhaseRetrieval, Retrieved, random_wavefront
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import Pose
from labkit.imaging.window import WINDOW_AIRY
from labkit.jobs.pace import in_words
from labkit.optics.wavefront import DEFOCUS, FARTHEST_WAVES
from labkit.target.target import Target
from labkit.types import Floats


@dataclass
class Sketches:
    """Coarse problems of one frame: part of the pass band, or a narrow PSF window.

    Each problem is built on first use and cached; it depends on band and window only.

    Attributes
    ----------
    optics : lens, light and sensor
    target : the target as shown
    frame : counts, with calibration
    pose : approximate pose of the target
    noise : calibrated noise
    seed : seed of random starts
    """

    optics: Optics
    target: Target
    frame: FrameData
    pose: Pose
    noise: NoisePrior
    seed: int | Sequence[int] = 1
    _made: dict[tuple[float, float], Problem] = field(default_factory=dict, repr=False)

    @property
    def band(self) -> float:
        """Share of the pass band for sketches, at least 1.5 times the Nyquist frequency of the pixels."""
        return min(
            1.0,
            max(SETTINGS.sketch_band, 0.75 / self.optics.pitch_um * self.optics.airy_um),
        )

    @property
    def wide(self) -> Problem:
        """The sketch for wavefronts of any defocus."""
        return self._problem(self.band, WINDOW_AIRY)

    def problem(self, state: State, band: float | None = None) -> Problem:
        """Return a problem for wavefronts similar to a state's. band: share of the pass band, None for a sketch's."""
        window_airy = (
            SETTINGS.near_window_airy
            if near_focus(self.optics, state.waves)
            else WINDOW_AIRY
        )
        return self._problem(self.band if band is None else band, window_airy)

    def holding(self, waves: Floats) -> Problem:
        """Return a sketch for a wavefront (modes,), in a window as wide as it needs."""
        return self._problem(self.band, max(WINDOW_AIRY, self.optics.window_airy(waves)))

    def _problem(self, band: float, window_airy: float) -> Problem:
        key = band, window_airy
        if key not in self._made:
            shape = self.frame.counts.shape
            model = ForwardModel.build(
                self.optics,
                self.target,
                shape,
                self.pose,
                band=band,
                window_airy=window_airy,
            )
            self._made[key] = Problem(model, (self.frame,), self.noise)
        return self._made[key]


def near_focus(optics: Optics, waves: Floats) -> bool:
    """Return whether defocus is so small that other modes decide what a picture looks like.

    Parameters
    ----------
    optics : lens and light
    waves : (modes,) waves RMS at the reference wavelength
    """
    defocus = waves[0] if optics.noll[0] == DEFOCUS else 0.0
    return bool(
        abs(defocus) * optics.reference_um <= SETTINGS.near_waves * optics.wavelength_um
    )


@dataclass
class Log:
    """Record of a search.

    Attributes
    ----------
    most : largest number of starts
    ends_at : process time after which no start is made, the user's cap
    progress : called with the step under way
    starts : number of starts so far
    tried : starts of climbs over the whole likelihood, each with the log-likelihood at the climb's end
    others : modes, waves RMS, and minus the log-likelihood of optima met so far
    returns : number of starts that returned to the best optimum
    began_s : when the search began, of the performance counter
    """

    most: int
    ends_at: float
    progress: Callable[[str], None]
    starts: int = 0
    tried: list[tuple[State, float]] = field(default_factory=list)
    others: list[tuple[Floats, float]] = field(default_factory=list)
    returns: int = 0
    began_s: float = field(default_factory=perf_counter)

    @property
    def left(self) -> str:
        """Return the time that all further starts take together, in words."""
        each_s = (perf_counter() - self.began_s) / max(self.starts, 1)
        return in_words(each_s * max(self.most - self.starts, 0))

    @property
    def late(self) -> bool:
        """Return whether the user's cap is reached."""
        return process_time() > self.ends_at

    @property
    def over(self) -> bool:
        """Return whether the search makes no further start."""
        return self.late or self.settled or self.starts >= self.most

    @property
    def settled(self) -> bool:
        """Return whether enough starts returned to the best optimum."""
        return self.returns >= SETTINGS.enough_returns

    def best(self) -> list[State]:
        """Return starts whose climbs ended in the best optimum of the whole likelihood."""
        least = max((value for _, value in self.tried), default=0.0) - SETTINGS.same_optimum
        return [state for state, value in self.tried if value > least]

    def met(self, end: Solution) -> None:
        """Record the end of a start, unless it is a known optimum."""
        if all(
            abs(end.objective + misfit) > SETTINGS.same_optimum for _, misfit in self.others
        ):
            self.others.append((end.state.waves, -end.objective))


def sweep(sketches: Sketches, start: State) -> list[State]:
    """Fit the light at each of a row of defocus values.

    The other modes are the start's. If all are 0, negative defocus is covered by the twin; else negative values are tried too.
    The row continues outwards while its last value is the best. The pose is fixed, for a pixel hardly changes the order.

    Returns
    -------
    one state for each defocus, the least sum of squares first
    """
    scale = sketches.optics.wavelength_um / sketches.optics.reference_um
    signs = (1, -1) if start.waves[1:].any() else (1,)
    values = [sign * value for value in SETTINGS.swept_waves for sign in signs]
    swept, best, outermost = list[tuple[float, State]](), np.inf, 0.0
    problem = sketches.problem(start)
    drawing = problem.draw(start)
    while values:
        value = values.pop(0)
        state = replace(start, waves=np.append(value * scale, start.waves[1:]))
        if problem is not sketches.problem(state):
            problem = sketches.problem(state)
            drawing = problem.draw(start)
        misfit, lit = fitted_light(problem, state, drawing)
        swept.append((misfit, lit))
        if misfit < best:
            best, outermost = misfit, value
        if not values and abs(outermost) == abs(value) < FARTHEST_WAVES:
            values += [sign * np.sqrt(2) * abs(value) for sign in signs]
    return [state for _, state in sorted(swept, key=lambda entry: entry[0])]


def fitted_light(
    problem: Problem, state: State, drawing: Drawing | None = None
) -> tuple[float, State]:
    """Return the least sum of squares over the light of each frame, and the state with this light if all of it is positive.

    Parameters
    ----------
    problem : the frames and their model
    state : poses and wavefront
    drawing : the target at the state's poses, if at hand
    """
    misfit, levels = 0.0, list[Floats]()
    relative = problem.relative(state, drawing)
    for frame, image in zip(problem.frames, relative, strict=True):
        light, counts = frame.illumination[frame.used], frame.counts[frame.used]
        columns = np.stack([light * image, light], axis=1)
        level = np.asarray(np.linalg.lstsq(columns, counts)[0], np.float64)
        misfit += float(np.sum((columns @ level - counts) ** 2))
        levels.append(level)
    scales, ambients = np.array(levels).T
    if scales.min() <= 0:
        return misfit, state
    return misfit, replace(state, scales=scales, ambients=ambients)


def at_known_modes(
    sketches: Sketches, state: State, log: Log, prior: Prior | None
) -> Iterator[State]:
    """Yield climbs from the two best values of a sweep over defocus, the other modes predicted. prior: of the modes."""
    for swept_state in sweep(sketches, state)[:2]:
        log.starts += 1
        yield searched_from(sketches.problem(swept_state), swept_state, prior).state


def swept(
    sketches: Sketches, first: State, log: Log, *, doubt_near_focus: bool
) -> Iterator[State]:
    """Search without any prediction.

    Climbs from the best values of a sweep over defocus, in part of the pass band, come first. Near focus, optima of the small
    problem follow; elsewhere, random starts.

    Parameters
    ----------
    sketches : coarse problems of the first frame
    first : state of the first frame, without a wavefront
    log : record of the search
    doubt_near_focus : whether to search on near focus, where wrong optima are so close to the right one that the residuals of
        one range hardly distinguish them
    """
    log.progress("defocus sweep")
    given = sweep(sketches, first)[: SETTINGS.tried]
    near = near_focus(sketches.optics, given[0].waves)
    end = searched_from(sketches.problem(given[0]), given[0])
    log.starts += 1
    plausible = _excess(sketches, end.state) < SETTINGS.plausible_share * _excess(
        sketches, given[0]
    )
    believed = plausible and not (
        doubt_near_focus and near_focus(sketches.optics, end.state.waves)
    )
    if believed:
        yield end.state
    if near and not log.over:
        posed = settled(sketches.problem(given[0]), given[0]).state
        yield from retrieved(sketches, posed, [state.waves for state in given], log)
    ends = [end]
    for state in given[1:]:
        ends.append(searched_from(sketches.problem(state), state))
        log.starts += 1
    best = max(ends, key=lambda one: one.objective).state
    log.returns = max(log.returns, sum(_near(one.state, best) for one in ends) - 1)
    if best is not end.state or not believed:
        yield best
    if log.over:
        return
    if not near_focus(sketches.optics, best.waves):
        yield from at_random(sketches, best, log)
    elif not near:
        yield from retrieved(sketches, best, [], log)


def retrieved(
    sketches: Sketches, state: State, given: Sequence[Floats], log: Log
) -> Iterator[State]:
    """Yield optima of the small problem at a state's pose, the best first, until enough starts return to the best.

    A start returns if its optimum of the small problem leads to the best optimum of the whole likelihood.
    """
    small = PhaseRetrieval.prepare(
        sketches.optics, sketches.target, sketches.frame, sketches.noise, state
    )
    before = log.starts
    made = Retrieved(tuple(given))
    rng = np.random.default_rng(sketches.seed)
    while not (log.late or log.settled):
        made = small.to_next_candidate(made, rng)
        log.starts = before + made.starts
        log.others = [(optimum.state.waves, optimum.misfit / 2) for optimum in made.optima]
        if made.candidate is not None:
            log.progress(f"start {log.starts}")
            yield made.candidate
        best = log.best()
        log.returns = sum(
            optimum.met
            for optimum in made.optima
            if any(optimum.state is one for one in best)
        )
        if made.candidate is None:
            break


def at_random(sketches: Sketches, state: State, log: Log) -> Iterator[State]:
    """Yield ends of starts with reversed defocus and random modes, until enough starts return to the best end of one frame."""
    problem = sketches.problem(state, 1.0)
    best = maximize(
        problem, state, max_steps=SETTINGS.most_steps, tolerance=SETTINGS.settled_stds
    )
    log.met(best)
    origin = best.state
    made = 0
    log.returns = 0
    rng = np.random.default_rng(sketches.seed)
    while not log.over:
        end = searched_from(problem, further_start(origin, made, sketches.optics, rng))
        made += 1
        log.starts += 1
        log.met(end)
        log.progress(f"start {log.starts} of {log.most} at most, up to {log.left} more")
        if end.objective > best.objective + SETTINGS.same_optimum:
            best = end
            log.returns = 0
            yield end.state
        elif end.objective > best.objective - SETTINGS.same_optimum:
            log.returns += 1


def settled(problem: Problem, start: State) -> Solution:
    """Climb a few steps in pose, light and noise alone."""
    return maximize(problem, start, free_waves=False, max_steps=4, tolerance=1.0)


def searched_from(problem: Problem, start: State, prior: Prior | None = None) -> Solution:
    """Climb from a start, pose and light first. prior: of the modes.

    With all parameters free at once, from a pose a pixel off, a climb ended in a wrong minimum of an easy frame.
    """
    return maximize(
        problem,
        settled(problem, start).state,
        max_steps=SETTINGS.most_steps,
        tolerance=SETTINGS.settled_stds,
        prior=prior,
    )


def further_start(
    origin: State, made: int, optics: Optics, rng: np.random.Generator
) -> State:
    """Return the start after `made` others: reversed defocus, which leads out of half of the wrong optima, then random ones."""
    defocus = optics.noll[0] == DEFOCUS
    if defocus and made == 0:
        return replace(origin, waves=np.append(-origin.waves[0], origin.waves[1:]))
    waves = random_wavefront(rng, origin.waves.size)
    waves *= optics.wavelength_um / optics.reference_um
    if defocus and rng.random() < 0.5:
        waves[0] = origin.waves[0]
    return replace(origin, waves=waves)


def _near(state: State, other: State) -> bool:
    """Return whether two states have one wavefront."""
    return bool(np.linalg.norm(state.waves - other.waves) < SETTINGS.other_optimum_waves)


def _excess(sketches: Sketches, state: State) -> float:
    """Return the excess variance that a state leaves in part of the pass band."""
    problem = sketches.problem(state)
    return judge(problem, state, problem.relative(state)).excess
