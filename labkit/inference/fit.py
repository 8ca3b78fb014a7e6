"""From frames and a rough pose to the wavefront: search, judge, and what became of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time

import numpy as np

from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.parts import Part
from labkit.imaging.warp import Pose
from labkit.inference.cone import SPARE, Measured
from labkit.inference.fisher_scoring import NoisePrior, Problem, State
from labkit.inference.goodness_of_fit import Verdict
from labkit.inference.likelihood import FrameData, predict
from labkit.inference.missing_parts import Call, calls
from labkit.inference.residual_spectrum import residual_spectrum
from labkit.inference.search import Record, Search
from labkit.inference.sketch import Sketches
from labkit.optics.zernike import twin_signs
from labkit.target import Target
from labkit.types import Floats


@dataclass(frozen=True, slots=True)
class Other:
    """Another optimum that a search met. waves: (modes,) RMS; below: by how much its log-likelihood is less, about."""

    waves: Floats
    below: float


@dataclass(frozen=True)
class WavefrontFit:
    """The wavefront of one channel at one range.

    noll: the modes; waves: (modes,) RMS at the reference wavelength; covariance: its Cramér-Rao covariance, the error of the
    given f-number in it, and the model's where the residuals are not noise alone; optics: where cone and parts ended;
    measured: what the frames alone say, poor: with the errors of a model that does not explain them; state: all parameters;
    starts: made in the search; others: optima met on the way, the likeliest first; relative: images (pixels,) of the used
    pixels of each frame; seconds: it took; cut_short: whether its time was up before an optimum was accepted. settled:
    whether many starts came back to it. left: of the data, by frequency (`residual_spectrum`). calls: what the frames say of
    parts that the model lacks, by name, if that was wanted.
    """

    noll: tuple[int, ...]
    state: State
    covariance: Floats
    optics: Optics
    measured: Measured
    poor: Measured
    objective: float
    chi2_per_pixel: float
    verdict: Verdict
    starts: int
    others: tuple[Other, ...]
    relative: tuple[Floats, ...]
    seconds: float = 0.0
    cut_short: bool = False
    settled: bool = False
    left: Floats = field(default_factory=lambda: np.empty(0))
    calls: Mapping[str, Call] = field(default_factory=dict)

    @property
    def waves(self) -> Floats:
        return self.state.waves

    @property
    def f_number(self) -> float:
        """Of the cone."""
        return self.optics.f_number

    @property
    def std(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def twin(self) -> "WavefrontFit":
        """The same fit with all even modes' signs changed: the same PSF, the same likelihood (thesis §3.6)."""
        sign = twin_signs(self.noll)
        state = replace(self.state, waves=self.waves * sign)
        covariance = self.covariance * np.outer(sign, sign)
        measured, poor = self.measured.twin(sign), self.poor.twin(sign)
        return replace(self, state=state, covariance=covariance, measured=measured, poor=poor)


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
    f_number_std: float = 0.0,
    starts: Sequence[Floats] = (),
    alike: Sequence[Floats] = (),
    max_starts: int = 40,
    patience_s: float = np.inf,
    missing: tuple[Part, ...] = (),
    asked: bool = False,
    alone: bool = True,
    progress: Callable[[str], None] = lambda step: None,
) -> WavefrontFit:
    """Fit one wavefront to frames of one channel at one range.

    poses: of the target in each frame, right to about a pixel. f_number_std: relative standard error of the optics' f-number,
    0: exact. starts: wavefronts (modes,) that other frames of the lens predict; alike: such whose first mode, defocus, is not
    known. rng: for further starts, made while no optimum is accepted. max_starts: of the whole likelihood far from focus,
    before the best is returned, rejected; patience_s: of processor time, after which no further start is made.
    missing: parts of the camera, to be tried where the model does not explain the frames without them. asked: whether the
    end is to say which parts it lacks. alone: whether no frames of other ranges will tell a wrong optimum.
    What the frames do not determine has huge errors and is rejected.
    """
    began, ends_at = perf_counter(), process_time() + patience_s
    spare = SPARE if f_number_std else 0.0
    model = ForwardModel.build(optics, target, frames[0].counts.shape, poses[0], spare=spare, shine=frames[0].shine)
    whole = Problem(model, tuple(frames), noise)
    first = _first_state(frames[0], poses[0], noise, len(optics.noll))
    sketches = Sketches(optics.in_one_wavelength(), target, frames[0], poses[0], noise)
    search = Search(whole, f_number_std, sketches, poses, first, rng, max_starts, ends_at, missing, alone, progress)
    given, swept = ([replace(first, waves=np.asarray(w, float)) for w in waves] for waves in (starts, alike))
    record = search.run(given, swept)
    said = _said(record, f_number_std) if asked else {}
    cut_short = search.late and not (record.accepted or record.settled)
    return replace(_as_fit(whole, record), calls=said, cut_short=cut_short, seconds=perf_counter() - began)


def _said(record: Record, f_number_std: float) -> dict[str, Call]:
    """By the best of a search, of what its model lacks."""
    assert record.best is not None
    expansion = record.best.freed.expansion
    return calls(expansion, expansion.optics.lacking, f_number_std)


def _as_fit(problem: Problem, record: Record) -> WavefrontFit:
    """The best of a search, and what else it came across."""
    assert record.best is not None
    freed, optima = record.best.freed, sorted(record.optima, key=lambda optimum: optimum[1])
    noll, solution, explained = freed.measured.noll, freed.solution, record.best.verdict.accepted
    return WavefrontFit(
        noll,
        solution.state,
        freed.covariance if explained else freed.covariance + freed.poor.model[: len(noll), : len(noll)],
        freed.optics,
        freed.measured,
        freed.poor,
        solution.objective,
        solution.chi2_per_pixel,
        record.best.verdict.knowing(solution.covariance()[: len(noll), : len(noll)], noll),
        record.starts,
        tuple(Other(waves, misfit - optima[0][1]) for waves, misfit in optima[1:]),
        tuple(record.best.relative),
        settled=record.settled,
        left=residual_spectrum(problem.frames, record.best.relative, solution.state.detectors()),
    )


def _first_state(frame: FrameData, pose: Pose, noise: NoisePrior, modes: int) -> State:
    """Light from the frame's own range of counts; no wavefront yet."""
    low, high = np.percentile(frame.counts[frame.used] / frame.illumination[frame.used], [2, 98])
    even = np.zeros(len(frame.departures))
    return State(np.zeros(modes), (pose,), np.array([high - low]), np.array([low]), noise.centre, even)


def residuals(fit: WavefrontFit, frames: Sequence[FrameData]) -> list[tuple[Floats, Floats]]:
    """Mean and standard deviation, in counts, of each frame's used pixels at the fit."""
    predicted = [predict(u, f, d) for u, f, d in zip(fit.relative, frames, fit.state.detectors(), strict=True)]
    return [(mean, np.sqrt(variance)) for mean, variance in predicted]
