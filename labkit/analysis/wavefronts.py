"""Observations to local fits: each range and channel by itself, doubtful ones again from their neighbours, twins chosen."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.focus import choose_signs
from labkit.analysis.observe import Observation
from labkit.execute import run_all
from labkit.imaging.model import Optics
from labkit.inference.fit import WavefrontFit, canonical, fit_wavefront, residuals
from labkit.optics.lens import ThinLens
from labkit.optics.zernike import is_even
from labkit.plan import Plan
from labkit.results import OptimumTest, OtherOptimum, Placement, Residuals, Wavefront
from labkit.target import Target
from labkit.types import Floats, Progress

NEAR_FOCUS_WAVES = 0.2  # RMS
NEAR_STARTS_WAVES = (0.01, 0.06, 0.12)
SEED = 1  # of the further starts: a session fitted twice gives the same results


@dataclass(frozen=True)
class Task:
    """One fit, as it travels to a worker."""

    optics: Optics
    target: Target
    observation: Observation
    starts: tuple[Floats, ...] = ()

    @property
    def label(self) -> str:
        where = "" if self.observation.range_mm is None else f" at {self.observation.range_mm:g} mm"
        return f"{self.observation.channel}{where}"


@dataclass(frozen=True)
class LocalFit:
    """An observation and the fit to it."""

    task: Task
    fit: WavefrontFit

    @property
    def range_mm(self) -> float | None:
        """Where the rail was read to stand; what the plan says where it was not read."""
        return self.task.observation.measured_range_mm

    @property
    def channel(self) -> str:
        return self.task.observation.channel

    @property
    def defocus(self) -> float:
        """Waves RMS; infinite where it was not fitted."""
        return float(self.fit.waves[0]) if self.fit.noll[0] == 4 else np.inf


def estimate(
    observations: Sequence[Observation], plan: Plan, target: Target, workers: int, progress: Progress
) -> tuple[Wavefront, ...]:
    """The wavefront of each observation."""
    tasks = [Task(optics_of(plan, observation.channel), target, observation) for observation in observations]
    return tuple(as_wavefront(local) for local in choose_twins(fit_all(tasks, workers, progress), plan))


def fit_task(task: Task) -> WavefrontFit:
    """Do one fit."""
    observation = task.observation
    return fit_wavefront(
        task.optics,
        task.target,
        observation.frames,
        observation.poses,
        observation.noise,
        rng=np.random.default_rng(SEED),
        starts=task.starts,
    )


def optics_of(plan: Plan, channel: str) -> Optics:
    """Lens, light and sensor of a plan's channel."""
    wavelength_nm = next(c.wavelength_nm for c in plan.channel if c.name == channel)
    first, last = plan.fit.zernike_noll
    return Optics(
        wavelength_um=wavelength_nm * 1e-3,
        reference_um=plan.reference_wavelength_nm * 1e-3,
        f_number=plan.lens.f_number,
        pitch_um=plan.sensor.pixel_pitch_um,
        active_um=plan.sensor.active_um,
        noll=tuple(range(first, last + 1)),
    )


def fit_all(tasks: Sequence[Task], workers: int, progress: Progress) -> list[LocalFit]:
    """All fits; doubtful ones are made again with their neighbours' wavefronts to start from, the likelier is kept.

    Near best focus wrong optima lie close by and leave little behind, while a defocused neighbour of the same lens, whose
    other modes are the same, is estimated without doubt.
    """
    fits: dict[int, LocalFit] = {}
    progress(0, len(tasks), "fitting")
    for index, fit in run_all(fit_task, tasks, workers):
        fits[index] = LocalFit(tasks[index], fit)
        progress(len(fits), len(tasks), tasks[index].label)
    doubtful = [i for i, f in sorted(fits.items()) if not f.fit.verdict.accepted or abs(f.defocus) < NEAR_FOCUS_WAVES]
    again = {i: replace(tasks[i], starts=tuple(_neighbours(fits[i], fits.values()))) for i in doubtful}
    again = {i: task for i, task in again.items() if task.starts}
    for place, fit in run_all(fit_task, list(again.values()), workers):
        index = list(again)[place]
        progress(len(fits), len(tasks), f"{tasks[index].label} again")
        if fit.objective > fits[index].fit.objective:
            fits[index] = LocalFit(tasks[index], fit)
    return [fits[i] for i in range(len(tasks))]


def _neighbours(doubtful: LocalFit, fits: Iterable[LocalFit]) -> Iterable[Floats]:
    """The best-determined wavefront of the same channel, at several values of defocus around none and the fit's own."""
    settled = [
        local
        for local in fits
        if local.channel == doubtful.channel and local.fit.verdict.accepted and abs(local.defocus) >= NEAR_FOCUS_WAVES
    ]
    if not settled or settled[0].defocus == np.inf:
        return
    best = min(settled, key=lambda local: float(np.linalg.norm(local.fit.std)))
    for defocus in (abs(doubtful.defocus), *NEAR_STARTS_WAVES):
        for sign in (1.0, -1.0):
            waves = best.fit.waves.copy()
            waves[0] = sign * defocus
            yield waves


def choose_twins(local_fits: Sequence[LocalFit], plan: Plan) -> list[LocalFit]:
    """Of each twin the right one: by the range series of its channel where there is one, else by the stated rule."""
    series = defaultdict(list)
    for index, local in enumerate(local_fits):
        if local.range_mm is not None and 4 in local.fit.noll:
            series[local.channel].append(index)
    chosen = [replace(local, fit=canonical(local.fit)) for local in local_fits]
    for indices in series.values():
        members = [chosen[i] for i in indices]
        if len({local.range_mm for local in members}) < 2:
            continue
        for i, sign in zip(indices, _signs(members, plan), strict=True):
            if sign < 0:
                chosen[i] = replace(chosen[i], fit=chosen[i].fit.twin())
    return chosen


def _signs(members: Sequence[LocalFit], plan: Plan) -> list[int]:
    """+1 for the fits of one channel that are the right twin, -1 for those that are not."""
    fits = [local.fit for local in members]
    return choose_signs(
        [local.range_mm for local in members if local.range_mm is not None],
        [fit.waves[0] for fit in fits],
        [fit.std[0] for fit in fits],
        {j: [fit.waves[k] for fit in fits] for k, j in enumerate(fits[0].noll) if is_even(j) and j != 4},
        ThinLens(plan.lens.focal_length_mm, plan.lens.f_number),
        plan.reference_wavelength_nm,
        plan.fit.convention,
    )


def as_wavefront(local: LocalFit) -> Wavefront:
    """A local fit as results keep it."""
    optics, observation, fit = local.task.optics, local.task.observation, local.fit
    poses = [pose.shifted(*(-float(at) for at in observation.origin_px)) for pose in fit.state.poses]
    verdict = fit.verdict
    return Wavefront(
        range_mm=observation.range_mm,
        measured_range_mm=observation.measured_range_mm,
        channel=observation.channel,
        wavelength_nm=round(optics.wavelength_um * 1e3, 6),
        reference_wavelength_nm=round(optics.reference_um * 1e3, 6),
        f_number=optics.f_number,
        noll=fit.noll,
        waves=fit.waves,
        covariance=fit.covariance,
        poses=np.array([pose.v for pose in fit.state.poses]),
        gain=float(fit.state.gain),
        read_noise=float(fit.state.read_noise),
        chi2_per_pixel=float(fit.chi2_per_pixel),
        test=OptimumTest(
            verdict.name,
            bool(verdict.accepted),
            float(verdict.p_value),
            fit.starts,
            tuple(verdict.undetermined),
            tuple(OtherOptimum(other.waves, other.below) for other in fit.others),
        ),
        seconds=fit.seconds,
        frames=observation.names,
        placement=Placement(observation.origin_px, observation.shape, np.array([pose.corners_px() for pose in poses])),
        residuals=_residuals(local),
    )


def _residuals(local: LocalFit) -> Residuals:
    """Counts, model and noise of each Bayer plane of each frame; nan where a pixel was not used."""
    observation = local.task.observation
    planes = []
    for frame, (mean, std) in zip(observation.frames, residuals(local.fit, observation.frames), strict=True):
        images = np.full((3, *frame.counts.shape), np.nan)
        images[:, frame.used] = frame.counts[frame.used], mean, std
        every = observation.period
        planes.append([images[:, row::every, column::every] for row, column in observation.places])
    data, model, sigma = np.moveaxis(np.array(planes), 2, 0)
    return Residuals(data, model, sigma)
