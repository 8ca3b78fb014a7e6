"""The f-number of the cone that reaches the sensor, freed: engravings are right to some 3 %, and defocus hangs on it.

A wavefront's fit holds the cone. Here its optimum is moved to the cone that the frames call for, and the likelihood about it
is summed up in a measurement: modes, f-number and size of the picture with their full covariance, all that a session's other
frames have to do with. Exact to second order about a cone that the last step hardly changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.imaging.blur import Blur
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.inference.fisher_scoring import NOISE, PER_FRAME, Problem, Solution, State, maximize
from labkit.inference.identifiability import inverse
from labkit.inference.likelihood import slopes
from labkit.types import Bools, Floats

STEP = 2e-3  # of ln N in the differences
ROUNDS = 4  # the second lands within SETTLED where the engraving is 6 % off
# of ln N: a step so small, or so small a part of its error, moves the optimum by less than 1e-5 waves beyond second order
SETTLED, SETTLED_STDS = 2e-3, 0.3
OPEN_STD = 1.0  # of ln N, a prior that keeps what a frame in focus leaves open finite
CLIMB_STEPS = 8
EXACT = 1e-6  # a relative error that moves nothing


@dataclass(frozen=True)
class Measured:
    """What frames of one channel at one range say: a Gaussian over (modes..., ln N of the cone, ln of the picture's scale).

    values: (modes + 2,); covariance: of photons and read noise, (modes + 2, modes + 2), with no prior on N.
    scale: sensor over target, mm per mm, whatever the target's tilt. calibration: the part of the
    covariance that the flats' own errors make.
    """

    noll: tuple[int, ...]
    values: Floats
    covariance: Floats
    calibration: Floats

    def twin(self, signs: Floats) -> Measured:
        """With even modes reversed. signs: (modes,)."""
        signs = np.append(signs, [1.0, 1.0])
        both = np.outer(signs, signs)
        return replace(
            self, values=self.values * signs, covariance=self.covariance * both, calibration=self.calibration * both
        )


@dataclass(frozen=True)
class Freed:
    """Where a fit ends once its cone is free. problem: at the cone reached; covariance: (modes, modes) of the modes, the
    cone's prior error in it; measured: without that prior."""

    problem: Problem
    solution: Solution
    f_number: float
    covariance: Floats
    measured: Measured


def free_cone(problem: Problem, solution: Solution, f_number_std: float) -> Freed:
    """Move an optimum to the cone that its frames call for. f_number_std: relative, of the one that it was found with."""
    given, precision = problem.model.blur.pupil.f_number, max(f_number_std, EXACT) ** -2
    for _ in range(ROUNDS):
        state, modes = solution.state, solution.state.waves.size
        now = problem.model.blur.pupil.f_number
        gradient, information, flats = _scores(problem, state)
        known = information.copy()
        known[modes, modes] += precision
        pull = gradient.copy()
        pull[modes] -= np.log(now / given) * precision
        covariance = inverse(known)
        step = covariance @ pull
        if abs(step[modes]) < max(SETTLED, SETTLED_STDS * np.sqrt(covariance[modes, modes])):
            break
        problem = replace(problem, model=at_f_number(problem.model, float(now * np.exp(step[modes])), state.poses[0]))
        solution = maximize(problem, state.moved(np.delete(step, modes)), max_steps=CLIMB_STEPS)
    state = solution.state
    measured = _measured(problem, state, gradient, information, flats)
    return Freed(problem, solution, problem.model.blur.pupil.f_number, covariance[:modes, :modes], measured)


def at_f_number(model: ForwardModel, f_number: float, reference: Pose) -> ForwardModel:
    """The same model with another cone."""
    return ForwardModel.build(
        replace(model.optics, f_number=f_number), model.scene.target, model.scene.torus.frame, reference
    )


def slopes_by_cone(model: ForwardModel, waves: Floats, drawing: Drawing, used: Sequence[Bools]) -> list[Floats]:
    """Derivatives (pixels,) of each frame's mean by ln N of the cone, modes in waves held.

    By differences towards larger N, where the PSF is sampled well enough: right to about STEP^2.
    """
    blur = model.blur
    means = []
    for k in range(3):
        pupil = replace(blur.pupil, f_number=blur.pupil.f_number * np.exp(k * STEP))
        means.append(replace(model, blur=Blur(blur.torus, pupil, blur.active_um)).means(waves, drawing, used))
    return [np.asarray((-3 * here + 4 * one - two) / (2 * STEP)) for here, one, two in zip(*means, strict=True)]


def _scores(problem: Problem, state: State) -> tuple[Floats, Floats, Floats]:
    """Gradient and information over modes, ln N, and the rest as in `Problem.scores`; and the part of the information's
    noise that is the flats' own."""
    drawing, used = problem.draw(state), [f.used for f in problem.frames]
    evaluations = problem.model.evaluate(state.waves, drawing, used)
    by_cone = slopes_by_cone(problem.model, state.waves, drawing, used)
    joined = [
        Evaluation(e.mean, np.concatenate([e.by_waves, cone[None]]), e.by_pose)
        for e, cone in zip(evaluations, by_cone, strict=True)
    ]
    gradient, information, _ = problem.assembled(state, joined)
    return gradient, information, _flats_noise(problem, state, joined)


def _flats_noise(problem: Problem, state: State, evaluations: Sequence[Evaluation]) -> Floats:
    """(p, p) covariance of the gradient, over modes, ln N, and so on, that the flats' relative errors make."""
    modes, even, frames = state.waves.size + 1, state.unevenness.size, len(state.poses)
    size = modes + PER_FRAME * frames + even + NOISE
    total = np.zeros((size, size))
    for k, (evaluation, frame, detector) in enumerate(zip(evaluations, problem.frames, state.detectors(), strict=True)):
        of = slopes(evaluation, frame, detector)
        at_frame = np.arange(PER_FRAME) + modes + k * PER_FRAME
        index = np.concatenate([np.arange(modes), at_frame, np.arange(size - NOISE - even, size - NOISE)])
        weighted = of.of_mean * (frame.relative_std[frame.used] * of.mean / of.variance)
        total[np.ix_(index, index)] += weighted @ weighted.T
    return total


def _measured(problem: Problem, state: State, gradient: Floats, information: Floats, flats: Floats) -> Measured:
    """The Gaussian of modes, ln N and scale about a state near the optimum."""
    modes, frames = state.waves.size, len(state.poses)
    known = information.copy()
    known[modes, modes] += OPEN_STD**-2
    covariance = inverse(known)
    wanted = np.zeros((modes + 2, len(gradient)))
    wanted[: modes + 1, : modes + 1] = np.eye(modes + 1)
    scales = []
    for k, pose in enumerate(state.poses):
        at = slice(modes + 1 + k * PER_FRAME, modes + 1 + k * PER_FRAME + POSE_SIZE)
        scale, slope = pose.log_scale()
        scales.append(scale)
        wanted[-1, at] = slope / frames
    pupil, pitch_mm = problem.model.blur.pupil, problem.model.scene.torus.pitch_um * 1e-3
    here = np.concatenate([state.waves, [np.log(pupil.f_number), np.mean(scales) + np.log(pitch_mm)]])
    pull = wanted @ covariance
    return Measured(pupil.noll, here + pull @ gradient, pull @ wanted.T, pull @ flats @ pull.T)
