"""From frames and a rough pose to the wavefront: sweep defocus, climb from the likeliest, judge, try again.

No start is ever at zero: there the likelihood has a saddle, every even mode's derivative vanishes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from labkit.imaging.model import WINDOW_AIRY, ForwardModel, Optics
from labkit.imaging.warp import Pose
from labkit.inference.fisher_scoring import NoisePrior, Problem, Solution, State, maximize
from labkit.inference.goodness_of_fit import Verdict, judge
from labkit.inference.likelihood import FrameData, predict
from labkit.inference.phase_retrieval import PhaseRetrieval
from labkit.optics.zernike import is_even
from labkit.target import Target
from labkit.types import Floats

# share of the pass band in the sweep: fits from it end 0.001 to 0.002 waves from those of the whole band
SKETCH_BAND = 0.2
# RMS at the light's own wavelength; the twin covers the rest
DEFOCUS_WAVES = (0.1, 0.25, 0.45, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
FARTHEST_WAVES = 12.0
# RMS of random starts, at the light's own wavelength; about half of them end in the best optimum
RANDOM_WAVES = (0.1, 0.3)
NEAR_WAVES, NEAR_WINDOW = 0.5, 48.0  # RMS defocus up to which a PSF's window so many lambda N wide serves to search
CLIMB_STEPS = 25  # climbs that find the best optimum take 10 to 20
SWEPT = 3  # best values of the sweep that are started from
PLAUSIBLE = 0.005  # of a sweep's excess variance is left by right optima of sketches, more by wrong ones
ENOUGH = 8  # climbs from random starts that come back to the best optimum: then it is returned, accepted or not
SAME_OPTIMUM = 0.5  # log-likelihoods that differ by less belong to one optimum

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Other:
    """Another optimum that a search saw. waves: (modes,) RMS; below: by how much its log-likelihood is less, about."""

    waves: Floats
    below: float


@dataclass(frozen=True)
class WavefrontFit:
    """The wavefront of one channel at one range.

    noll: the modes; waves: (modes,) RMS at the reference wavelength; covariance: its Cramér-Rao covariance; state: all
    parameters; starts: made to find it; others: optima seen on the way, the likeliest first; relative: images (pixels,)
    of the used pixels of each frame; seconds: it took.
    """

    noll: tuple[int, ...]
    state: State
    covariance: Floats
    objective: float
    chi2_per_pixel: float
    verdict: Verdict
    starts: int
    others: tuple[Other, ...]
    relative: tuple[Floats, ...]
    seconds: float

    @property
    def waves(self) -> Floats:
        return self.state.waves

    @property
    def std(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def twin(self) -> "WavefrontFit":
        """The same fit with all even modes' signs changed: the same PSF, the same likelihood (thesis §3.6)."""
        sign = twin_signs(self.noll)
        state = replace(self.state, waves=self.waves * sign)
        return replace(self, state=state, covariance=self.covariance * np.outer(sign, sign))


def twin_signs(noll: Sequence[int]) -> Floats:
    """(modes,) -1 for the even modes, +1 for the odd ones."""
    return np.array([-1.0 if is_even(j) else 1.0 for j in noll])


def canonical(fit: WavefrontFit) -> WavefrontFit:
    """Of a fit and its twin the one whose largest even mode is positive: the rule where no range series decides."""
    even = np.where(twin_signs(fit.noll) < 0, np.abs(fit.waves), 0.0)
    return fit.twin() if fit.waves[int(np.argmax(even))] < 0 and even.any() else fit


def fit_wavefront(
    optics: Optics,
    target: Target,
    frames: Sequence[FrameData],
    poses: Sequence[Pose],
    noise: NoisePrior,
    *,
    rng: np.random.Generator,
    starts: Sequence[Floats] = (),
    max_climbs: int = 40,
    progress: Progress = lambda step: None,
) -> WavefrontFit:
    """Fit one wavefront to frames of one channel at one range.

    poses: of the target in each frame, right to about a pixel. starts: wavefronts (modes,) to climb from instead of those
    of the sweep, such as those found at other ranges. rng: for further starts, made while what was found is not accepted.
    max_climbs: of the likelihood at most before the best is returned, rejected.
    What the frames do not determine has huge errors and is rejected.
    """
    began = perf_counter()
    whole = Problem(ForwardModel.build(optics, target, frames[0].counts.shape), tuple(frames), noise)
    first = _first_state(frames[:1], poses[:1], noise, len(optics.noll))
    search = _Search(Rough(optics, target, frames[0], noise), rng, max_climbs, progress)
    best: _Outcome | None = None
    for state in search.candidates(first, [replace(first, waves=np.asarray(waves, float)) for waves in starts]):
        progress("whole band")
        outcome = _finish(whole, search.rough, state, poses)
        if best is None or outcome.solution.objective > best.solution.objective:
            best = outcome
        if best.verdict.accepted:
            break
    assert best is not None
    solution, modes = best.solution, len(optics.noll)
    covariance = solution.covariance()[:modes, :modes]
    return WavefrontFit(
        optics.noll,
        solution.state,
        covariance,
        solution.objective,
        solution.chi2_per_pixel,
        best.verdict.knowing(covariance, optics.noll),
        search.starts,
        search.others(),
        tuple(best.relative),
        perf_counter() - began,
    )


@dataclass
class Rough:
    """Quick problems to search in: one frame, part of the band or a PSF's window no wider than needed. Made once each."""

    optics: Optics
    target: Target
    frame: FrameData
    noise: NoisePrior
    _made: dict[tuple[float, float], Problem] = field(default_factory=dict)

    @property
    def sketch_band(self) -> float:
        """Share of the pass band for sketches: never less than half as much again as the pixels' own Nyquist frequency."""
        return min(1.0, max(SKETCH_BAND, 0.75 / self.optics.pitch_um * self.optics.airy_um))

    def near(self, state: State) -> bool:
        """Whether a wavefront is near enough to focus for a PSF's narrow window."""
        defocus = state.waves[0] if self.optics.noll[0] == 4 else 0.0
        return bool(abs(defocus) * self.optics.reference_um <= NEAR_WAVES * self.optics.wavelength_um)

    def problem(self, state: State, band: float) -> Problem:
        """For wavefronts of about a state's defocus."""
        key = band, NEAR_WINDOW if self.near(state) else WINDOW_AIRY
        if key not in self._made:
            shape = self.frame.counts.shape
            model = ForwardModel.build(self.optics, self.target, shape, band=band, window_airy=key[1])
            self._made[key] = Problem(model, (self.frame,), self.noise)
        return self._made[key]


@dataclass
class _Search:
    """Where to look for the optimum, the most promising first. starts: made so far; seen: optima and their misfits."""

    rough: Rough
    rng: np.random.Generator
    max_climbs: int
    progress: Progress
    starts: int = 0
    seen: list[tuple[Floats, float]] = field(default_factory=list)

    def candidates(self, first: State, given: Sequence[State]) -> Iterator[State]:
        """States from which the whole problem is worth a climb. given: where to start, instead of a sweep from first."""
        rough, climbs, band = self.rough, list[Solution](), 1.0
        if not given:
            self.progress("defocus sweep")
            given, band = sweep(rough, first)[:SWEPT], rough.sketch_band
            climbs = [self._climb_from(rough.problem(given[0], band), given[0])]
            if self._excess(climbs[0].state) < PLAUSIBLE * self._excess(given[0]):
                yield climbs[0].state
        if rough.near(given[0]):
            settled = _settle(rough.problem(given[0], rough.sketch_band), given[0])
            yield from self._retrieved(settled, [state.waves for state in given])
        climbs += [self._climb_from(rough.problem(start, band), start) for start in given[len(climbs) :]]
        best = max(climbs, key=lambda found: found.objective).state
        yield best
        if not rough.near(best):
            yield from self._climbed(best)
        elif not rough.near(given[0]):
            yield from self._retrieved(best, [])

    def others(self) -> tuple[Other, ...]:
        """Optima that were seen beside the best."""
        ordered = sorted(self.seen, key=lambda one: one[1])
        return tuple(Other(waves, misfit - ordered[0][1]) for waves, misfit in ordered[1:])

    def _climb_from(self, problem: Problem, start: State) -> Solution:
        """Pose and light first: all freed at once, from a pose a pixel off, ended in a wrong minimum of an easy frame."""
        self.starts += 1
        return maximize(problem, _settle(problem, start), max_steps=CLIMB_STEPS, tolerance=0.3)

    def _excess(self, sketched: State) -> float:
        """Of variance, in a sketch: what a state leaves unexplained."""
        problem = self.rough.problem(sketched, self.rough.sketch_band)
        return judge(problem, sketched, problem.relative(sketched)).excess

    def _retrieved(self, state: State, first: Sequence[Floats]) -> Iterator[State]:
        """Near focus: from the small problem."""
        rough, before = self.rough, self.starts
        small = PhaseRetrieval.prepare(rough.optics, rough.target, rough.frame, rough.noise, state)
        for candidate in small.candidates(first, self.rng):
            self.starts, self.seen = before + small.starts, [(o.state.waves, o.misfit / 2) for o in small.optima]
            self.progress(f"start {self.starts}")
            yield candidate

    def _climbed(self, state: State) -> Iterator[State]:
        """Far from focus, where the small problem is not small: ends of climbs, each if it is better than those before."""
        problem = self.rough.problem(state, 1.0)
        best, again = maximize(problem, state, max_steps=CLIMB_STEPS, tolerance=0.3), 0
        self.seen = [(best.state.waves, -best.objective)]
        for start in _more_starts(best, self.rough.optics, self.rng):
            if again >= ENOUGH or self.starts >= self.max_climbs:
                return
            found = self._climb_from(problem, start)
            self.progress(f"start {self.starts}")
            if all(abs(found.objective + misfit) > SAME_OPTIMUM for _, misfit in self.seen):
                self.seen.append((found.state.waves, -found.objective))
            if found.objective > best.objective + SAME_OPTIMUM:
                best, again = found, 0
                yield found.state
            else:
                again += found.objective > best.objective - SAME_OPTIMUM


def _settle(problem: Problem, start: State) -> State:
    """Pose, light and noise alone, a few steps."""
    return maximize(problem, start, free_waves=False, max_steps=4, tolerance=1.0).state


def _more_starts(found: Solution, optics: Optics, rng: np.random.Generator) -> Iterator[State]:
    """Where else to look: defocus reversed, which leads out of half of the wrong optima, then at random."""
    state, defocus = found.state, optics.noll[0] == 4
    if defocus:
        yield replace(state, waves=state.waves * np.where(np.arange(state.waves.size) == 0, -1.0, 1.0))
    while True:
        direction = rng.normal(size=state.waves.size)
        waves = direction / np.linalg.norm(direction) * rng.uniform(*RANDOM_WAVES)
        waves *= optics.wavelength_um / optics.reference_um
        if defocus and rng.random() < 0.5:
            waves[0] = state.waves[0]
        yield replace(state, waves=waves)


def sweep(rough: Rough, start: State) -> list[State]:
    """States at each of a row of defocus values, their light fitted, the one with the least sum of squares first.

    The row goes on outwards while its last value is the best. The pose is left alone: a pixel hardly changes the order.
    """
    scale, frame = rough.optics.wavelength_um / rough.optics.reference_um, rough.frame
    light, counts = frame.illumination[frame.used], frame.counts[frame.used]
    values, found, best = list(DEFOCUS_WAVES), list[tuple[float, State]](), np.inf
    while values:
        value = values.pop(0)
        state = replace(start, waves=np.append(value * scale, np.zeros(start.waves.size - 1)))
        (relative,) = rough.problem(state, rough.sketch_band).relative(state)
        columns = np.stack([light * relative, light], axis=1)
        levels = np.asarray(np.linalg.lstsq(columns, counts)[0], np.float64)
        misfit = float(np.sum((columns @ levels - counts) ** 2))
        found.append((misfit, replace(state, scales=levels[:1], ambients=levels[1:]) if levels[0] > 0 else state))
        if not values and misfit < best and value < FARTHEST_WAVES:
            values.append(1.4 * value)
        best = min(best, misfit)
    return [state for _, state in sorted(found, key=lambda one: one[0])]


def _first_state(frames: Sequence[FrameData], poses: Sequence[Pose], noise: NoisePrior, modes: int) -> State:
    """Light from the frames' own range of counts; no wavefront yet."""
    levels = np.array([np.percentile(f.counts[f.used] / f.illumination[f.used], [2, 98]) for f in frames])
    even = np.zeros(len(frames[0].departures))
    return State(np.zeros(modes), tuple(poses), levels[:, 1] - levels[:, 0], levels[:, 0], noise.centre, even)


@dataclass(frozen=True)
class _Outcome:
    """A maximum of the whole likelihood, judged. relative: images (pixels,) of the used pixels of each frame."""

    solution: Solution
    verdict: Verdict
    relative: list[Floats]


def _finish(whole: Problem, rough: Rough, found: State, poses: Sequence[Pose]) -> _Outcome:
    """A state of one frame carried to the whole problem and all its frames, their poses first; and judged."""
    drift, as_many = found.poses[0].v - poses[0].v, np.ones(len(poses))
    state = replace(
        found,
        poses=(found.poses[0], *(p.moved(drift) for p in poses[1:])),
        scales=found.scales * as_many,
        ambients=found.ambients * as_many,
    )
    if len(poses) > 1:
        state = _settle(replace(rough.problem(found, rough.sketch_band), frames=whole.frames), state)
    solution = maximize(whole, state)
    relative = whole.relative(solution.state)
    return _Outcome(solution, judge(whole, solution.state, relative), relative)


def residuals(fit: WavefrontFit, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Mean and standard deviation, in counts, of each frame's used pixels at the fit."""
    predicted = [predict(u, f, d) for u, f, d in zip(fit.relative, frames, fit.state.detectors(), strict=True)]
    return [(mean, np.sqrt(variance)) for mean, variance in predicted]
