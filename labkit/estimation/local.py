"""One observation to its candidates: every optimum that climbs over the whole likelihood ended in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time

import numpy as np

from labkit.estimation import starts
from labkit.estimation.candidate import Candidate, Measured
from labkit.estimation.climb import NoisePrior, Problem, Start, State, maximize
from labkit.estimation.expansion import Freed, free_cone
from labkit.estimation.likelihood import FrameData, predict
from labkit.estimation.residual_spectrum import residual_spectrum
from labkit.estimation.residual_tests import Verdict, judge
from labkit.estimation.scores import ScoreTest, score_tests
from labkit.estimation.settings import SETTINGS
from labkit.estimation.sketches import Sketches
from labkit.estimation.starts import Log
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.zernike import twin_signs
from labkit.target import Target
from labkit.types import Floats


@dataclass(frozen=True)
class Optimum:
    """Where a climb over all frames of an observation ended.

    Attributes
    ----------
    state : all parameters but the camera's
    optics : f-number and camera parts there
    covariance : (modes, modes) waves RMS squared, the given f-number's error included
    measured : what the frames alone say, for the session
    sandwich : the same with errors of a model that does not explain the frames
    log_likelihood : of the frames and the noise's calibration
    chi2_per_pixel : of the residuals
    verdict : whether the residuals are noise alone
    relative : of each frame the image (pixels,) of its used pixels
    residual_power : power of the residuals by frequency
    scores : by name, the score test of each camera part that the model lacks
    """

    state: State
    optics: Optics
    covariance: Floats
    measured: Measured
    sandwich: Measured
    log_likelihood: float
    chi2_per_pixel: float
    verdict: Verdict
    relative: tuple[Floats, ...]
    residual_power: Floats
    scores: Mapping[str, ScoreTest] = field(default_factory=dict)

    @property
    def noll(self) -> tuple[int, ...]:
        """The modes."""
        return self.optics.noll

    @property
    def waves(self) -> Floats:
        """(modes,) RMS at the reference wavelength."""
        return self.state.waves

    @property
    def candidate(self) -> Candidate:
        """As the session's selection takes it."""
        explained = self.verdict.accepted
        return Candidate(self.measured if explained else self.sandwich, self.log_likelihood, explained)

    @property
    def unexplained(self) -> float:
        """Log-likelihood that the residuals lack of those of noise alone, about."""
        pixels = sum(image.size for image in self.relative)
        return 0.5 * max(self.chi2_per_pixel - 1, 0.0) * pixels

    def twin(self) -> Optimum:
        """The same with the even modes reversed: the same pictures (thesis §3.6)."""
        signs = twin_signs(self.noll)
        return replace(
            self,
            state=replace(self.state, waves=self.waves * signs),
            covariance=self.covariance * np.outer(signs, signs),
            measured=self.measured.twin(),
            sandwich=self.sandwich.twin(),
        )

    def canonical(self) -> Optimum:
        """Itself or its twin, whose largest even mode is positive: the rule where no ranges decide."""
        even = np.where(twin_signs(self.noll) < 0, np.abs(self.waves), 0.0)
        return self.twin() if self.waves[int(np.argmax(even))] < 0 and even.any() else self


@dataclass(frozen=True)
class Found:
    """What a search for an observation's optima came to.

    Attributes
    ----------
    optima : the likeliest first
    starts : made
    others : modes (modes,) and by how much the log-likelihood is less, of optima met on the way, the likeliest first
    returns : starts that came back to the best optimum
    cut_short : whether the user's cap ended the search
    seconds : it took
    """

    optima: tuple[Optimum, ...]
    starts: int = 0
    others: tuple[tuple[Floats, float], ...] = ()
    returns: int = 0
    cut_short: bool = False
    seconds: float = 0.0

    @property
    def best(self) -> Optimum:
        """The likeliest."""
        return self.optima[0]

    @property
    def settled(self) -> bool:
        """Whether starts came back to the best optimum often enough."""
        return self.returns >= SETTINGS.enough_returns

    def joined(self, later: Found) -> Found:
        """With what a later search found."""
        optima = list(self.optima)
        for optimum in later.optima:
            optima = _with(optima, optimum)
        return Found(
            tuple(optima),
            self.starts + later.starts,
            later.others if len(later.others) > len(self.others) else self.others,
            max(self.returns, later.returns),
            later.cut_short,
            self.seconds + later.seconds,
        )


@dataclass(frozen=True)
class Views:
    """The frames of one channel at one range.

    Attributes
    ----------
    frames : counts with what is known of them
    poses : of the target in each, right to about a pixel
    noise : as calibrated
    """

    frames: tuple[FrameData, ...]
    poses: tuple[Pose, ...]
    noise: NoisePrior


@dataclass(frozen=True)
class Guesses:
    """What is known of a wavefront before its search.

    Attributes
    ----------
    f_number_std : relative standard error of the optics' f-number; 0: exact
    state : where an earlier climb of the same frames ended, to begin at
    starts : wavefronts (modes,) that other frames predict
    poses : of the target in every frame, as another channel has them to a fraction of a pixel; empty where unknown
    modes : wavefronts whose defocus is not known
    deep : whether the search goes on where the first ends are not explained
    alone : whether no frames of other ranges will tell a wrong optimum
    score : whether to test for camera parts that the model lacks
    patience_s : processor time, after which no start is made
    most_starts : that a search makes
    """

    f_number_std: float = 0.0
    state: State | None = None
    starts: tuple[Floats, ...] = ()
    poses: tuple[Pose, ...] = ()
    modes: tuple[Floats, ...] = ()
    deep: bool = True
    alone: bool = True
    score: bool = False
    patience_s: float = np.inf
    most_starts: int = SETTINGS.most_starts


def find_optima(
    optics: Optics,
    target: Target,
    views: Views,
    guesses: Guesses,
    *,
    seed: int | Sequence[int] = 1,
    progress: Callable[[str], None] = lambda step: None,
) -> Found:
    """Search for the optima of one observation's likelihood.

    The search ends with the first optimum whose residuals are noise alone, or that is as predicted. What the frames do
    not determine has huge errors, and its optimum is rejected.

    Parameters
    ----------
    optics : lens, light and sensor; its f-number and parts are where climbs begin
    target : as it is shown
    views : the frames
    guesses : what is known beforehand
    seed : of further starts
    progress : called with the step under way
    """
    began = perf_counter()
    search = _Search.of(optics, target, views, guesses, seed)
    log = Log(guesses.most_starts if guesses.deep else 0, process_time() + guesses.patience_s, progress)
    optima = list[Optimum]()
    for guess, state in search.states(log):
        progress("at full resolution")
        freed = search.climbed(state)
        optimum = _judged(freed)
        log.tried.append((state, optimum.log_likelihood))
        optima = _with(optima, optimum)
        if optima[0] is optimum:
            expansion = freed.expansion
        if optimum.verdict.accepted or (guess is not None and _as_predicted(optimum, guess)):
            break
    explained = any(optimum.verdict.accepted for optimum in optima)
    if guesses.score:
        lacking = score_tests(expansion, expansion.optics.lacking, guesses.f_number_std)
        optima[0] = replace(optima[0], scores=lacking)
    return Found(
        tuple(optima),
        log.starts,
        _below(log.others),
        log.returns,
        log.late and not (explained or log.settled),
        perf_counter() - began,
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """What does not change in a search. first: a state of the first frame without a wavefront."""

    whole: Problem
    sketches: Sketches
    views: Views
    guesses: Guesses
    first: State

    @classmethod
    def of(cls, optics: Optics, target: Target, views: Views, guesses: Guesses, seed: int | Sequence[int]) -> _Search:
        frame, pose = views.frames[0], views.poses[0]
        cone_margin = SETTINGS.cone_margin if guesses.f_number_std else 0.0
        model = ForwardModel.build(optics, target, frame.counts.shape, pose, cone_margin=cone_margin, shine=frame.shine)
        sketched = Sketches(optics.in_one_wavelength(), target, frame, pose, views.noise, seed)
        first = first_state(frame, pose, views.noise, len(optics.noll))
        return cls(Problem(model, views.frames, views.noise), sketched, views, guesses, first)

    def states(self, log: Log) -> Iterator[tuple[Floats | None, State]]:
        """Where to climb from, and what was predicted there."""
        guesses = self.guesses
        if guesses.state is not None:
            yield guesses.state.waves, guesses.state
        for waves in guesses.starts:
            log.starts += 1
            guess = replace(self.first, waves=np.asarray(waves, float))
            yield waves, self._lit(waves) if guesses.poses else starts.settled(self.sketches, guess)
        for waves in guesses.modes:
            guess = replace(self.first, waves=np.asarray(waves, float))
            for state in starts.at_known_modes(self.sketches, guess, log):
                yield waves, state
        if guesses.deep or not (guesses.state or guesses.starts or guesses.modes):
            swept = starts.swept(self.sketches, self.first, log, doubt_near_focus=guesses.alone)
            for state in swept:
                yield None, state

    def climbed(self, state: State) -> Freed:
        """Climb over all frames to the optimum near a state of the first one, or of all."""
        begin = state if len(state.poses) == len(self.views.poses) > 1 else self._all_frames(state)
        freed = free_cone(self.whole, Start(begin), self.guesses.f_number_std)
        if not freed.solution.converged:
            near = maximize(self.whole, begin, exact=False)
            freed = free_cone(self.whole, near.begun or Start(near.state), self.guesses.f_number_std)
        return freed

    def _lit(self, waves: Floats) -> State:
        """The state of a wavefront at known poses, its light fitted frame by frame."""
        poses, frames = self.guesses.poses, self.views.frames
        start = replace(self.first, waves=waves, poses=poses, scales=np.ones(len(poses)), ambients=np.zeros(len(poses)))
        levels = []
        for frame, image in zip(frames, self.whole.relative(start), strict=True):
            light = frame.illumination[frame.used]
            levels.append(np.linalg.lstsq(np.stack([light * image, light], axis=1), frame.counts[frame.used])[0])
        scales, ambients = np.array(levels).T
        return replace(start, scales=scales, ambients=ambients)

    def _all_frames(self, state: State) -> State:
        """The same light and wavefront for all frames, their poses as the first one's was corrected."""
        poses, frames = self.views.poses, len(self.views.poses)
        drift = state.poses[0].v - poses[0].v
        whole = replace(
            state,
            poses=(state.poses[0], *(pose.moved(drift) for pose in poses[1:])),
            scales=state.scales * np.ones(frames),
            ambients=state.ambients * np.ones(frames),
        )
        if frames == 1:
            return whole
        rough = self.sketches.problem(state, self.sketches.band)
        return starts.settle(replace(rough, frames=self.whole.frames), whole)


def _judged(freed: Freed) -> Optimum:
    """Judge the end of a climb by its residuals."""
    problem, solution = freed.expansion.problem, freed.solution
    modes = len(freed.measured.noll)
    verdict = judge(problem, solution.state, solution.relative)
    explained = verdict.accepted
    return Optimum(
        state=solution.state,
        optics=freed.optics,
        covariance=freed.covariance if explained else freed.covariance + freed.sandwich.model[:modes, :modes],
        measured=freed.measured,
        sandwich=freed.sandwich,
        log_likelihood=solution.objective,
        chi2_per_pixel=solution.chi2_per_pixel,
        verdict=verdict.given_covariance(solution.covariance()[:modes, :modes], freed.measured.noll),
        relative=tuple(solution.relative),
        residual_power=residual_spectrum(problem.frames, solution.relative, solution.state.detectors()),
    )


def _with(optima: Sequence[Optimum], new: Optimum) -> list[Optimum]:
    """Optima with a new one, the likeliest first; of two ends in one optimum the likelier stays."""
    same = [one for one in optima if _alike(one, new)]
    kept = [one for one in optima if not _alike(one, new)]
    kept.append(max([new, *same], key=lambda one: one.log_likelihood))
    return sorted(kept, key=lambda one: -one.log_likelihood)


def _alike(one: Optimum, other: Optimum) -> bool:
    """Whether two ends are one optimum: as likely, and nearer than a standard error, or twins."""
    near = min(float(np.linalg.norm(one.waves - w)) for w in (other.waves, other.waves * twin_signs(other.noll)))
    error = float(np.sqrt(np.trace(one.covariance)))
    return (
        abs(one.log_likelihood - other.log_likelihood) < SETTINGS.same_optimum or near < SETTINGS.settled_stds * error
    )


def _as_predicted(optimum: Optimum, waves: Floats) -> bool:
    """Whether an end has the modes that were predicted, defocus apart: then its residuals judge the model."""
    return float(np.linalg.norm((optimum.waves - waves)[1:])) < SETTINGS.sure_waves


def _below(others: Sequence[tuple[Floats, float]]) -> tuple[tuple[Floats, float], ...]:
    ranked = sorted(others, key=lambda other: other[1])
    return tuple((waves, misfit - ranked[0][1]) for waves, misfit in ranked[1:])


def first_state(frame: FrameData, pose: Pose, noise: NoisePrior, modes: int) -> State:
    """Light from the frame's own range of counts; no wavefront yet."""
    low, high = np.percentile(frame.counts[frame.used] / frame.illumination[frame.used], [2, 98])
    even = np.zeros(len(frame.departures))
    return State(np.zeros(modes), (pose,), np.array([high - low]), np.array([low]), noise.centre, even)


def residuals(optimum: Optimum, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Mean and standard deviation, in counts, of each frame's used pixels at an optimum."""
    predictions = [
        predict(image, frame, detector)
        for image, frame, detector in zip(optimum.relative, frames, optimum.state.detectors(), strict=True)
    ]
    return [(mean, np.sqrt(variance)) for mean, variance in predictions]
