"""Free the working f-number of a fit, and summarise the likelihood about its optimum as a Gaussian measurement.

Engraved f-numbers are right to some 3 %, and defocus depends on the f-number. Newton's steps move the optimum of a wavefront
to the f-number and the camera parameters that the frames favour. The measurement holds modes, camera parameters, ln of the
f-number and ln of the picture's scale with their full covariance: all parameters that other frames of a session share. The
expansion is exact to second order about an f-number that the last step hardly changed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse

from labkit.estimation.candidate import Measured
from labkit.estimation.carried import carried
from labkit.estimation.climb import PER_FRAME, Problem, Solution, Start, State, sane
from labkit.estimation.identifiability import inverse
from labkit.estimation.levenberg_marquardt import Position, Step, climb
from labkit.estimation.prior import Prior
from labkit.estimation.ridge import Ridge
from labkit.estimation.sandwich import scattered
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import Evaluation, ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import POSE_SIZE, Pose
from labkit.types import Floats


@dataclass(frozen=True)
class Freed:
    """The end of a fit with free working f-number and free camera parameters.

    Attributes
    ----------
    expansion : the likelihood where the last step began
    solution : the end of the climb
    optics : f-number and camera parts at the end
    covariance : (modes, modes) of the modes, waves RMS squared, the errors of the camera parameters' prior included
    measured : the measurement, without a prior on the f-number
    sandwich : the measurement with sandwich errors, which hold if residuals are not noise alone
    ridge : of the likelihood about the end
    """

    expansion: Expansion
    solution: Solution
    optics: Optics
    covariance: Floats
    measured: Measured
    sandwich: Measured
    ridge: Ridge


@dataclass(frozen=True)
class Expansion:
    """The log-likelihood about a state to second order.

    The p parameters are modes, camera parameters, and the rest as in `Problem.scores`. Of m = modes + camera parameters + 1
    measured values, the last is ln of the picture's scale.

    Attributes
    ----------
    problem : frames and their model
    state : the point of expansion
    gradient : (p,) of the log-likelihood, the unknown part of the target's own light at its likeliest value
    information : (p, p) Fisher information, likewise
    uphill : gradient and information where this light is as given: those of `objective`
    values : (m,) measured values at the state
    projection : (m, p) derivatives of the measured values by the parameters
    evaluations : model and derivatives for each frame
    """

    problem: Problem
    state: State
    gradient: Floats
    information: Floats
    uphill: tuple[Floats, Floats]
    values: Floats
    projection: Floats
    evaluations: tuple[Evaluation, ...]

    @property
    def optics(self) -> Optics:
        """Optics at the state."""
        return self.problem.model.optics

    @property
    def camera(self) -> slice:
        """Places of `Optics.camera_parameters` among the p parameters."""
        modes = self.state.waves.size
        return slice(modes, modes + self.optics.camera_parameters.size)

    def newton(self, precision: Floats) -> tuple[Floats, Floats]:
        """Return Newton's step to the optimum, (p,), and the covariance there, (p, p).

        Parameters
        ----------
        precision : (camera,) inverse variances of the camera parameters' prior
        """
        covariance = inverse(self.stiffened(self.information, precision))
        return covariance @ self.gradient, covariance

    def stiffened(self, information: Floats, precision: Floats) -> Floats:
        """Return an information (p, p) with a prior on the camera parameters, by its inverse variances (camera,)."""
        at = np.arange(self.camera.start, self.camera.stop)
        stiffened = information.copy()
        stiffened[at, at] += precision
        return stiffened

    @cached_property
    def _optimum(self) -> tuple[Floats, Floats]:
        """Newton's step and the covariance at the optimum, without a prior on the f-number."""
        return self.newton(self.optics.camera_stds**-2)

    @cached_property
    def _scattered(self) -> tuple[Floats, Floats]:
        return scattered(self.problem, self.state, self.evaluations)

    @property
    def objective(self) -> float:
        """Log-likelihood at the state."""
        return self.problem.objective(self.state, [e.mean for e in self.evaluations])

    def moved(self, step: Floats) -> State:
        """Return the state after a step (p,). Behind a cat's eye the wavefront moves with the clear part."""
        straight = self.state.moved(np.delete(step, self.camera))
        if self.optics.rim.is_full:
            return straight
        return carried(self.state, straight, self.optics, step[self.camera])

    def optics_after(self, step: Floats) -> Optics:
        """Return the optics after a step (p,)."""
        return self.optics.with_camera_parameters(
            self.optics.camera_parameters + step[self.camera]
        )

    def sane_after(self, step: Floats, start: State) -> bool:
        """Return whether a step (p,) leads to a state worth drawing, with camera parts that a camera may have.

        Parts are bounded one by one: an obstruction may still cover all that a cat's eye leaves clear.
        """
        optics = self.optics_after(step)
        parts = optics.camera_parameters[:-1]
        usual = np.all(np.abs(parts) < SETTINGS.unknown * self.optics.camera_stds[:-1])
        return bool(usual) and optics.rim.area > 0 and sane(self.moved(step), start)

    def within(self, step: Floats, covariance: Floats) -> Floats:
        """Return a step (p,) that stays within the bounds of the camera parameters.

        Parameters beyond a bound stop there; all others move to their likeliest values, by the covariance (p, p) at the
        optimum.
        """
        beyond = self.optics_after(step).camera_parameters - (
            self.optics.camera_parameters + step[self.camera]
        )
        at = self.camera.start + np.flatnonzero(
            np.abs(beyond) > SETTINGS.exact * self.optics.camera_stds
        )
        held = np.linalg.solve(covariance[np.ix_(at, at)], beyond[at - self.camera.start])
        return step + covariance[:, at] @ held

    def foreseen(self, step: Floats) -> list[Floats]:
        """Predict the relative image (pixels,) of each frame after a short step (p,), to first order."""
        return self.problem.foreseen(self.state, step, self.evaluations)

    def with_parts(self, names: Collection[str]) -> Expansion:
        """Add parts and modes behind the present ones. Their numbers are 0, so images and other derivatives stay valid."""
        optics, have = self.optics.with_parts(names), self.optics.parts
        modes, state = self.state.waves.size, with_modes(self.state, self.optics, optics)
        problem = replace(self.problem, model=self.problem.model.with_optics(optics))
        used, drawing = [frame.used for frame in problem.frames], problem.draw(state)
        more = problem.model.by_parts(state.waves, drawing, used, first=len(have))
        higher = problem.model.by_modes(state.waves, drawing, used, first=modes)
        behind = modes + sum(len(part.labels) for part in have)
        places = [modes] * (state.waves.size - modes) + [behind] * len(more[0])
        evaluations = [
            replace(each, by_waves=np.insert(each.by_waves, places, [*of, *rows], axis=0))
            for each, of, rows in zip(self.evaluations, higher, more, strict=True)
        ]
        return _expansion(problem, state, evaluations)

    def measured(self) -> Measured:
        """Return the Gaussian of modes, camera parameters and scale."""
        step, covariance = self._optimum
        pulled = self.projection @ covariance
        flats, _ = self._scattered
        at = self.camera.stop + np.arange(POSE_SIZE)
        pose = self.moved(step).poses[0]
        return Measured(
            self.optics.noll,
            self.values + self.projection @ self.within(step, covariance),
            pulled @ self.projection.T,
            pulled @ flats @ pulled.T,
            _foreshortening(pose, covariance[np.ix_(at, at)]),
            self.optics.camera_labels,
            pose.log_stretch(),
        )

    def sandwich(self, measured: Measured) -> Measured:
        """Return a measurement with the larger errors that hold if residuals are not noise alone.

        The covariance of the optimum grows to the sandwich's in every direction in which the sandwich's is larger: H. White,
        Econometrica 50, 1 (1982).
        """
        values, vectors = np.linalg.eigh(self._optimum[1])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        _, scattered = self._scattered
        beyond, along = np.linalg.eigh(root.T @ (scattered - self.information) @ root)
        grown = self.projection @ root @ along * np.sqrt(np.maximum(beyond, 0.0))
        model = grown @ grown.T
        return replace(measured, covariance=measured.covariance + model, model=model)

    def ridge(self, step: Floats) -> Ridge:
        """Return the ridge of the likelihood about the state after a step (p,) to an optimum."""
        pulled = self.projection @ self._optimum[1]
        slopes = inverse(pulled @ self.projection.T) @ pulled
        return Ridge(self.values + self.projection @ step, slopes)


def free_f_number(
    problem: Problem, start: Start, f_number_std: float, modes: Prior | None = None
) -> Freed:
    """Climb to a nearby optimum over all parameters, working f-number and camera parts included.

    Steps are Newton's as long as they lead up, and Marquardt's after a step that led down. The first step uses rough slopes,
    later steps use exact ones. The image after the last step is predicted from the slopes, not drawn.

    Parameters
    ----------
    problem : frames and their model
    start : where to begin
    f_number_std : relative standard error of the f-number in the problem's optics. Numbers of the camera parts have a prior
        about 0, as wide as cameras vary.
    modes : prior of the modes; measurement and likelihood of the end are without it
    """
    problem, start = wide_enough(problem, start)
    prior, state = camera_prior(problem.model.optics, f_number_std), start.state
    end, steps, converged = climb(
        Opened(problem, problem.drawn(state), state, *prior, modes, exact=False),
        tolerance=SETTINGS.settled_stds,
        max_steps=SETTINGS.most_steps,
        damping=0.0,
        least=SETTINGS.least_damping,
    )
    return end.freed(steps, converged)


@dataclass(eq=False)
class Opened(Position):
    """A position of a climb over all parameters.

    Attributes
    ----------
    problem : frames and their model, with the optics of the position
    at : the state; its drawing is kept until the slopes are known
    first : state where the climb began
    given, precision : (camera,) mean and inverse variance of the camera parameters' prior
    modes : their prior
    exact : whether slopes cover the whole pass band
    last : start of the last step and the step (p,), if the position was predicted from slopes
    """

    problem: Problem
    at: Start
    first: State
    given: Floats
    precision: Floats
    modes: Prior | None = None
    exact: bool = True
    last: tuple[Opened, Floats] | None = None

    @cached_property
    def objective(self) -> float:
        """Log-likelihood of frames, noise calibration, camera and modes; -inf at implausible positions."""
        if not self.at.relative:
            return -np.inf
        lost = 0.5 * float(self.precision @ self._away**2)
        if self.modes:
            lost += self.modes.loss(self.at.state.waves)
        return self.problem.objective(self.at.state, self.at.relative) - lost

    @property
    def _away(self) -> Floats:
        """Distance (camera,) of the camera parameters from their prior's mean."""
        return self.problem.model.optics.camera_parameters - self.given

    @cached_property
    def expansion(self) -> Expansion:
        """The likelihood about the position."""
        expansion = expand(self.problem, self.at, exact=self.exact)
        self.at = self.at.undrawn()
        return expansion

    def step(self, damping: float) -> Step:
        expansion = self.expansion
        gradient, information = expansion.uphill
        information = expansion.stiffened(information, self.precision)
        gradient = gradient.copy()
        gradient[expansion.camera] -= self.precision * self._away
        if self.modes:
            waves = self.at.state.waves
            gradient, information = self.modes.joined(gradient, information, waves)
        damped = information + np.diag(damping * np.diag(information))
        covariance = inverse(damped)
        change = expansion.within(covariance @ gradient, covariance)
        square = float(change @ information @ change)
        return Step(change, square**0.5, float(change @ gradient) - square / 2)

    def moved(self, change: Floats) -> Opened:
        expansion = self.expansion
        widened = abs(change[expansion.camera.stop - 1]) > 3 * SETTINGS.loose
        if widened or not expansion.sane_after(change, self.first):
            # not even the state: a pupil without a clear part has no centre
            return replace(self, at=Start(self.at.state))
        state, optics = expansion.moved(change), expansion.optics_after(change)
        model = with_optics_about(self.problem.model, optics, expansion.state)
        problem = replace(self.problem, model=model)
        return replace(self, problem=problem, at=problem.drawn(state), exact=True)

    def foreseen(self, change: Floats) -> Opened | None:
        if not (self.exact and self.expansion.sane_after(change, self.first)):
            return None
        images = self.expansion.foreseen(change)
        start = Start(self.expansion.moved(change), None, images)
        return replace(self, at=start, last=(self, change))

    def freed(self, steps: int, converged: bool) -> Freed:
        """Summarise the position as the end of a climb."""
        begun, step = self.last or (self, np.zeros_like(self.expansion.gradient))
        expansion, modes = begun.expansion, self.at.state.waves.size
        _, covariance = expansion.newton(self.precision)
        measured, relative = expansion.measured(), self.at.relative
        others = np.delete(np.arange(len(step)), expansion.camera)
        solution = Solution(
            self.at.state,
            self.problem.objective(self.at.state, relative),
            expansion.information[np.ix_(others, others)],
            relative,
            self.problem.chi2_per_pixel(self.at.state, relative),
            steps,
            converged,
        )
        return Freed(
            expansion,
            solution,
            expansion.optics_after(step),
            covariance[:modes, :modes],
            measured,
            expansion.sandwich(measured),
            expansion.ridge(step),
        )


def camera_prior(optics: Optics, f_number_std: float) -> tuple[Floats, Floats]:
    """Return mean and inverse variance of the camera parameters' prior, (camera,) each."""
    given, stds = np.zeros_like(optics.camera_parameters), optics.camera_stds
    given[-1], stds[-1] = optics.camera_parameters[-1], max(f_number_std, SETTINGS.exact)
    return given, stds**-2


def with_modes(state: State, optics: Optics, other: Optics) -> State:
    """Return the state with the modes of other optics; new modes are 0."""
    waves = dict(zip(optics.noll, state.waves, strict=True))
    return replace(state, waves=np.array([waves.get(j, 0.0) for j in other.noll]))


def with_optics_about(model: ForwardModel, optics: Optics, state: State) -> ForwardModel:
    """Return the model with other optics; rebuild it about a state if its sampling leaves too little margin for the cone."""
    try:
        return model.with_optics(optics)
    except ValueError:
        return model.rebuilt(
            optics,
            state.poses[0],
            waves=state.waves,
            f_number_margin=SETTINGS.f_number_margin,
        )


def wide_enough(problem: Problem, start: Start) -> tuple[Problem, Start]:
    """Widen the model's PSF window where the start's wavefront spreads light beyond it."""
    model, state = problem.model, start.state
    if model.window_airy >= SETTINGS.narrow_window * model.optics.window_airy(state.waves):
        return problem, start
    wider = model.rebuilt(
        model.optics,
        state.poses[0],
        waves=state.waves,
        f_number_margin=SETTINGS.f_number_margin,
    )
    return replace(problem, model=wider), Start(state)


def expand(problem: Problem, start: Start, *, exact: bool = True) -> Expansion:
    """Expand the log-likelihood about a state, over the camera parameters too.

    Parameters
    ----------
    problem : frames and their model
    start : the state, with its drawing and images if they are at hand
    exact : whether derivatives cover the whole pass band, see `ForwardModel.evaluate`
    """
    state, used = start.state, [f.used for f in problem.frames]
    drawing = start.drawing or problem.draw(state)
    return _expansion(
        problem,
        state,
        problem.model.evaluate(
            state.waves, drawing, used, by_camera=True, exact=exact, means=start.relative
        ),
    )


def _expansion(
    problem: Problem, state: State, evaluations: Sequence[Evaluation]
) -> Expansion:
    """Expand from derivatives by modes, camera parameters and pose."""
    shining = [
        replace(e, by_waves=np.concatenate([e.by_waves, e.by_brightness]))
        for e in evaluations
        if len(e.by_brightness)
    ]
    gradient, information, _ = problem.assembled(state, shining or evaluations)
    first = len(evaluations[0].by_waves)
    light = np.arange(first, first + len(evaluations[0].by_brightness))
    rest = np.delete(np.arange(len(gradient)), light)
    uphill = gradient[rest], information[np.ix_(rest, rest)]
    across = information[np.ix_(light, rest)]
    known = np.linalg.solve(
        information[np.ix_(light, light)] + np.eye(len(light)),
        np.column_stack([gradient[light], across]),
    )
    values, projection = _projection(problem, state, len(rest))
    return Expansion(
        problem,
        state,
        uphill[0] - across.T @ known[:, 0],
        uphill[1] - across.T @ known[:, 1:],
        uphill,
        values,
        projection,
        tuple(evaluations),
    )


def _foreshortening(pose: Pose, covariance: Floats) -> tuple[float, float]:
    """Return mean and standard deviation of ln of the foreshortening, over poses drawn from a covariance (8, 8).

    Where frames hardly determine the direction of the target's tilt, the foreshortening is far from linear in the pose.
    """
    root = scipy.linalg.sqrtm(covariance).real
    steps = np.random.default_rng(0).normal(size=(SETTINGS.tilt_draws, POSE_SIZE)) @ root
    values = pose.log_foreshortenings(steps)
    return float(np.mean(values)), float(np.std(values))


def _projection(problem: Problem, state: State, size: int) -> tuple[Floats, Floats]:
    """Return the measured values (m,), the scale averaged over frames, and their derivatives (m, size) by all parameters."""
    camera, frames = problem.model.optics.camera_parameters, len(state.poses)
    first = state.waves.size + camera.size
    projection = np.zeros((first + 1, size))
    projection[:first, :first] = np.eye(first)
    scales = []
    for k, pose in enumerate(state.poses):
        scale, slope = pose.log_scale()
        scales.append(scale)
        at = first + k * PER_FRAME
        projection[-1, at : at + POSE_SIZE] = slope / frames
    pitch_mm = problem.model.scene.torus.pitch_um * 1e-3
    return np.concatenate(
        [state.waves, camera, [np.mean(scales) + np.log(pitch_mm)]]
    ), projection
