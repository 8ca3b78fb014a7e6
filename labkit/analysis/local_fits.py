"""One observation's fit: what travels to a worker, what is done there, and what comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.lens_model import Member
from labkit.analysis.observe import Observation
from labkit.execute import say
from labkit.imaging.aperture import Aperture
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, Part
from labkit.imaging.window import WINDOW_AIRY
from labkit.inference.cone import Measured
from labkit.inference.fisher_scoring import Problem, State
from labkit.inference.fit import WavefrontFit, fit_wavefront
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.target import Target
from labkit.types import Floats
from labkit.uncertain import Uncertain

SEED = 1  # of the further starts: a session fitted twice gives the same results
PATIENCE_S = 120.0
SHARED_CONE_STD = 0.01  # of a cone that other frames of the session measured


@dataclass(frozen=True)
class Task:
    """One fit, as it travels to a worker. f_number_std: relative; starts, alike, missing, asked, alone: as `fit_wavefront`
    takes them."""

    optics: Optics
    target: Target
    observation: Observation
    f_number_std: float = 0.0
    starts: tuple[Floats, ...] = ()
    alike: tuple[Floats, ...] = ()
    patience_s: float = PATIENCE_S
    missing: tuple[Part, ...] = ()
    asked: bool = False
    alone: bool = False

    @property
    def ranged(self) -> bool:
        """Whether it bears on the lens: its range is known, and defocus is fitted."""
        return self.observation.measured_range_mm is not None and 4 in self.optics.noll

    def as_member(self, measured: Measured) -> Member:
        """Of a session, with what was measured. Its range is where the rail was read to stand, or what the plan says."""
        o = self.observation
        assert o.measured_range_mm is not None
        stop = o.measured_range_mm if o.range_mm is None else o.range_mm
        return Member(o.channel, o.measured_range_mm, stop, measured, o.homings)

    def starting_at(self, predicted: Floats) -> Task:
        """The same, begun at a prediction, as of `Measured`."""
        modes = len(self.optics.noll)
        optics = self.optics.shaped(predicted[modes:-1])  # as of `Optics.shape`
        return replace(self, optics=optics, f_number_std=SHARED_CONE_STD, starts=(predicted[:modes],), alike=())

    @property
    def label(self) -> str:
        """Channel and range."""
        return self.observation.key.label


@dataclass(frozen=True)
class LocalFit:
    """An observation and the fit to it."""

    task: Task
    fit: WavefrontFit

    @property
    def channel(self) -> str:
        """Of the observation."""
        return self.task.observation.channel

    @property
    def ranged(self) -> bool:
        """Whether it bears on the lens."""
        return self.task.ranged

    @property
    def unexplained(self) -> float:
        """Log-likelihood that the residuals lack of those of noise alone, about."""
        pixels = sum(image.size for image in self.fit.relative)
        return 0.5 * max(self.fit.chi2_per_pixel - 1, 0.0) * pixels

    @property
    def member(self) -> Member:
        """Of a session, with the errors of noise alone."""
        return self.task.as_member(self.fit.measured)

    @property
    def honest_member(self) -> Member:
        """With errors that hold the model's, where it does not explain the frames."""
        fit = self.fit
        return self.task.as_member(fit.measured if fit.verdict.accepted else fit.poor)


def fit_task(task: Task) -> WavefrontFit:
    """Do one fit."""
    observation = task.observation
    return fit_wavefront(
        task.optics,
        task.target,
        observation.frames,
        observation.poses,
        observation.noise,
        f_number_std=task.f_number_std,
        rng=np.random.default_rng(SEED),
        starts=task.starts,
        alike=task.alike,
        patience_s=task.patience_s,
        missing=task.missing,
        asked=task.asked,
        alone=task.alone,
        progress=lambda step: say(f"{task.label}: {step}"),
    )


def optics_of(plan: Plan, channel: str) -> Optics:
    """Light, sensor and lens of a plan's channel, the cone as engraved."""
    light = next(c for c in plan.channel if c.name == channel)
    first, last = plan.fit.zernike_noll
    stated = [found for part in KNOWN.values() if (found := part.stated(plan, light)) is not None]
    return Optics(
        wavelength_um=light.wavelength_nm * 1e-3,
        reference_um=plan.reference_wavelength_nm * 1e-3,
        f_number=plan.lens.f_number,
        pitch_um=plan.sensor.pixel_pitch_um,
        active_um=plan.sensor.active_um,
        noll=tuple(range(first, last + 1)),
        spectrum=None if light.spectrum is None else Spectrum.of_samples(*light.samples, light.wavelength_nm),
        parts=tuple(part for part, fitted in stated if fitted),
        given=tuple(part for part, fitted in stated if not fitted),
        panel=Aperture.wanted(plan),
    )


def wanted_parts(plan: Plan) -> list[str]:
    """Return the names of the parts that a plan wants fitted, in any channel."""
    return list(dict.fromkeys(part.name for c in plan.channel for part in optics_of(plan, c.name).parts))


def engraved_cone(plan: Plan, ranges_mm: Sequence[float]) -> Uncertain:
    """The f-number at the sensor, by the engraving, of a lens focused among some ranges; in its error what the pupils make of
    it, as long as their magnification is not known."""
    lens, stated = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number), plan.lens.stated_f_number
    cone = float(lens.working_f_number(float(np.mean(ranges_mm)))) if ranges_mm else lens.f_number
    pupils = (cone / lens.f_number - 1) * USUAL_LOG_MAGNIFICATION
    return Uncertain(cone, cone * float(np.hypot(stated.std / lens.f_number, pupils)))


def problem_at(task: Task, optics: Optics, state: State) -> Problem:
    """A task's frames and a model of them about a state, of optics that a fit ended with."""
    observation = task.observation
    model = ForwardModel.build(
        optics,
        task.target,
        observation.shape,
        state.poses[0],
        window_airy=max(WINDOW_AIRY, optics.window_airy(state.waves)),
        shine=observation.frames[0].shine,
    )
    return Problem(model, observation.frames, observation.noise)


def most_like(observation: Observation, fits: Sequence[LocalFit]) -> LocalFit | None:
    """Of fits the one most like an observation: of its channel, of its range."""

    def unlike(fit: LocalFit) -> tuple[bool, float]:
        there, here = fit.task.observation.measured_range_mm, observation.measured_range_mm
        return fit.channel != observation.channel, abs((there or 0.0) - (here or 0.0))

    return min(fits, key=unlike, default=None)
