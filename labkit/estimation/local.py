"""Search for the optima of one observation's likelihood, the candidates of the session's selection."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from time import perf_counter, process_time

import numpy as np

from labkit.estimation import starts
from labkit.estimation.candidate import Candidate, Measured
from labkit.estimation.climb import NoisePrior, Problem, Start, State
from labkit.estimation.expansion import Freed, free_f_number, with_optics_about
from labkit.estimation.held import expanded_about
from labkit.estimation.likelihood import FrameData, predict
from labkit.estimation.prior import Prior
from labkit.estimation.residuals import Verdict, judge, residual_spectrum
from labkit.estimation.ridge import Ridge
from labkit.estimation.scores import ScoreTest, score_tests, twin_scores
from labkit.estimation.settings import SETTINGS
from labkit.estimation.starts import Log, Sketches
from labkit.estimation.stray_pixels import StrayPixel, stray_pixels, without_pixels
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.zernike import twin_signs
from labkit.target.target import Target
from labkit.types import Floats


@dataclass(frozen=True)
class Optimum:
    """An optimum of the likelihood of all frames of an observation.

    Attributes
    ----------
    state : all parameters except the camera's
    optics : f-number and camera parts at the optimum
    covariance : (modes, modes) waves RMS squared, the error of the given f-number included
    measured : measurement by the frames alone, for the session
    sandwich : measurement with sandwich errors, valid if the model does not explain the frames
    ridge : of the likelihood about the optimum
    log_likelihood : of frames and noise calibration
    chi2_per_pixel : of the residuals
    verdict : whether the residuals are noise alone
    relative : relative image (pixels,) of each frame's used pixels
    residual_power : power of the residuals by frequency
    scores : by name, the score test of each part and group of modes that the model lacks
    held : whether the wavefront is a prediction, about which the likelihood was expanded, and no optimum
    """

    state: State
    optics: Optics
    covariance: Floats
    measured: Measured
    sandwich: Measured
    ridge: Ridge
    log_likelihood: float
    chi2_per_pixel: float
    verdict: Verdict
    relative: tuple[Floats, ...]
    residual_power: Floats
    scores: Mapping[str, ScoreTest] = field(default_factory=dict)
    held: bool = False

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
        """Candidate for the session's selection."""
        explained = self.verdict.accepted
        return Candidate(
            self.measured if explained else self.sandwich, self.log_likelihood, explained
        )

    @property
    def unexplained(self) -> float:
        """Approximate deficit of the log-likelihood against residuals of noise alone."""
        pixels = sum(image.size for image in self.relative)
        return 0.5 * max(self.chi2_per_pixel - 1, 0.0) * pixels

    def nearest_to(self, other: Optimum) -> Optimum:
        """Return this optimum or its twin, whichever is nearer to another optimum."""
        twin = self.twin()
        return min(self, twin, key=lambda one: np.linalg.norm(one.waves - other.waves))

    def moved_to(self, later: Optimum) -> bool:
        """Return whether a later fit of the same modes ended at another optimum."""
        if self.noll != later.noll:
            return False
        away = np.linalg.norm(self.nearest_to(later).waves - later.waves)
        return bool(away > SETTINGS.other_optimum_waves)

    def twin(self) -> Optimum:
        """Reverse the even modes: the twin makes the same pictures (thesis §3.6)."""
        signs = twin_signs(self.noll)
        return replace(
            self,
            state=replace(self.state, waves=self.waves * signs),
            optics=self.optics.twin(),
            covariance=self.covariance * np.outer(signs, signs),
            measured=self.measured.twin(),
            sandwich=self.sandwich.twin(),
            ridge=self.ridge.twin(self.measured.signs),
            scores=twin_scores(self.scores, self.measured.signs),
        )

    def canonical(self) -> Optimum:
        """Return the optimum or its twin, whichever has a positive largest even mode: the rule if no ranges decide."""
        even = np.where(twin_signs(self.noll) < 0, np.abs(self.waves), 0.0)
        return self.twin() if self.waves[int(np.argmax(even))] < 0 and even.any() else self


@dataclass(frozen=True)
class Found:
    """Result of a search for an observation's optima.

    Attributes
    ----------
    optima : the likeliest first
    starts : number of starts
    others : modes (modes,) and deficit in log-likelihood of other optima met on the way, the likeliest first
    returns : number of starts that returned to the best optimum
    cut_short : whether the user's cap ended the search
    seconds : duration of the search
    strays : pixels that no model explains, which the optima leave out
    """

    optima: tuple[Optimum, ...]
    starts: int = 0
    others: tuple[tuple[Floats, float], ...] = ()
    returns: int = 0
    cut_short: bool = False
    seconds: float = 0.0
    strays: tuple[StrayPixel, ...] = ()

    @property
    def best(self) -> Optimum:
        """The likeliest optimum."""
        return self.optima[0]

    @property
    def determined(self) -> list[Optimum]:
        """Optima that determine all modes: the candidates of the session's selection."""
        return [one for one in self.optima if not one.verdict.undetermined]

    @property
    def settled(self) -> bool:
        """Return whether enough starts returned to the best optimum."""
        return self.returns >= SETTINGS.enough_returns

    def joined(self, later: Found) -> Found:
        """Merge the results of a later search; optima with pixels that the later one leaves out are dropped."""
        optima = [] if later.strays else list(self.optima)
        for optimum in later.optima:
            optima = _with(optima, optimum)
        return Found(
            tuple(optima),
            self.starts + later.starts,
            later.others if len(later.others) > len(self.others) else self.others,
            max(self.returns, later.returns),
            later.cut_short,
            self.seconds + later.seconds,
            self.strays + later.strays,
        )


@dataclass(frozen=True)
class Views:
    """The frames of one channel at one range.

    Attributes
    ----------
    frames : counts, with calibration
    poses : pose of the target in each frame, right to about a pixel
    noise : calibrated noise
    """

    frames: tuple[FrameData, ...]
    poses: tuple[Pose, ...]
    noise: NoisePrior


@dataclass(frozen=True)
class Guesses:
    """Prior knowledge about a wavefront, and the effort of its search.

    Attributes
    ----------
    f_number_std : relative standard error of the optics' f-number; 0 if exact
    state : end of an earlier climb of the same frames, to start from
    beside : optics and modes (modes,) that another observation's optimum suggests: climbs begin with these if they are likelier
    held : whether to expand the likelihood about `state`, with its wavefront held, in place of a climb
    starts : wavefronts (modes,) predicted by other frames
    poses : pose of the target in every frame, from another channel, right to a fraction of a pixel; empty if unknown
    modes : predicted wavefronts with unknown defocus
    known : whether these wavefronts are those of explained fits: behind a cat's eye climbs stay near where light does not tell
    deep : whether to search on if the first optima are not explained
    alone : whether there are no frames at other ranges to reveal a wrong optimum
    score : parts and groups of modes to test for, which the model lacks
    score_unexplained : what to test for besides if the residuals are not explained
    patience_s : processor time after which no start is made
    most_starts : largest number of starts
    """

    f_number_std: float = 0.0
    state: State | None = None
    beside: tuple[Optics, Floats] | None = None
    held: bool = False
    starts: tuple[Floats, ...] = ()
    poses: tuple[Pose, ...] = ()
    modes: tuple[Floats, ...] = ()
    known: bool = False
    deep: bool = True
    alone: bool = True
    score: tuple[str, ...] = ()
    score_unexplained: tuple[str, ...] = ()
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

    The search ends with the first optimum whose residuals are noise alone, or that agrees with a prediction. Where modes are
    known behind a cat's eye it must agree, since others leave noise alone too. Undetermined modes have huge errors, and their
    optimum is rejected.

    Parameters
    ----------
    optics : lens, light and sensor; climbs start from its f-number and camera parts
    target : the target as shown
    views : the frames
    guesses : prior knowledge and effort
    seed : seed of random starts
    progress : called with the step under way
    """
    began = perf_counter()
    ends_at = process_time() + guesses.patience_s
    strays: tuple[StrayPixel, ...] = ()
    made = 0
    before: _Ended | None = None
    # a refit is compared with the fit before, of the same pixels
    cleanings = SETTINGS.cleanings if guesses.state is None else 0
    while True:
        frames = without_pixels(views.frames, strays)
        search = _Search.of(optics, target, replace(views, frames=frames), guesses, seed)
        log = Log(guesses.most_starts if guesses.deep else 0, ends_at, progress)
        ended = search.run(log, before, looks=cleanings > 0)
        made += log.starts
        if not ended.strays:
            break
        strays += ended.strays
        before = ended
        cleanings -= 1
    optima = ended.optima
    explained = any(optimum.verdict.accepted for optimum in optima)
    names = guesses.score
    if not optima[0].verdict.accepted:
        names += guesses.score_unexplained
    tests = score_tests(ended.best.expansion, names, guesses.f_number_std)
    return Found(
        (replace(optima[0], scores=tests), *optima[1:]),
        made,
        _below(log.others),
        log.returns,
        log.late and not (explained or log.settled),
        perf_counter() - began,
        strays,
    )


@dataclass(frozen=True, eq=False)
class _Ended:
    """End of a search.

    Attributes
    ----------
    optima : the likeliest first
    best : the climb to the likeliest
    guess : predicted wavefront (modes,) of the last climb; None without
    strays : pixels that the last optimum shows to be stray, whereupon the search ended
    """

    optima: list[Optimum]
    best: Freed
    guess: Floats | None
    strays: tuple[StrayPixel, ...]


@dataclass(frozen=True, eq=False)
class _Search:
    """Constants of a search: the whole problem, coarse problems, frames, guesses, and a first state without a wavefront."""

    whole: Problem
    sketches: Sketches
    views: Views
    guesses: Guesses
    first: State

    @classmethod
    def of(
        cls,
        optics: Optics,
        target: Target,
        views: Views,
        guesses: Guesses,
        seed: int | Sequence[int],
    ) -> _Search:
        frame, pose = views.frames[0], views.poses[0]
        f_number_margin = SETTINGS.f_number_margin if guesses.f_number_std else 0.0
        model = ForwardModel.build(
            optics,
            target,
            frame.counts.shape,
            pose,
            f_number_margin=f_number_margin,
            brightness=frame.brightness,
            beside=frame.beside,
        )
        sketched = Sketches(
            optics.in_one_wavelength(), target, frame, pose, views.noise, seed
        )
        first = first_state(frame, pose, views.noise, len(optics.noll))
        return cls(
            Problem(model, views.frames, views.noise), sketched, views, guesses, first
        )

    def run(self, log: Log, before: _Ended | None, *, looks: bool) -> _Ended:
        """Climb until a climb ends the search.

        Parameters
        ----------
        log : record of the search
        before : end of the same search with stray pixels, where this one begins; None without
        looks : whether the search ends once an optimum shows stray pixels
        """
        states = self.states(log)
        if before is not None:
            states = chain([(before.guess, before.optima[0].state)], states)
        optima = list[Optimum]()
        for guess, state in states:
            log.progress("at full resolution")
            freed = self.climbed(state)
            optimum = replace(_judged(freed), held=self.guesses.held)
            frames = self.views.frames
            if looks and (strays := stray_pixels(frames, residuals(optimum, frames))):
                return _Ended([optimum], freed, guess, strays)
            log.tried.append((state, optimum.log_likelihood))
            optima = _with(optima, optimum)
            if optima[0] is optimum:
                best = freed
            if self.ends_with(optimum, guess):
                break
        return _Ended(optima, best, guess, ())

    def states(self, log: Log) -> Iterator[tuple[Floats | None, State]]:
        """Yield states to climb from, each with the predicted wavefront if there is one."""
        guesses = self.guesses
        if guesses.state is not None:
            yield guesses.state.waves, guesses.state
        for waves in guesses.starts:
            log.starts += 1
            guess = replace(self.first, waves=np.asarray(waves, float))
            if guesses.poses:
                yield waves, self._lit(waves)
            else:
                yield waves, starts.settled(self.sketches.problem(guess), guess).state
        for waves in guesses.modes:
            guess = replace(self.first, waves=np.asarray(waves, float))
            prior = self._prior(guess.waves)
            for state in starts.at_known_modes(self.sketches, guess, log, prior):
                yield waves, state
        if guesses.deep or not (guesses.state or guesses.starts or guesses.modes):
            swept = starts.swept(
                self.sketches, self.first, log, doubt_near_focus=guesses.alone
            )
            for state in swept:
                yield None, state

    def climbed(self, state: State) -> Freed:
        """Climb over all frames to the optimum near a state of the first one, or of all."""
        begin = (
            state
            if len(state.poses) == len(self.views.poses) > 1
            else self._all_frames(state)
        )
        problem, begin = self._likelier(begin)
        start, f_number_std = Start(begin), self.guesses.f_number_std
        if self.guesses.held:
            return expanded_about(problem, start, f_number_std)
        return free_f_number(problem, start, f_number_std, self._prior(begin.waves))

    def ends_with(self, optimum: Optimum, guess: Floats | None) -> bool:
        """Return whether the search ends with an optimum. guess: predicted modes (modes,); None without."""
        if guess is None:
            return optimum.verdict.accepted
        away = float(np.linalg.norm((optimum.waves - guess)[1:]))
        known = self.guesses.known and not optimum.optics.rim.is_full
        return away < SETTINGS.sure_waves or (optimum.verdict.accepted and not known)

    def _prior(self, waves: Floats) -> Prior | None:
        """Return the prior of the modes behind a cat's eye, about a wavefront (modes,) if it is known; None for full pupils."""
        optics = self.whole.model.optics
        if optics.rim.is_full:
            return None
        return Prior.of_lens(optics.noll, waves if self.guesses.known else None)

    def _likelier(self, state: State) -> tuple[Problem, State]:
        """Return the whole problem and a state of all frames, or the optics and modes beside if these are likelier."""
        if self.guesses.beside is None:
            return self.whole, state
        optics, waves = self.guesses.beside
        other = replace(state, waves=waves)
        model = with_optics_about(self.whole.model, optics, other)
        ways = [(self.whole, state), (replace(self.whole, model=model), other)]
        ends = [(problem, starts.settled(problem, begin)) for problem, begin in ways]
        problem, end = max(ends, key=lambda way: way[1].objective)
        return problem, end.state

    def _lit(self, waves: Floats) -> State:
        """Return the state of a wavefront at known poses, its light fitted frame by frame."""
        poses = self.guesses.poses
        start = replace(
            self.first,
            waves=waves,
            poses=poses,
            scales=np.ones(len(poses)),
            ambients=np.zeros(len(poses)),
        )
        return starts.fitted_light(self.whole, start)[1]

    def _all_frames(self, state: State) -> State:
        """Extend a state of the first frame to all frames: same light and wavefront, poses corrected as the first frame's."""
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
        rough = self.sketches.problem(state)
        return starts.settled(replace(rough, frames=self.whole.frames), whole).state


def _judged(freed: Freed) -> Optimum:
    """Judge the end of a climb by its residuals."""
    problem, solution = freed.expansion.problem, freed.solution
    modes = len(freed.measured.noll)
    verdict = judge(problem, solution.state, solution.relative)
    explained = verdict.accepted
    return Optimum(
        state=solution.state,
        optics=freed.optics,
        covariance=freed.covariance
        if explained
        else freed.covariance + freed.sandwich.model[:modes, :modes],
        measured=freed.measured,
        sandwich=freed.sandwich,
        ridge=freed.ridge,
        log_likelihood=solution.objective,
        chi2_per_pixel=solution.chi2_per_pixel,
        verdict=verdict.given_covariance(
            solution.covariance()[:modes, :modes],
            freed.measured.noll,
            freed.optics.rim,
        ),
        relative=tuple(solution.relative),
        residual_power=residual_spectrum(
            problem.frames, solution.relative, solution.state.detectors()
        ),
    )


def _with(optima: Sequence[Optimum], new: Optimum) -> list[Optimum]:
    """Add an optimum to a list, the likeliest first; of two ends in one optimum the likelier stays."""
    same = [one for one in optima if _alike(one, new)]
    kept = [one for one in optima if not _alike(one, new)]
    kept.append(max([new, *same], key=lambda one: one.log_likelihood))
    return sorted(kept, key=lambda one: -one.log_likelihood)


def _alike(one: Optimum, other: Optimum) -> bool:
    """Return whether two ends are one optimum, or twins: equally likely, or nearer than a fraction of a standard error.

    A wavefront that was held is no optimum.
    """
    if one.held != other.held:
        return False
    near = min(
        float(np.linalg.norm(one.waves - w))
        for w in (other.waves, other.waves * twin_signs(other.noll))
    )
    error = float(np.sqrt(np.trace(one.covariance)))
    return (
        abs(one.log_likelihood - other.log_likelihood) < SETTINGS.same_optimum
        or near < SETTINGS.settled_stds * error
    )


def _below(others: Sequence[tuple[Floats, float]]) -> tuple[tuple[Floats, float], ...]:
    ranked = sorted(others, key=lambda other: other[1])
    return tuple((waves, misfit - ranked[0][1]) for waves, misfit in ranked[1:])


def first_state(frame: FrameData, pose: Pose, noise: NoisePrior, modes: int) -> State:
    """Return a state with zero wavefront and the light from the frame's own range of counts."""
    low, high = np.percentile(
        frame.counts[frame.used] / frame.illumination[frame.used], [2, 98]
    )
    even = np.zeros(len(frame.departures))
    return State(
        np.zeros(modes),
        (pose,),
        np.array([high - low]),
        np.array([low]),
        noise.centre,
        even,
    )


def residuals(optimum: Optimum, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Return mean and standard deviation, in counts, of each frame's used pixels at an optimum."""
    predictions = [
        predict(image, frame, detector)
        for image, frame, detector in zip(
            optimum.relative, frames, optimum.state.detectors(), strict=True
        )
    ]
    return [(mean, np.sqrt(variance)) for mean, variance in predictions]
