"""Damped Fisher scoring: from a start to the nearest maximum of the likelihood (Levenberg-Marquardt on thesis 3.15)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from labkit.arrays import positive, real_array
from labkit.estimation.identifiability import inverse
from labkit.estimation.likelihood import Detector, FrameData, Score, chi2, log_likelihood, score
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.types import Floats

PER_FRAME = POSE_SIZE + 2  # pose, scale, ambient
NOISE = 2  # log gain, log read variance
ON_SLOPES = 1.0  # standard errors: a last step shorter than that is not drawn, its picture lies on the slopes
STRAY = 0.5  # of the target's size: corners are known to about a pixel beforehand


@dataclass(frozen=True)
class NoisePrior:
    """What flats and darks measure of the noise: independent measurements that join the likelihood.

    gain: counts per electron; read_variance: counts^2; the stds are relative. All are positive, ValueError otherwise.
    """

    gain: float
    gain_std: float
    read_variance: float
    read_variance_std: float

    def __post_init__(self) -> None:
        positive("gain", self.gain, "counts per electron")
        positive("read_variance", self.read_variance, "counts^2")
        positive("gain_std", self.gain_std, "relative")
        positive("read_variance_std", self.read_variance_std, "relative")

    @property
    def centre(self) -> Floats:
        return np.log([self.gain, self.read_variance])

    @property
    def precision(self) -> Floats:
        return 1 / np.array([self.gain_std, self.read_variance_std]) ** 2


@dataclass(frozen=True)
class State:
    """A point of the parameter space: waves RMS (modes,); for each frame its pose, scale and ambient light; for all
    frames log gain and log read variance, and the illumination's unevenness (k,) where no flats determine it."""

    waves: Floats
    poses: tuple[Pose, ...]
    scales: Floats
    ambients: Floats
    log_noise: Floats
    unevenness: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        frames = len(self.poses)
        real_array("waves", self.waves, (None,), "waves RMS, one for each mode")
        real_array("scales", self.scales, (frames,), "counts, one for each pose")
        real_array("ambients", self.ambients, (frames,), "counts, one for each pose")
        real_array("log_noise", self.log_noise, (NOISE,), "logarithms of counts per electron and of counts^2")
        real_array("unevenness", self.unevenness, (None,), "relative")

    @property
    def gain(self) -> float:
        return float(np.exp(self.log_noise[0]))

    @property
    def read_noise(self) -> float:
        return float(np.exp(self.log_noise[1] / 2))

    def detectors(self) -> list[Detector]:
        gain, read_variance = np.exp(self.log_noise)
        return [
            Detector(s, a, float(gain), float(read_variance), self.unevenness)
            for s, a in zip(self.scales, self.ambients, strict=True)
        ]

    def moved(self, step: Floats) -> "State":
        """The state after a step in all parameters: modes; frame by frame pose, scale, ambient; unevenness; noise."""
        modes, common = self.waves.size, self.unevenness.size + NOISE
        frames = step[modes:-common].reshape(len(self.poses), PER_FRAME)
        return State(
            self.waves + step[:modes],
            tuple(p.moved(f[:POSE_SIZE]) for p, f in zip(self.poses, frames, strict=True)),
            self.scales + frames[:, POSE_SIZE],
            self.ambients + frames[:, POSE_SIZE + 1],
            self.log_noise + np.clip(step[-NOISE:], -1.0, 1.0),
            self.unevenness + step[-common:-NOISE],
        )

    def first(self) -> "State":
        """The same for the first frame only."""
        return replace(self, poses=self.poses[:1], scales=self.scales[:1], ambients=self.ambients[:1])


class Start(NamedTuple):
    """A state; the target at its poses, and the relative images (pixels,) of the frames there, if they are at hand."""

    state: State
    drawing: Drawing | None = None
    relative: Sequence[Floats] = ()

    def undrawn(self) -> "Start":
        """Without its drawing, which of a large target is hundreds of megabytes."""
        return self._replace(drawing=None)


@dataclass(frozen=True)
class Problem:
    """Frames of one wavefront, a model of them, and what is known of the noise."""

    model: ForwardModel
    frames: tuple[FrameData, ...]
    noise: NoisePrior

    def draw(self, state: State) -> Drawing:
        """The target at a state's poses: whoever needs more than one evaluation there hands it on, for time's sake alone."""
        return self.model.draw(state.poses)

    def relative(self, state: State, drawing: Drawing | None = None) -> list[Floats]:
        """Relative images (pixels,) of the frames. drawing: at the state's poses, if it is at hand."""
        return self.model.means(state.waves, drawing or self.draw(state), [f.used for f in self.frames])

    def drawn(self, state: State) -> Start:
        """A state with all that is computed of it."""
        drawing = self.draw(state)
        return Start(state, drawing, self.relative(state, drawing))

    def objective(self, state: State, relative: Sequence[Floats]) -> float:
        """Log-likelihood of everything measured, that of the noise's calibration included."""
        total = sum(log_likelihood(u, f, d) for u, f, d in zip(relative, self.frames, state.detectors(), strict=True))
        return total - 0.5 * float(self.noise.precision @ (state.log_noise - self.noise.centre) ** 2)

    def foreseen(self, state: State, step: Floats, evaluations: Sequence[Evaluation]) -> list[Floats]:
        """Relative images (pixels,) of the frames after a short step, by their slopes where it begins."""
        modes = max(state.waves.size, len(evaluations[0].by_waves))
        poses = step[modes : modes + PER_FRAME * len(self.frames)].reshape(-1, PER_FRAME)[:, :POSE_SIZE]
        moved = [e.mean + by_v @ e.by_pose for e, by_v in zip(evaluations, poses, strict=True)]
        return [mean + step[: len(e.by_waves)] @ e.by_waves for mean, e in zip(moved, evaluations, strict=True)]

    def chi2_per_pixel(self, state: State, relative: Sequence[Floats]) -> float:
        """Of residuals over the variance that the state gives them."""
        total = [chi2(u, f, d) for u, f, d in zip(relative, self.frames, state.detectors(), strict=True)]
        return sum(total) / sum(u.size for u in relative)

    def scores(
        self,
        state: State,
        drawing: Drawing | None = None,
        relative: Sequence[Floats] = (),
        *,
        by_waves: bool,
        exact: bool = True,
    ) -> tuple[Floats, Floats, list[Score], list[Evaluation]]:
        """Gradient and Fisher information over all parameters (rows of fixed modes zero), and each frame's.

        drawing, relative: at the state, if they are at hand. exact: as in `ForwardModel.evaluate`.
        """
        used, drawing = [f.used for f in self.frames], drawing or self.draw(state)
        evaluations = self.model.evaluate(state.waves, drawing, used, by_waves=by_waves, exact=exact, means=relative)
        return *self.assembled(state, evaluations), evaluations

    def assembled(self, state: State, evaluations: Sequence[Evaluation]) -> tuple[Floats, Floats, list[Score]]:
        """The same from evaluations at a state, which may be by more than its modes."""
        given = len(evaluations[0].by_waves)
        modes, common = max(given, state.waves.size), state.unevenness.size + NOISE
        size = modes + PER_FRAME * len(self.frames) + common
        gradient, information = np.zeros(size), np.zeros((size, size))
        scores = [score(e, f, d) for e, f, d in zip(evaluations, self.frames, state.detectors(), strict=True)]
        for k, of_frame in enumerate(scores):
            at_frame = np.arange(PER_FRAME) + modes + k * PER_FRAME
            index = np.concatenate([np.arange(given), at_frame, np.arange(size - common, size)])
            gradient[index] += of_frame.gradient
            information[np.ix_(index, index)] += of_frame.information
        gradient[-NOISE:] -= self.noise.precision * (state.log_noise - self.noise.centre)
        information[-NOISE:, -NOISE:] += np.diag(self.noise.precision)
        return gradient, information, scores


@dataclass(frozen=True)
class Solution:
    """Where a maximisation ended.

    information: Fisher, over all parameters, of where the last step began, which is `begun`; relative: images (pixels,) of
    the used pixels of each frame; steps: evaluations of the Jacobian.
    """

    state: State
    objective: float
    information: Floats
    relative: Sequence[Floats]
    chi2_per_pixel: float
    steps: int
    converged: bool
    begun: Start | None = field(default=None, repr=False)

    def covariance(self) -> Floats:
        """Cramér-Rao covariance over all parameters; huge, never infinite, where the data do not determine them."""
        return inverse(self.information)


def maximize(
    problem: Problem,
    start: State,
    *,
    free_waves: bool = True,
    exact: bool = True,
    max_steps: int = 40,
    tolerance: float = 0.05,
) -> Solution:
    """The maximum of the likelihood near a start.

    exact: whether slopes are of the whole band; if not it ends, and its information is, a part of a standard error off.
    tolerance: stop when what is left to go is shorter than this many standard errors, all parameters together. Steps shrink
    at least as fast as they did from the last one to this; the information is that of where the last step began.
    """
    here = problem.drawn(start)
    gradient, information, _, evaluations = problem.scores(*here, by_waves=free_waves, exact=exact)
    here = begun = here.undrawn()
    best = problem.objective(here.state, here.relative)
    damping, steps, before, converged = 1e-3, 1, 0.0, False
    while steps < max_steps and not converged and damping < 1e8:
        step = _damped_step(gradient, information, damping)
        length, trial = _length(step, information), Start(here.state.moved(step))  # the last one's drawing goes
        left = length * min(1.0, length / before) if before else length
        last = left < tolerance and length < ON_SLOPES and damping <= 1e-2
        if last:
            trial = trial._replace(relative=problem.foreseen(here.state, step, evaluations))
        elif sane(trial.state, start):
            trial = problem.drawn(trial.state)
        value = problem.objective(trial.state, trial.relative) if trial.relative else -np.inf
        if not value > best:
            converged = length < tolerance
            damping, before = max(damping, 1e-4) * 8, 0.0
            continue
        here, best, damping, before, converged = trial.undrawn(), value, damping / 8, length, last
        if not last:
            gradient, information, _, evaluations = problem.scores(*trial, by_waves=free_waves, exact=exact)
            begun, steps = here, steps + 1
    misfit = problem.chi2_per_pixel(here.state, here.relative)
    return Solution(here.state, best, information, here.relative, misfit, steps, converged, begun)


def _damped_step(gradient: Floats, information: Floats, damping: float) -> Floats:
    """Marquardt's step; parameters without information stay."""
    free = np.diag(information) > 0
    scale = np.zeros_like(gradient)
    scale[free] = 1 / np.sqrt(np.diag(information)[free])
    scaled = information * np.outer(scale, scale) + np.diag(np.where(free, damping, 1.0))
    solved = scipy.linalg.solve(scaled, gradient * scale, assume_a="pos")
    return np.asarray(solved * scale)


def _length(step: Floats, information: Floats) -> float:
    """Of a step, in standard errors."""
    return float(np.sqrt(step @ information @ step))


def sane(state: State, start: State) -> bool:
    """Whether a trial is worth drawing: light on the target, every corner before the lens and not far from its start.

    Without it a pose ran away where defocus was far off, to a target magnified beyond all memory.
    """
    for pose, first in zip(state.poses, start.poses, strict=True):
        reach = STRAY * np.ptp(first.corners_px(), axis=0).max()
        if not (np.abs(pose.v[6:]).sum() < 1 and np.abs(pose.corners_px() - first.corners_px()).max() < reach):
            return False
    return bool(np.all(state.scales > 0))
