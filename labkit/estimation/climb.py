"""Damped Fisher scoring from a start to the nearest maximum of a likelihood (Levenberg-Marquardt on thesis 3.15)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from labkit.arrays import positive, real_array
from labkit.estimation.identifiability import inverse
from labkit.estimation.levenberg_marquardt import Position, Step, climb, damped_step
from labkit.estimation.likelihood import (
    Detector,
    FrameData,
    Score,
    chi2,
    log_likelihood,
    score,
)
from labkit.estimation.prior import Prior
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.optics.zernike import mode_name
from labkit.types import Floats, Indices

OF_A_FRAME = (*(f"pose {i}" for i in range(POSE_SIZE)), "scale", "ambient light")
PER_FRAME = len(OF_A_FRAME)
NOISE = 2  # log gain, log read variance


@dataclass(frozen=True)
class NoisePrior:
    """Noise measured by flats and darks: independent measurements that join the likelihood.

    Attributes
    ----------
    gain : counts per electron
    read_variance : counts^2
    gain_std, read_variance_std : relative standard errors

    Raises
    ------
    ValueError : a number is not positive
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


MOST_LIGHT = 1e6
"""Largest light of a trial over that where a climb began, or over one count."""

STEEPEST_LIGHT = 10.0
"""Largest coefficient of uneven light: at 1 it is dark in a corner."""


@dataclass(frozen=True)
class State:
    """A point of the parameter space.

    Attributes
    ----------
    waves : (modes,) waves RMS
    poses, scales, ambients : pose, scale and ambient light of each frame; light in counts
    log_noise : logarithms of gain (counts per electron) and read variance (counts^2), of all frames
    unevenness : (k,) of the illumination, of all frames; empty if flats determine it
    """

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
        real_array(
            "log_noise",
            self.log_noise,
            (NOISE,),
            "logarithms of counts per electron and of counts^2",
        )
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

    def parameter_names(self, noll: Sequence[int]) -> tuple[str, ...]:
        """Name all parameters in the order of `moved`. noll: Noll's numbers of the modes."""
        frames = [
            f"{name} of frame {k + 1}"
            for k in range(len(self.poses))
            for name in OF_A_FRAME
        ]
        light = [f"unevenness {k + 1}" for k in range(self.unevenness.size)]
        return (*map(mode_name, noll), *frames, *light, "log gain", "log read variance")

    def places(self, rows: int) -> list[Indices]:
        """Return the places of each frame's parameters among all. rows: number of derivatives by modes and camera."""
        first = max(rows, self.waves.size)
        end = first + PER_FRAME * len(self.poses)
        common = np.arange(end, end + self.unevenness.size + NOISE)
        return [
            np.r_[:rows, at : at + PER_FRAME, common] for at in range(first, end, PER_FRAME)
        ]

    def moved(self, step: Floats) -> State:
        """Return the state after a step in all parameters: modes; pose, scale, ambient of each frame; unevenness; noise."""
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
    """A state, with the target drawn at its poses and the relative image (pixels,) of each frame, if at hand."""

    state: State
    drawing: Drawing | None = None
    relative: Sequence[Floats] = ()

    def undrawn(self) -> Start:
        """Drop the drawing: for a large target it holds hundreds of megabytes."""
        return self._replace(drawing=None)


@dataclass(frozen=True)
class Problem:
    """Frames of one wavefront with their model and calibrated noise."""

    model: ForwardModel
    frames: tuple[FrameData, ...]
    noise: NoisePrior

    def draw(self, state: State) -> Drawing:
        """Draw the target at a state's poses; callers pass the drawing to several evaluations at one state to save time."""
        return self.model.draw(state.poses)

    def relative(self, state: State, drawing: Drawing | None = None) -> list[Floats]:
        """Return the relative image (pixels,) of each frame. drawing: drawing at the state's poses, if at hand."""
        return self.model.means(
            state.waves, drawing or self.draw(state), [f.used for f in self.frames]
        )

    def drawn(self, state: State) -> Start:
        """Return a state with its drawing and relative images."""
        drawing = self.draw(state)
        return Start(state, drawing, self.relative(state, drawing))

    def objective(self, state: State, relative: Sequence[Floats]) -> float:
        """Return the log-likelihood of frames and noise calibration."""
        total = sum(
            log_likelihood(u, f, d)
            for u, f, d in zip(relative, self.frames, state.detectors(), strict=True)
        )
        return total - 0.5 * float(
            self.noise.precision @ (state.log_noise - self.noise.centre) ** 2
        )

    def foreseen(
        self, state: State, step: Floats, evaluations: Sequence[Evaluation]
    ) -> list[Floats]:
        """Predict the relative image (pixels,) of each frame after a short step, from the slopes at its start."""
        modes = max(state.waves.size, len(evaluations[0].by_waves))
        poses = step[modes : modes + PER_FRAME * len(self.frames)].reshape(-1, PER_FRAME)[
            :, :POSE_SIZE
        ]
        moved = [
            e.mean + by_v @ e.by_pose for e, by_v in zip(evaluations, poses, strict=True)
        ]
        return [
            mean + step[: len(e.by_waves)] @ e.by_waves
            for mean, e in zip(moved, evaluations, strict=True)
        ]

    def chi2_per_pixel(self, state: State, relative: Sequence[Floats]) -> float:
        """Return the mean of squared residuals over the variance at the state."""
        total = [
            chi2(u, f, d)
            for u, f, d in zip(relative, self.frames, state.detectors(), strict=True)
        ]
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
        """Compute gradient and Fisher information over all parameters (rows of fixed modes are 0), in total and by frame.

        Parameters
        ----------
        state : point of evaluation
        drawing, relative : drawing and relative images at the state, if at hand
        by_waves, exact : see `ForwardModel.evaluate`
        """
        used, drawing = [f.used for f in self.frames], drawing or self.draw(state)
        evaluations = self.model.evaluate(
            state.waves, drawing, used, by_waves=by_waves, exact=exact, means=relative
        )
        return *self.assembled(state, evaluations), evaluations

    def assembled(
        self, state: State, evaluations: Sequence[Evaluation]
    ) -> tuple[Floats, Floats, list[Score]]:
        """Assemble gradient and information from evaluations, which may include derivatives by camera parameters."""
        places = state.places(len(evaluations[0].by_waves))
        size = 1 + int(places[0][-1])
        gradient, information = np.zeros(size), np.zeros((size, size))
        scores = [
            score(e, f, d)
            for e, f, d in zip(evaluations, self.frames, state.detectors(), strict=True)
        ]
        for index, of_frame in zip(places, scores, strict=True):
            gradient[index] += of_frame.gradient
            information[np.ix_(index, index)] += of_frame.information
        gradient[-NOISE:] -= self.noise.precision * (state.log_noise - self.noise.centre)
        information[-NOISE:, -NOISE:] += np.diag(self.noise.precision)
        return gradient, information, scores


@dataclass(frozen=True)
class Solution:
    """The end of a maximisation.

    Attributes
    ----------
    state : the end
    objective : log-likelihood at the end
    information : Fisher information over all parameters where the last step began
    relative : relative image (pixels,) of the used pixels of each frame
    chi2_per_pixel : of the residuals
    steps : number of evaluations of the Jacobian
    converged : whether the climb settled
    begun : start of the last step
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
        """Return the Cramér-Rao covariance of all parameters; undetermined parameters have huge, but finite, variances."""
        return inverse(self.information)


def maximize(
    problem: Problem,
    start: State,
    *,
    free_waves: bool = True,
    exact: bool = True,
    max_steps: int = 40,
    tolerance: float = SETTINGS.converged_stds,
    prior: Prior | None = None,
) -> Solution:
    """Climb to the maximum of the likelihood near a start.

    Parameters
    ----------
    problem : frames and their model
    start : where to begin
    free_waves : whether the modes change
    exact : whether slopes cover the whole band; otherwise end and information are off by a fraction of a standard error
    max_steps, tolerance : see `climb`; the returned information is valid where the last step began, and without the prior
    prior : of the modes
    """
    position = _Drawn(problem, start, free_waves, exact, problem.drawn(start), prior)
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
    """A position of a climb over frames.

    Attributes
    ----------
    problem : frames and their model
    first : start of the climb
    free_waves, exact, prior : see `maximize`
    at : the state; its drawing is kept until the slopes are known
    begun : start of the last step, if `at` was predicted from slopes
    """

    problem: Problem
    first: State
    free_waves: bool
    exact: bool
    at: Start
    prior: Prior | None
    begun: _Drawn | None = None

    @cached_property
    def objective(self) -> float:
        """Log-likelihood, see `Problem.objective`, less what the modes lose by their prior."""
        if not self.at.relative:
            return -np.inf
        state = self.at.state
        lost = self.prior.loss(state.waves) if self.prior else 0.0
        return self.problem.objective(state, self.at.relative) - lost

    @cached_property
    def slopes(self) -> tuple[Floats, Floats, list[Evaluation]]:
        """Gradient, information, and the evaluations."""
        gradient, information, _, evaluations = self.problem.scores(
            *self.at, by_waves=self.free_waves, exact=self.exact
        )
        self.at = self.at.undrawn()
        return gradient, information, evaluations

    def step(self, damping: float) -> Step:
        gradient, information, _ = self.slopes
        if self.prior and self.free_waves:
            gradient, information = self.prior.joined(
                gradient, information, self.at.state.waves
            )
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
    """Return whether a trial is plausible: positive light, every corner in front of the lens and near the start's corner.

    Light that the photographs hardly tell makes steps of any size, whose squares are beyond all numbers. Corners are known to
    about a pixel beforehand; half of the target's size is allowed. Without the test a pose with a defocus far off diverged to a
    target too magnified to draw in memory.
    """
    for pose, first in zip(state.poses, start.poses, strict=True):
        reach = 0.5 * np.ptp(first.corners_px(), axis=0).max()
        if not (
            np.abs(pose.v[6:]).sum() < 1
            and np.abs(pose.corners_px() - first.corners_px()).max() < reach
        ):
            return False
    light = np.abs([state.scales, state.ambients]).max()
    usual = max(np.abs([start.scales, start.ambients]).max(), 1.0)
    even = bool(np.all(np.abs(state.unevenness) < STEEPEST_LIGHT))
    return bool(np.all(state.scales > 0)) and bool(light < MOST_LIGHT * usual) and even
