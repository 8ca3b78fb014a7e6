"""From frames and a rough pose to the wavefront: sweep defocus, climb from the likeliest, judge, try again.

No start is ever at zero: there the likelihood has a saddle, every even mode's derivative vanishes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from labkit.imaging.model import WINDOW_AIRY, ForwardModel, Optics
from labkit.imaging.warp import Pose
from labkit.inference.likelihood import FrameData, predict
from labkit.inference.solve import NoisePrior, Problem, Solution, State, climb
from labkit.inference.verdict import Verdict, judge
from labkit.optics.zernike import Floats, is_even
from labkit.target import Target

SKETCH_BAND = (
    0.2  # share of the pass band in the sweep: fits from it end 0.001 to 0.002 waves from those of the whole band
)
DEFOCUS_WAVES = (
    0.1,
    0.25,
    0.45,
    0.7,
    1.0,
    1.4,
    2.0,
    2.8,
    4.0,
)  # RMS at the light's own wavelength; the twin covers the rest
FARTHEST_WAVES = 12.0
RANDOM_WAVES = (
    0.1,
    0.3,
)  # RMS of random starts, at the light's own wavelength; about half of them end in the best optimum
NEAR_WAVES, NEAR_WINDOW = 0.5, 48.0  # RMS defocus up to which a PSF's window so many lambda N wide serves to search
CLIMB_STEPS = 25  # climbs that find the best optimum take 10 to 20
ENOUGH = 8  # climbs from random starts that come back to the best optimum: then it is returned, accepted or not
SAME_OPTIMUM = 0.5  # log-likelihoods that differ by less belong to one optimum

Progress = Callable[[str], None]


@dataclass(frozen=True)
class WavefrontFit:
    """The wavefront of one channel at one range.

    noll: the modes; waves: (modes,) RMS at the reference wavelength; covariance: its Cramér-Rao covariance; state: all
    parameters; climbs: made to find it; relative: images (pixels,) of the used pixels of each frame; seconds: it took.
    """

    noll: tuple[int, ...]
    state: State
    covariance: Floats
    objective: float
    chi2_per_pixel: float
    verdict: Verdict
    climbs: int
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
    max_starts: int = 40,
    progress: Progress = lambda step: None,
) -> WavefrontFit:
    """Fit one wavefront to frames of one channel at one range.

    poses: of the target in each frame, right to about a pixel. starts: wavefronts (modes,) to climb from instead of those
    of the sweep, such as those found at other ranges. rng: for further starts, made while what was found is not accepted.
    max_starts: climbs at most before the best is returned, rejected.
    Raises FitError where the frames do not determine the parameters.
    """
    began = perf_counter()
    whole = Problem(ForwardModel.build(optics, target, frames[0].counts.shape), tuple(frames), noise)
    first = _first_state(frames[:1], poses[:1], noise, len(optics.noll))
    rough = Rough(optics, target, frames[0], noise)
    if len(starts):  # they lie close together, near focus, where only the fine detail tells optima apart
        sure, band = [replace(first, waves=np.asarray(waves, float)) for waves in starts], 1.0
    else:
        progress("defocus sweep")
        sure, band = [found.state for found in sweep(rough, first)[:2]], rough.sketch_band
    best = max((_climb_from(rough.problem(start, band), start) for start in sure), key=lambda found: found.objective)
    progress("whole band")
    outcome = _finish(whole, best, poses)
    climbs, again = len(sure), 0
    if not outcome[1].accepted:
        problem = rough.problem(best.state, 1.0)
        best = climb(problem, outcome[0].state.first(), max_steps=CLIMB_STEPS, tolerance=0.3)
        for start in _more_starts(best, optics, rng):
            progress(f"climb {climbs + 1}")
            found, climbs = _climb_from(problem, start), climbs + 1
            if found.objective > best.objective + SAME_OPTIMUM:
                best, outcome, again = found, _finish(whole, found, poses), 0
            else:
                again += found.objective > best.objective - SAME_OPTIMUM
            if outcome[1].accepted or again >= ENOUGH or climbs >= max_starts:
                break
    solution, verdict, relative = outcome
    return WavefrontFit(
        optics.noll,
        solution.state,
        solution.covariance()[: len(optics.noll), : len(optics.noll)],
        solution.objective,
        solution.chi2_per_pixel,
        verdict,
        climbs,
        tuple(relative),
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

    def problem(self, state: State, band: float) -> Problem:
        """For wavefronts of about a state's defocus."""
        waves = state.waves[0] if self.optics.noll[0] == 4 else 0.0
        near = abs(waves) * self.optics.reference_um <= NEAR_WAVES * self.optics.wavelength_um
        key = band, NEAR_WINDOW if near else WINDOW_AIRY
        if key not in self._made:
            shape = self.frame.counts.shape
            model = ForwardModel.build(self.optics, self.target, shape, band=band, window_airy=key[1])
            self._made[key] = Problem(model, (self.frame,), self.noise)
        return self._made[key]


def _climb_from(problem: Problem, start: State) -> Solution:
    """Pose and light first, then everything: freed at once, from a pose a pixel off, an easy frame ended in a wrong minimum."""
    settled = climb(problem, start, free_waves=False, max_steps=4, tolerance=1.0)
    return climb(problem, settled.state, max_steps=CLIMB_STEPS, tolerance=0.3)


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


def sweep(rough: Rough, start: State) -> list[Solution]:
    """Pose, light and noise fitted at each of a row of defocus values, the likeliest first.

    The row goes on outwards while its last value is the likeliest.
    """
    scale = rough.optics.wavelength_um / rough.optics.reference_um
    values, found = list(DEFOCUS_WAVES), []
    while values:
        value = values.pop(0)
        state = replace(start, waves=np.append(value * scale, np.zeros(start.waves.size - 1)))
        problem = rough.problem(state, rough.sketch_band)
        found.append(climb(problem, state, free_waves=False, max_steps=6, tolerance=0.5))
        if not values and found[-1].objective == max(s.objective for s in found) and value < FARTHEST_WAVES:
            values.append(1.4 * value)
    return sorted(found, key=lambda s: -s.objective)


def _first_state(frames: Sequence[FrameData], poses: Sequence[Pose], noise: NoisePrior, modes: int) -> State:
    """Light from the frames' own range of counts; no wavefront yet."""
    levels = np.array([np.percentile(f.counts[f.used] / f.illumination[f.used], [2, 98]) for f in frames])
    even = np.zeros(len(frames[0].departures))
    return State(np.zeros(modes), tuple(poses), levels[:, 1] - levels[:, 0], levels[:, 0], noise.centre, even)


def _finish(whole: Problem, found: Solution, poses: Sequence[Pose]) -> tuple[Solution, Verdict, list[Floats]]:
    """What a rough problem found carried to the whole one and all its frames, poses first, then everything; and judged."""
    state = _first_state(whole.frames, poses, whole.noise, found.state.waves.size)
    drift = found.state.poses[0].v - poses[0].v
    state = replace(
        state,
        waves=found.state.waves,
        poses=(found.state.poses[0], *(p.moved(drift) for p in poses[1:])),
        scales=np.full(len(poses), found.state.scales[0]),
        ambients=np.full(len(poses), found.state.ambients[0]),
        log_noise=found.state.log_noise,
        unevenness=found.state.unevenness,
    )
    if len(poses) > 1:
        state = climb(whole, state, free_waves=False, max_steps=6, tolerance=1.0).state
    solution = climb(whole, state)
    relative = whole.relative(solution.state)
    return solution, judge(whole, solution.state, relative), relative


def residuals(fit: WavefrontFit, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Mean and standard deviation, in counts, of each frame's used pixels at the fit."""
    predicted = [predict(u, f, d) for u, f, d in zip(fit.relative, frames, fit.state.detectors(), strict=True)]
    return [(mean, np.sqrt(variance)) for mean, variance in predicted]
