"""Damped Fisher scoring: from a start to the nearest maximum of a likelihood (Levenberg-Marquardt on thesis 3.15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np
import scipy.linalg

from labkit.arrays import positive, real_array
from labkit.estimation.identifiability import inverse
from labkit.estimation.likelihood import Detector, FrameData, Score, chi2, log_likelihood, score
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.types import Floats

PER_FRAME = POSE_SIZE + 2  # pose, scale, ambient
NOISE = 2  # log gain, log read variance


class Step(NamedTuple):
    """A step from one position to another.

    Attributes
    ----------
    change : of all parameters
    length : in standard errors
    gain : by which the objective rises if it is a parabola
    """

    change: Floats
    length: float
    gain: float

    @property
    def shortened(self) -> float:
        """What damping leaves to go along the step, over its length: an undamped step promises half of its length squared."""
        return self.gain / self.length**2 - 0.5 if self.length else 0.0


class Position(Protocol):
    """A point of a parameter space. A climb asks for steps only from where it stays, so that slopes may wait until then."""

    @property
    def objective(self) -> float:
        """What is maximised, a log-likelihood; -inf where no climb should go."""
        ...

    def step(self, damping: float) -> Step:
        """Marquardt's step: by the information with its diagonal grown by a share."""
        ...

    def moved(self, change: Floats) -> Self:
        """The position after a change."""
        ...

    def foreseen(self, change: Floats) -> Self | None:
        """The position after a change of a standard error at most, made of the slopes; None where it has to be computed."""
        return None


P = TypeVar("P", bound=Position)


def climb(start: P, *, tolerance: float, max_steps: int = 40, damping: float = 1e-3) -> tuple[P, int, bool]:
    """Climb to the maximum near a start.

    Parameters
    ----------
    start : where to begin
    tolerance : standard errors, all parameters together, by which the end may be off
    max_steps : positions whose slopes are computed, at most
    damping : of the first step, and the least after one that led down

    Returns
    -------
    the end; the number of positions whose slopes were computed; whether the climb settled

    Notes
    -----
    Levenberg (1944), Marquardt (1963). The damping follows the share of its promise that a step gained: H. B. Nielsen,
    report IMM-REP-1999-05, Technical University of Denmark (1999). What a step leaves to go is known beforehand: steps
    shrink at least as fast as they did from the last one to this, unless damping cuts them short. A climb ends with a step
    that leaves less than the tolerance and can be foreseen, or that is itself as short.
    """
    here, steps, before, least = start, 1, 0.0, damping
    converged = False
    while steps < max_steps and not converged and damping * SETTINGS.exact < 1:
        step = here.step(damping)
        slowed = min(1.0, step.length / before) if before else 1.0
        left = step.length * max(slowed, step.shortened)
        near = left < tolerance and step.length < SETTINGS.slopes_stds
        foreseen = here.foreseen(step.change) if near else None
        there = foreseen or here.moved(step.change)
        gained = there.objective - here.objective
        converged = left < tolerance and step.length < tolerance
        if gained > 0:
            converged = converged or foreseen is not None
            damping *= max(1 / 8, 1 - (2 * gained / step.gain - 1) ** 3)
            here, steps, before = there, steps + (foreseen is None), step.length
        else:
            damping, before = 8 * max(damping, least), 0.0
        del there  # a position may hold much memory: one at a time
    return here, steps, converged


def damped_step(gradient: Floats, information: Floats, damping: float) -> Step:
    """Marquardt's step by a gradient (p,) and an information (p, p); parameters without information stay."""
    free = np.diag(information) > 0
    scale = np.zeros_like(gradient)
    scale[free] = 1 / np.sqrt(np.diag(information)[free])
    scaled = information * np.outer(scale, scale) + np.diag(np.where(free, damping, 1.0))
    change = np.asarray(scipy.linalg.solve(scaled, gradient * scale, assume_a="pos") * scale)
    square = float(change @ information @ change)
    return Step(change, square**0.5, float(change @ gradient) - square / 2)


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

    def moved(self, step: Floats) -> State:
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


class Start(NamedTuple):
    """A state; the target at its poses, and the relative images (pixels,) of the frames there, if they are at hand."""

    state: State
    drawing: Drawing | None = None
    relative: Sequence[Floats] = ()

    def undrawn(self) -> Start:
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
    tolerance: float = SETTINGS.converged_stds,
) -> Solution:
    """Climb to the maximum of the likelihood near a start.

    Parameters
    ----------
    problem : frames and their model
    start : where to begin
    free_waves : whether the modes change
    exact : whether slopes are of the whole band; if not, the end and its information are a part of a standard error off
    max_steps, tolerance : as in `climb`; the information is that of where the last step began
    """
    position = _Drawn(problem, start, free_waves, exact, problem.drawn(start))
    end, steps, converged = climb(position, max_steps=max_steps, tolerance=tolerance)
    begun = end.begun or end
    state, relative = end.at.state, end.at.relative
    return Solution(
        state,
        end.objective,
        begun.slopes[1],
        relative,
        problem.chi2_per_pixel(state, relative),
        steps,
        converged,
        begun.at,
    )


@dataclass(eq=False)
class _Drawn(Position):
    """Where a climb over frames stands.

    Attributes
    ----------
    first : where it began
    at : the state; its drawing is kept until the slopes are known
    begun : where the last step began, if `at` was reached by that
    """

    problem: Problem
    first: State
    free_waves: bool
    exact: bool
    at: Start
    begun: _Drawn | None = None

    @cached_property
    def objective(self) -> float:
        """Log-likelihood, see `Problem.objective`."""
        return self.problem.objective(self.at.state, self.at.relative) if self.at.relative else -np.inf

    @cached_property
    def slopes(self) -> tuple[Floats, Floats, list[Evaluation]]:
        """Gradient, information, and what they were made of."""
        gradient, information, _, evaluations = self.problem.scores(
            *self.at, by_waves=self.free_waves, exact=self.exact
        )
        self.at = self.at.undrawn()
        return gradient, information, evaluations

    def step(self, damping: float) -> Step:
        gradient, information, _ = self.slopes
        return damped_step(gradient, information, damping)

    def moved(self, change: Floats) -> _Drawn:
        state = self.at.state.moved(change)
        start = self.problem.drawn(state) if sane(state, self.first) else Start(state)
        return replace(self, at=start)

    def foreseen(self, change: Floats) -> _Drawn:
        state = self.at.state.moved(change)
        relative = self.problem.foreseen(self.at.state, change, self.slopes[2])
        return replace(self, at=Start(state, None, relative), begun=self)


def sane(state: State, start: State) -> bool:
    """Whether a trial is worth drawing: light on the target, every corner before the lens, near where the target was found.

    Corners are known to about a pixel beforehand; half of the target's size is allowed.

    Without that a pose ran away where defocus was far off, to a target magnified beyond all memory.
    """
    for pose, first in zip(state.poses, start.poses, strict=True):
        reach = 0.5 * np.ptp(first.corners_px(), axis=0).max()
        if not (np.abs(pose.v[6:]).sum() < 1 and np.abs(pose.corners_px() - first.corners_px()).max() < reach):
            return False
    return bool(np.all(state.scales > 0))
