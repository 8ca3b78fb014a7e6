"""A climb over all frames of a session at once: a check of the two-level estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.errors import LostTasksError
from labkit.estimation.candidate import Measured, mostly_unexplained
from labkit.estimation.climb import Problem, Start, State
from labkit.estimation.estimate import Estimate
from labkit.estimation.expansion import expand
from labkit.estimation.laws import Laws
from labkit.estimation.left_out import weak_modes
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.local import Views
from labkit.estimation.ridge import Ridge
from labkit.estimation.select import lens_of
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.window import WIDEST_WINDOW, WINDOW_AIRY
from labkit.jobs.execute import Run
from labkit.jobs.sharing import Shared, share
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.target.target import Target
from labkit.types import Progress


@dataclass(frozen=True)
class Leg:
    """One member's part of a step, as a task.

    Attributes
    ----------
    views, target : the member's frames and the target
    state, optics : where the step leads
    explained : whether the model explains the member's frames
    """

    views: Shared[Views]
    target: Shared[Target]
    state: State
    optics: Optics
    explained: bool


@dataclass(frozen=True)
class Reached:
    """The end of a leg, and the likelihood about it."""

    state: State
    optics: Optics
    measured: Measured
    ridge: Ridge
    log_likelihood: float

    def stepped(self, lens: LensFit, row: int) -> tuple[State, Optics]:
        """Return the likeliest state and optics given what a lens predicts for observation `row`.

        Weak modes of the lens join the model. The lens predicts scales of a target that faces it; a member's scale is smaller
        by its target's tilt.
        """
        model, optics = lens.model, self.optics
        *others, cone, scale = lens.solved.predicted[row].tolist()
        values = dict(zip((*model.noll, *model.parts), others, strict=True))
        scale -= lens.measured.values[row, -1] - self.measured.values[-1]
        own = [values[label] for label in (*optics.noll, *optics.camera_labels)]
        step = self.ridge.step(np.array([*own, cone, scale]))
        camera = slice(len(optics.noll), len(own) + 1)
        optics = optics.with_camera_parameters(optics.camera_parameters + step[camera])
        weak = model.weak.keys() - {*optics.noll}
        optics = optics.with_parts(
            [name for name, group in MODE_GROUPS.items() if group.first in weak]
        )
        waves = np.array([values.get(j, 0.0) for j in optics.noll])
        state = self.state.moved(np.delete(step, camera))
        return replace(state, waves=waves), optics


@dataclass(frozen=True)
class Joint:
    """The end of the joint climb.

    Attributes
    ----------
    lens : the session's parameters at the end
    differences : from the two-level estimate, in standard errors, by parameter
    log_likelihoods : of all frames, after each step
    """

    lens: LensFit
    differences: dict[str, float]
    log_likelihoods: tuple[float, ...]


def refit_jointly(
    session: Estimate,
    targets: Mapping[str, Target],
    run: Run,
    progress: Progress,
) -> Joint:
    """Climb over all parameters at once by Gauss-Newton steps, from the two-level estimate.

    The parameters of the session are few. Each frame's own parameters (pose, light, noise) affect no other frame: eliminated
    member by member, they leave the session's least squares, with each member's likelihood expanded anew about its present
    parameters.

    Parameters
    ----------
    session : the two-level estimate
    targets : the target as shown to each channel
    run : maps the legs
    progress : called with each step

    Raises
    ------
    ValueError : the session has no lens
    """
    if session.lens is None:
        raise ValueError(
            "the fits have no lens in common: there is nothing to climb together"
        )
    first = lens = session.lens
    places = _optima(session)
    likelihoods = list[float]()
    for done in range(SETTINGS.most_steps):
        progress(done, SETTINGS.most_steps, "climbing jointly")
        before = lens
        places = _all_reached(session, targets, lens, places, run)
        members = sum(one.log_likelihood for one in places)
        likelihoods.append(members - 0.5 * lens.solved.prior_chi2)
        lens = _lens_of(session, places, first)
        if max(_differences(lens, before).values()) < SETTINGS.converged_stds:
            break
    return Joint(lens, _differences(lens, first), tuple(likelihoods))


def refined(session: Estimate, targets: Mapping[str, Target], run: Run) -> Estimate:
    """Replace the lens by the lens after the joint climb's first step, where the likelihoods of single fits are no parabolas.

    In squares of a filter's spread the likelihood is less parabolic than in other parameters, and the session's spread lies
    beyond the estimates of some single fits. The valley along f-number, defocus and higher modes is curved: single fits end
    some errors away along it. Near focus the likelihood is less parabolic in all parameters if there is little light: fits
    then contradict a lens that explains all photographs together.
    """
    if session.lens is None:
        return session
    weak = weak_modes(session)
    lens = replace(session.lens, model=replace(session.lens.model, weak=weak))
    fits = [session.fits[k] for k in session.members]
    try:
        poor = mostly_unexplained(fit.optimum.verdict.accepted for fit in fits)
        if lens.contradicted and not poor:
            strict = _stepped(session, targets, _under_strict_laws(session, lens), run)
            if not strict.contradicted:
                return replace(session, lens=strict)
        if not any(fit.optics.beyond_usual for fit in fits):
            return session
        return replace(session, lens=_stepped(session, targets, lens, run))
    except LostTasksError:  # for lack of memory: the two levels' end stays
        return session


def _stepped(
    session: Estimate, targets: Mapping[str, Target], lens: LensFit, run: Run
) -> LensFit:
    """Return a lens after the joint climb's first step from it."""
    reached = _all_reached(session, targets, lens, _optima(session), run)
    return _lens_of(session, reached, lens)


def _under_strict_laws(session: Estimate, lens: LensFit) -> LensFit:
    """Return the lens of the members' optima if the plan has no mistake and nothing scatters from range to range."""
    measured = {
        session.row(k): session.fits[k].optimum.candidate.measured for k in session.members
    }
    return lens_of(measured, replace(lens, model=replace(lens.model, laws=Laws())))


def _optima(session: Estimate) -> list[Reached]:
    """Return where the two levels left the members."""
    optima = [session.fits[k].optimum for k in session.members]
    return [
        Reached(one.state, one.optics, one.measured, one.ridge, one.log_likelihood)
        for one in optima
    ]


def _all_reached(
    session: Estimate,
    targets: Mapping[str, Target],
    lens: LensFit,
    places: Sequence[Reached],
    run: Run,
) -> list[Reached]:
    """Step all members to the values that a lens predicts for them."""
    legs = []
    shown = {channel: share(target) for channel, target in targets.items()}
    for k, place in zip(session.members, places, strict=True):
        fit = session.fits[k]
        o = fit.observation
        views = share(Views(o.frames, o.poses, o.noise))
        state, optics = place.stepped(lens, session.row(k))
        explained = fit.optimum.verdict.accepted
        legs.append(Leg(views, shown[o.channel], state, optics, explained))
    done = dict(run(reach, legs))
    return [done[k] for k in range(len(legs))]


def _lens_of(session: Estimate, reached: Sequence[Reached], like: LensFit) -> LensFit:
    """Estimate the lens from the members' new measurements, under the laws of an earlier lens."""
    rows = map(session.row, session.members)
    return lens_of(
        {row: one.measured for row, one in zip(rows, reached, strict=True)}, like
    )


def reach(leg: Leg) -> Reached:
    """Expand the likelihood about the end of a step.

    Images are through the widest window: the light that a usual one loses has pulled the members' f-numbers, and made straight
    blades look rounded. Slopes, which take most of the time, are through the usual one.
    """
    relative = _problem(leg, WIDEST_WINDOW).relative(leg.state)
    problem = _problem(leg, max(WINDOW_AIRY, leg.optics.window_airy(leg.state.waves)))
    expansion = expand(problem, Start(leg.state, relative=relative))
    measured = expansion.measured()
    return Reached(
        leg.state,
        leg.optics,
        measured if leg.explained else expansion.sandwich(measured),
        expansion.ridge(np.zeros_like(expansion.gradient)),
        expansion.objective,
    )


def _problem(leg: Leg, window_airy: float) -> Problem:
    """Return a leg's frames with a model about its state, whose PSF has a window of a width, lambda N."""
    views, optics, state = leg.views.value, leg.optics, leg.state
    model = ForwardModel.build(
        optics,
        leg.target.value,
        views.frames[0].counts.shape,
        state.poses[0],
        window_airy=window_airy,
        brightness=views.frames[0].brightness,
        beside=views.frames[0].beside,
    )
    return Problem(model, views.frames, views.noise)


def _differences(one: LensFit, other: LensFit) -> dict[str, float]:
    """Return the absolute difference of every parameter, in standard errors."""
    names = [
        " ".join(map(str, (column.kind, *column.name))) for column in one.model.columns
    ]
    std = np.sqrt(np.diag(other.errors))
    return dict(zip(names, np.abs((one.theta - other.theta) / std).tolist(), strict=True))
