"""The f-number of the cone that reaches the sensor, freed: engravings are right to some 3 %, and defocus hangs on it.

A wavefront's fit holds the cone. Here its optimum is moved to the cone that the frames call for, and the likelihood about it
is summed up in a measurement: modes, f-number and size of the picture with their full covariance, all that a session's other
frames have to do with. Exact to second order about a cone that the last step hardly changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse

from labkit.estimation.candidate import Measured
from labkit.estimation.climb import NOISE, PER_FRAME, Problem, Solution, Start, State, sane
from labkit.estimation.identifiability import inverse
from labkit.estimation.likelihood import slopes
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.types import Bools, Floats


@dataclass(frozen=True)
class Freed:
    """Where a fit ends once its cone is free, and what of the camera is.

    expansion: the last, which the last step began at; optics: of where it ends; covariance: (modes, modes) of the modes, the
    shape's prior error in it; measured: without that prior; sandwich: the same if residuals are not noise alone.
    """

    expansion: Expansion
    solution: Solution
    optics: Optics
    covariance: Floats
    measured: Measured
    sandwich: Measured


@dataclass(frozen=True)
class Expansion:
    """The log-likelihood about a state to second order, over modes, shape, and the rest as in `Problem.scores`.

    gradient: (p,); information: (p, p);
    picked: (modes + shape + 1, p) what modes, shape and ln scale change by, which are `here` at the state. evaluations: of
    each frame.
    """

    problem: Problem
    state: State
    gradient: Floats
    information: Floats
    here: Floats
    picked: Floats
    evaluations: tuple[Evaluation, ...]

    @property
    def optics(self) -> Optics:
        """Those that it is about."""
        return self.problem.model.optics

    @property
    def shape(self) -> slice:
        """Where `Optics.shape` stands among the parameters, (p,)."""
        modes = self.state.waves.size
        return slice(modes, modes + self.optics.shape.size)

    def newton(self, precision: Floats, pull: Floats | float = 0.0) -> tuple[Floats, Floats]:
        """(p,) the step to the optimum and (p, p) the covariance there; precision, pull: (shape,) of what else is known."""
        at = np.arange(self.shape.start, self.shape.stop)
        information, gradient = self.information.copy(), self.gradient.copy()
        information[at, at] += precision
        gradient[at] += pull
        covariance = inverse(information)
        return covariance @ gradient, covariance

    @cached_property
    def _scattered(self) -> tuple[Floats, Floats]:
        return _scattered(self.problem, self.state, self.evaluations)

    @property
    def flats(self) -> Floats:
        """(p, p) the part of the gradient's covariance that the flats' errors make."""
        return self._scattered[0]

    @property
    def scattered(self) -> Floats:
        """(p, p) the gradient's covariance as blocks of pixels scatter."""
        return self._scattered[1]

    def surplus(self, covariance: Floats) -> Floats:
        """(p, p) by which a covariance (p, p) of the optimum grows if residuals are not noise alone.

        To the sandwich's, where that is larger: H. White, Econometrica 50, 1 (1982).
        """
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        beyond, along = np.linalg.eigh(root.T @ (self.scattered - self.information) @ root)
        grown = root @ along * np.sqrt(np.maximum(beyond, 0.0))
        return np.asarray(grown @ grown.T)

    @property
    def objective(self) -> float:
        """Log-likelihood at the state."""
        return self.problem.objective(self.state, [e.mean for e in self.evaluations])

    def moved(self, step: Floats) -> State:
        """The state after a step (p,)."""
        return self.state.moved(np.delete(step, self.shape))

    def optics_after(self, step: Floats) -> Optics:
        """Those after a step (p,)."""
        return self.optics.shaped(self.optics.shape + step[self.shape])

    def within(self, step: Floats, covariance: Floats) -> Floats:
        """A step (p,), or where it leads beyond what the camera's numbers may be: to there, all else as likely as it can be.

        covariance: (p, p) at the optimum.
        """
        beyond = self.optics_after(step).shape - (self.optics.shape + step[self.shape])
        at = self.shape.start + np.flatnonzero(np.abs(beyond) > SETTINGS.exact * self.optics.usual_shape)
        held = np.linalg.solve(covariance[np.ix_(at, at)], beyond[at - self.shape.start])
        return step + covariance[:, at] @ held

    def foreseen(self, step: Floats) -> list[Floats]:
        """Relative images (pixels,) of the frames after a short step (p,)."""
        return self.problem.foreseen(self.state, step, self.evaluations)

    def with_parts(self, optics: Optics) -> Expansion:
        """The same with more parts, behind those that it has. They do nothing there, so that all that is at hand is right."""
        problem, state = replace(self.problem, model=self.problem.model.shaped(optics)), self.state
        used, have = [frame.used for frame in problem.frames], self.optics.parts
        more = problem.model.by_parts(state.waves, problem.draw(state), used, first=len(have))
        behind = state.waves.size + sum(len(part.labels) for part in have)
        evaluations = [
            replace(each, by_waves=np.insert(each.by_waves, [behind] * len(rows), rows, axis=0))
            for each, rows in zip(self.evaluations, more, strict=True)
        ]
        return _expansion(problem, state, evaluations)

    def measured(self) -> Measured:
        """The Gaussian of modes, shape and scale."""
        step, covariance = self.newton(self.optics.usual_shape**-2)
        pulled = self.picked @ covariance
        values = self.here + self.picked @ self.within(step, covariance)
        at = self.shape.stop + np.arange(POSE_SIZE)
        return Measured(
            self.optics.noll,
            values,
            pulled @ self.picked.T,
            pulled @ self.flats @ pulled.T,
            _foreshortening(self.moved(step).poses[0], covariance[np.ix_(at, at)]),
            self.optics.shape_labels,
        )

    def sandwich(self, measured: Measured) -> Measured:
        """What `measured` says, if residuals are not noise alone: with larger errors."""
        _, covariance = self.newton(self.optics.usual_shape**-2)
        model = self.picked @ self.surplus(covariance) @ self.picked.T
        return replace(measured, covariance=measured.covariance + model, model=model)

    def at(self, values: Floats) -> tuple[State, Optics]:
        """The state, and the optics, that are likeliest where modes, shape and ln scale are given, (modes + shape + 1,)."""
        step, covariance = self.newton(self.optics.usual_shape**-2)
        pulled = self.picked @ covariance
        step = step + pulled.T @ np.linalg.solve(pulled @ self.picked.T, values - self.here - self.picked @ step)
        return self.moved(step), self.optics_after(step)


def free_cone(problem: Problem, start: Start, f_number_std: float) -> Freed:
    """Climb by Newton's steps, halved where they lead down, to an optimum that is near, and to the cone, and the camera's
    parts, that its frames call for.

    f_number_std: relative, of the cone that the problem has; the parts' numbers are known to lie about 0, as they usually do.
    The first step goes by rough slopes, those after it by exact ones; the last is not drawn, its picture lies on the slopes.
    Where they do not settle, `Freed.solution.converged` says so.
    """
    problem, start = _wide_enough(problem, start)
    given, precision = _known_shape(problem.model.optics, f_number_std)
    best, taken, halvings = None, np.empty(0), 0
    for rounds in range(1, SETTINGS.newton_rounds + 1):
        expansion = expand(problem, start, exact=rounds > 1)
        fallen = best is not None and expansion.objective < best.objective - SETTINGS.same_optimum
        if fallen and best is not None and halvings < 2 and rounds < SETTINGS.newton_rounds:
            taken, halvings = 0.5 * taken, halvings + 1
            problem, start = _stepped(problem, best, taken)
            continue
        step, covariance = expansion.newton(precision, (given - expansion.optics.shape) * precision)
        step = expansion.within(step, covariance)
        length = float(np.sqrt(step @ np.linalg.solve(covariance, step)))
        near, cone = length < SETTINGS.slopes_stds, expansion.shape.stop - 1
        close = abs(step[cone]) < SETTINGS.settled_stds * np.sqrt(covariance[cone, cone])
        settled = rounds > 1 and near and close and not fallen
        wild = abs(step[cone]) > 3 * SETTINGS.loose or not sane(expansion.moved(step), start.state)
        if settled or fallen or wild or rounds == SETTINGS.newton_rounds:
            break
        best, taken, halvings = expansion, step, 0
        problem, start = _stepped(problem, expansion, step)
    return _ended(expansion, step if near else np.zeros_like(step), covariance, rounds, settled)


def _ended(expansion: Expansion, step: Floats, covariance: Floats, rounds: int, settled: bool) -> Freed:
    """After a last step (p,) from an expansion, which is not drawn: its picture lies on the slopes."""
    problem, modes = expansion.problem, expansion.state.waves.size
    state, relative, measured = expansion.moved(step), expansion.foreseen(step), expansion.measured()
    solution = Solution(
        state,
        problem.objective(state, relative),
        np.delete(np.delete(expansion.information, expansion.shape, 0), expansion.shape, 1),
        relative,
        problem.chi2_per_pixel(state, relative),
        rounds,
        settled,
    )
    return Freed(
        expansion,
        solution,
        expansion.optics_after(step),
        covariance[:modes, :modes],
        measured,
        expansion.sandwich(measured),
    )


def _stepped(problem: Problem, expansion: Expansion, step: Floats) -> tuple[Problem, Start]:
    """The problem, and where to begin, after a step (p,) from an expansion."""
    before, start = expansion.state, Start(expansion.moved(step))
    return replace(problem, model=reshaped(problem.model, expansion.optics_after(step), before)), start


def _known_shape(optics: Optics, f_number_std: float) -> tuple[Floats, Floats]:
    """What is known of a shape beforehand, and how precisely, 1/variance: (shape,) each."""
    given, stds = np.zeros_like(optics.shape), optics.usual_shape
    given[-1], stds[-1] = optics.shape[-1], max(f_number_std, SETTINGS.exact)
    return given, stds**-2


def reshaped(model: ForwardModel, optics: Optics, state: State) -> ForwardModel:
    """The same model of another shape, built anew about a state where it does not spare enough of the cone."""
    try:
        return model.shaped(optics)
    except ValueError:
        return model.again(optics, state.poses[0], waves=state.waves, spare=SETTINGS.spare_cone)


def _wide_enough(problem: Problem, start: Start) -> tuple[Problem, Start]:
    """With a window that holds what the start's wavefront throws far."""
    model, state = problem.model, start.state
    if model.window_airy >= SETTINGS.narrow_window * model.optics.window_airy(state.waves):
        return problem, start
    wider = model.again(model.optics, state.poses[0], waves=state.waves, spare=SETTINGS.spare_cone)
    return replace(problem, model=wider), Start(state)


def expand(problem: Problem, start: Start, *, exact: bool = True) -> Expansion:
    """The log-likelihood about a state, the shape free. exact: as in `ForwardModel.evaluate`."""
    state, used = start.state, [f.used for f in problem.frames]
    drawing = start.drawing or problem.draw(state)
    return _expansion(
        problem,
        state,
        problem.model.evaluate(state.waves, drawing, used, by_shape=True, exact=exact, means=start.relative),
    )


def _expansion(problem: Problem, state: State, evaluations: Sequence[Evaluation]) -> Expansion:
    """From derivatives by modes, shape and pose."""
    gradient, information = _assembled(problem, state, evaluations)
    here, picked = _picked(problem, state, len(gradient))
    return Expansion(problem, state, gradient, information, here, picked, tuple(evaluations))


def _assembled(problem: Problem, state: State, evaluations: Sequence[Evaluation]) -> tuple[Floats, Floats]:
    """Gradient (p,) and information (p, p), where what is not known of the target's own light takes its likeliest value."""
    shining = [replace(e, by_waves=np.concatenate([e.by_waves, e.by_shine])) for e in evaluations if len(e.by_shine)]
    gradient, information, _ = problem.assembled(state, shining or evaluations)
    if not shining:
        return gradient, information
    first = len(evaluations[0].by_waves)
    out = np.arange(first, first + len(evaluations[0].by_shine))
    rest = np.delete(np.arange(len(gradient)), out)
    across = information[np.ix_(out, rest)]
    known = np.linalg.solve(information[np.ix_(out, out)] + np.eye(len(out)), np.column_stack([gradient[out], across]))
    return gradient[rest] - across.T @ known[:, 0], information[np.ix_(rest, rest)] - across.T @ known[:, 1:]


def _scattered(problem: Problem, state: State, evaluations: Sequence[Evaluation]) -> tuple[Floats, Floats]:
    """(p, p) each, covariances of the gradient over modes, shape, and so on: what the flats' relative errors make of it, and
    what blocks of pixels show, of which a pixel's residuals may be alike but blocks' are not."""
    modes, even, frames = len(evaluations[0].by_waves), state.unevenness.size, len(state.poses)
    size = modes + PER_FRAME * frames + even + NOISE
    flats, blocks = np.zeros((size, size)), np.zeros((size, SETTINGS.blocks**2))
    for k, (evaluation, frame, detector) in enumerate(zip(evaluations, problem.frames, state.detectors(), strict=True)):
        of = slopes(evaluation, frame, detector)
        at_frame = np.arange(PER_FRAME) + modes + k * PER_FRAME
        index = np.concatenate([np.arange(modes), at_frame, np.arange(size - NOISE - even, size)])
        weighted = of.of_mean * (frame.relative_std[frame.used] * of.mean / of.variance)
        flats[np.ix_(index[:-NOISE], index[:-NOISE])] += weighted @ weighted.T
        by_mean, by_variance = of.pulls(frame.counts[frame.used])
        pulled = np.concatenate([of.of_mean * by_mean, of.of_variance * by_variance])
        blocks[index] += pulled @ _in_blocks(frame.used)
    blocks -= blocks.mean(axis=1, keepdims=True)
    return flats, np.asarray(blocks @ blocks.T)


def _in_blocks(used: Bools) -> scipy.sparse.csr_array:
    """(pixels, blocks^2) 1 for the block that a used pixel lies in."""
    rows, columns = (at * SETTINGS.blocks // n for at, n in zip(np.nonzero(used), used.shape, strict=True))
    pixels = rows.size
    return scipy.sparse.csr_array(
        (np.ones(pixels), (np.arange(pixels), rows * SETTINGS.blocks + columns)), (pixels, SETTINGS.blocks**2)
    )


def _foreshortening(pose: Pose, covariance: Floats) -> tuple[float, float]:
    """Mean and standard deviation over the poses that a covariance (8, 8) allows.

    Where the picture hardly determines which way the target leans, that is far from linear in the pose.
    """
    root = scipy.linalg.sqrtm(covariance).real
    steps = np.random.default_rng(0).normal(size=(SETTINGS.tilt_draws, POSE_SIZE)) @ root
    values = [pose.moved(step).log_foreshortening() for step in steps]
    return float(np.mean(values)), float(np.std(values))


def _picked(problem: Problem, state: State, size: int) -> tuple[Floats, Floats]:
    """Modes, shape and ln scale, (modes + shape + 1,), the last a mean over the frames; and their slopes, by all (size,)."""
    shape, frames = problem.model.optics.shape, len(state.poses)
    first = state.waves.size + shape.size
    picked = np.zeros((first + 1, size))
    picked[:first, :first] = np.eye(first)
    scales = []
    for k, pose in enumerate(state.poses):
        scale, slope = pose.log_scale()
        scales.append(scale)
        at = first + k * PER_FRAME
        picked[-1, at : at + POSE_SIZE] = slope / frames
    pitch_mm = problem.model.scene.torus.pitch_um * 1e-3
    return np.concatenate([state.waves, shape, [np.mean(scales) + np.log(pitch_mm)]]), picked
