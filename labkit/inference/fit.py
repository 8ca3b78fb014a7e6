"""From frames and a rough pose to the wavefront: sweep defocus, climb from the likeliest, judge, try again.

No start is ever at zero: there the likelihood has a saddle, every even mode's derivative vanishes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from time import perf_counter

import numpy as np

from labkit.imaging.model import ForwardModel, Optics
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
)  # RMS at the light's own wavelength; the twin covers the other sign
FARTHEST_WAVES = 12.0
RANDOM_WAVES = (0.1, 0.3)  # RMS of random starts, at the light's own wavelength
JUMPS = ((4,), (4, 11), (5, 6), (11,), (5, 6, 12, 13))  # modes reversed together
ENOUGH = 3  # random climbs that come back to the best optimum: then it is returned, accepted or not
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
    max_starts: int = 14,
    progress: Progress = lambda step: None,
) -> WavefrontFit:
    """Fit one wavefront to frames of one channel at one range.

    poses: of the target in each frame, right to about a pixel. starts: wavefronts (modes,) to climb from instead of those
    of the sweep, such as those found at other ranges. rng: for further starts, made while what was found is not accepted.
    max_starts: climbs at most before the best is returned, rejected.
    Raises FitError where the frames do not determine the parameters.
    """
    began = perf_counter()
    shape = frames[0].counts.shape
    # starts that are given lie close together, near focus, where only the fine detail tells optima apart
    band = 1.0 if len(starts) else _sketch_band(optics)
    sketch = Problem(ForwardModel.build(optics, target, shape, band=band), tuple(frames[:1]), noise)
    whole = Problem(ForwardModel.build(optics, target, shape), tuple(frames), noise)
    first = _first_state(frames[:1], poses[:1], noise, len(optics.noll))
    sure = [replace(first, waves=np.asarray(waves, float)) for waves in starts]
    if not sure:
        progress("defocus sweep")
        sure = [solution.state for solution in sweep(sketch, first, optics)[:2]]
    best: Solution | None = None
    outcome: tuple[Solution, Verdict, list[Floats]] | None = None
    climbs = again = 0
    for start in chain(sure, _more_starts(lambda: best, optics, rng)):  # noqa: B023 - the best so far is what is wanted
        progress(f"climb {climbs + 1}")
        found, climbs = _climb_from(sketch, start), climbs + 1
        if best is None or found.objective > best.objective + SAME_OPTIMUM:
            best, outcome, again = found, None, 0
        elif found.objective > best.objective - SAME_OPTIMUM:
            again += climbs > len(sure) + len(JUMPS)  # random starts only: the others lie near the best
        if climbs >= len(sure) and outcome is None:  # the sure starts are all made before one is believed
            progress("whole band")
            solution = _finish(whole, best, poses)
            relative = whole.relative(solution.state)
            outcome = solution, judge(whole, solution.state, relative), relative
        if outcome is not None and (outcome[1].accepted or again >= ENOUGH or climbs >= max_starts):
            break
    assert outcome is not None
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


def _sketch_band(optics: Optics) -> float:
    """Share of the pass band for sketches: never less than half as much again as the pixels' own Nyquist frequency."""
    return min(1.0, max(SKETCH_BAND, 0.75 / optics.pitch_um * optics.airy_um))


def _climb_from(problem: Problem, start: State) -> Solution:
    """Pose and light first, then everything: freed at once, from a pose a pixel off, an easy frame ended in a wrong minimum."""
    settled = climb(problem, start, free_waves=False, max_steps=4, tolerance=1.0)
    return climb(problem, settled.state, max_steps=25, tolerance=0.3)


def _more_starts(best: Callable[[], Solution | None], optics: Optics, rng: np.random.Generator) -> Iterator[State]:
    """Where else to look: the best so far with part of its even modes reversed, then at random."""
    found = best()
    assert found is not None
    for waves in _jumps(found.state.waves, optics.noll):
        yield replace(found.state, waves=waves)
    scale = optics.wavelength_um / optics.reference_um
    while (found := best()) is not None:
        direction = rng.normal(size=len(optics.noll))
        waves = direction / np.linalg.norm(direction) * rng.uniform(*RANDOM_WAVES) * scale
        if rng.random() < 0.5:
            waves[0] = found.state.waves[0]
        yield replace(found.state, waves=waves)


def sweep(problem: Problem, start: State, optics: Optics) -> list[Solution]:
    """Pose, light and noise fitted at each of a row of defocus values, the likeliest first.

    The row goes on outwards while its last value is the likeliest.
    """
    scale = optics.wavelength_um / optics.reference_um
    values, found = list(DEFOCUS_WAVES), []
    while values:
        value = values.pop(0)
        waves = np.zeros(len(optics.noll))
        waves[0] = value * scale
        found.append(climb(problem, replace(start, waves=waves), free_waves=False, max_steps=6, tolerance=0.5))
        if not values and found[-1].objective == max(s.objective for s in found) and value < FARTHEST_WAVES:
            values.append(1.4 * value)
    return sorted(found, key=lambda s: -s.objective)


def _first_state(frames: Sequence[FrameData], poses: Sequence[Pose], noise: NoisePrior, modes: int) -> State:
    """Light from the frames' own range of counts; no wavefront yet."""
    levels = np.array([np.percentile(f.counts[f.used] / f.illumination[f.used], [2, 98]) for f in frames])
    return State(np.zeros(modes), tuple(poses), levels[:, 1] - levels[:, 0], levels[:, 0], noise.centre)


def _finish(whole: Problem, sketch: Solution, poses: Sequence[Pose]) -> Solution:
    """The sketch's wavefront carried to the whole band and to all frames: poses first, then everything."""
    state = _first_state(whole.frames, poses, whole.noise, sketch.state.waves.size)
    drift = sketch.state.poses[0].v - poses[0].v
    state = replace(
        state,
        waves=sketch.state.waves,
        poses=(sketch.state.poses[0], *(p.moved(drift) for p in poses[1:])),
        scales=np.full(len(poses), sketch.state.scales[0]),
        ambients=np.full(len(poses), sketch.state.ambients[0]),
        log_noise=sketch.state.log_noise,
    )
    if len(poses) > 1:
        state = climb(whole, state, free_waves=False, max_steps=6, tolerance=1.0).state
    return climb(whole, state)


def _jumps(waves: Floats, noll: Sequence[int]) -> list[Floats]:
    """Where else to look: the even modes' signs changed in part, which is where wrong optima tend to lie."""
    signs = twin_signs(noll)
    return [np.where(np.isin(noll, group) & (signs < 0), -waves, waves) for group in JUMPS]


def residuals(fit: WavefrontFit, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Mean and standard deviation, in counts, of each frame's used pixels at the fit."""
    predicted = [predict(u, f, d) for u, f, d in zip(fit.relative, frames, fit.state.detectors(), strict=True)]
    return [(mean, np.sqrt(variance)) for mean, variance in predicted]
