"""A session to its results: flat field, target found, wavefronts fitted, signs chosen, focus fitted, all written."""

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.focus import LEAST, MOST, DefocusPoint, FocusFit, choose_signs, fit_focus
from labkit.analysis.observe import Observation, observe
from labkit.analysis.results import Plane, Results, Wavefront
from labkit.errors import DataError, SessionError
from labkit.execute import default_workers, run_all
from labkit.imaging.model import Optics
from labkit.inference.fit import WavefrontFit, canonical, fit_wavefront, residuals
from labkit.optics.lens import ThinLens
from labkit.optics.zernike import is_even
from labkit.plan import Plan
from labkit.session.session import Session
from labkit.session.verify import altered
from labkit.target import Target, open_target
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


def fit_session(
    session: Session,
    *,
    range_mm: float | None = None,
    channel: str | None = None,
    workers: int | None = None,
    progress: Progress = lambda done, total, step: None,
    name: str = "latest",
) -> Results:
    """Fit every wavefront of a session and the focus over them, and write SESSION/results/NAME.

    range_mm, channel: only these. workers: processes, by default one a processor. Raises SessionError for photographs
    that are missing or were altered, DataError for frames that cannot be fitted, TargetError for a target that is not in
    a frame. Too few ranges for a focus are no error here: `Results.unanswered` says so.
    """
    plan = session.plan
    if damage := altered(session):
        raise SessionError("; ".join(damage))
    target = open_target(plan.target)
    folder = session.results_folder(name)  # before the work, in case it cannot be written to
    observations, warnings = observe(session, plan, target, range_mm=range_mm, channel=channel, progress=progress)
    tasks = [Task(_optics(plan, o.channel), target, o) for o in observations]
    wavefronts = _fit_all(tasks, workers or default_workers(), progress)
    wavefronts = _signed(wavefronts, plan)
    focus, words = _focus(wavefronts, plan)
    wanted = range_mm is None and any(w.range_mm is not None and 4 in w.fit.noll for w in wavefronts)
    results = Results(
        hashlib.sha256((session.folder / "plan.toml").read_bytes()).hexdigest(),
        plan.reference_wavelength_nm,
        plan.fit.convention,
        tuple(wavefronts),
        focus,
        (*session.warnings, *warnings, *words, *_doubts(wavefronts)),
        "; ".join(words) if wanted and focus is None else None,
    )
    results.write(folder)
    return results


def fit_task(task: Task) -> WavefrontFit:
    """Do one fit."""
    seen = task.observation
    return fit_wavefront(
        task.optics,
        task.target,
        seen.frames,
        seen.poses,
        seen.noise,
        rng=np.random.default_rng(SEED),
        starts=task.starts,
    )


def _optics(plan: Plan, channel: str) -> Optics:
    wavelength_nm = next(c.wavelength_nm for c in plan.channel if c.name == channel)
    first, last = plan.fit.zernike_noll
    return Optics(
        wavelength_nm * 1e-3,
        plan.reference_wavelength_nm * 1e-3,
        plan.lens.f_number,
        plan.sensor.pixel_pitch_um,
        plan.sensor.active_um,
        tuple(range(first, last + 1)),
    )


def _fit_all(tasks: Sequence[Task], workers: int, progress: Progress) -> list[Wavefront]:
    """All fits; doubtful ones are made again with their neighbours' wavefronts to start from, the likelier is kept.

    Near best focus wrong optima lie close by and leave little behind, while a defocused neighbour of the same lens, whose
    other modes are the same, is told without doubt.
    """
    fits: dict[int, WavefrontFit] = {}
    progress(0, len(tasks), "fitting")
    for index, fit in run_all(fit_task, tasks, workers):
        fits[index] = fit
        progress(len(fits), len(tasks), tasks[index].label)
    doubtful = [i for i, f in sorted(fits.items()) if not f.verdict.accepted or abs(_defocus(f)) < NEAR_FOCUS_WAVES]
    again = {i: replace(tasks[i], starts=tuple(_neighbours(i, tasks, fits))) for i in doubtful}
    again = {i: task for i, task in again.items() if task.starts}
    for place, fit in run_all(fit_task, list(again.values()), workers):
        index = list(again)[place]
        progress(len(fits), len(tasks), f"{tasks[index].label} again")
        if fit.objective > fits[index].objective:
            fits[index] = fit
    return [_wavefront(task, fits[i]) for i, task in enumerate(tasks)]


def _defocus(fit: WavefrontFit) -> float:
    return float(fit.waves[0]) if fit.noll[0] == 4 else np.inf


def _neighbours(index: int, tasks: Sequence[Task], fits: dict[int, WavefrontFit]) -> Iterable[Floats]:
    """The wavefront of the same channel that is told best, at several values of defocus around none and this fit's own."""
    channel = tasks[index].observation.channel
    told = [
        fit
        for other, fit in fits.items()
        if tasks[other].observation.channel == channel
        and fit.verdict.accepted
        and abs(_defocus(fit)) >= NEAR_FOCUS_WAVES
    ]
    if not told or _defocus(told[0]) == np.inf:
        return
    best = min(told, key=lambda fit: float(np.linalg.norm(fit.std)))
    own = abs(float(fits[index].waves[0]))
    for defocus in (own, *NEAR_STARTS_WAVES):
        for sign in (1.0, -1.0):
            waves = best.waves.copy()
            waves[0] = sign * defocus
            yield waves


def _wavefront(task: Task, fit: WavefrontFit) -> Wavefront:
    seen = task.observation
    planes = []
    for frame, (mean, std) in zip(seen.frames, residuals(fit, seen.frames), strict=True):
        data, model, sigma = (np.full(frame.counts.shape, np.nan) for _ in range(3))
        data[frame.used], model[frame.used], sigma[frame.used] = frame.counts[frame.used], mean, std
        every = seen.period
        planes.append(
            tuple(Plane(*(image[r::every, c::every] for image in (data, model, sigma))) for r, c in seen.places)
        )
    return Wavefront(seen.range_mm, seen.measured_range_mm, seen.channel, task.optics, fit, seen.names, tuple(planes))


def _signed(wavefronts: Sequence[Wavefront], plan: Plan) -> list[Wavefront]:
    """Of each twin the right one: by the range series of its channel where there is one, else by the stated rule."""
    series = defaultdict(list)
    for index, w in enumerate(wavefronts):
        series[w.channel].append(index)
    result = [replace(w, fit=canonical(w.fit)) for w in wavefronts]
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    for indices in series.values():
        members = [(i, result[i]) for i in indices if result[i].range_mm is not None and 4 in result[i].fit.noll]
        if len({w.range_mm for _, w in members}) < 2:
            continue
        fits = [w.fit for _, w in members]
        signs = choose_signs(
            [w.range_mm for _, w in members if w.range_mm is not None],
            [f.waves[0] for f in fits],
            [f.std[0] for f in fits],
            {j: [f.waves[k] for f in fits] for k, j in enumerate(fits[0].noll) if is_even(j) and j != 4},
            lens,
            plan.reference_wavelength_nm,
        )
        for (i, w), sign in zip(members, signs, strict=True):
            result[i] = w if sign > 0 else replace(w, fit=w.fit.twin())
    return result


def _focus(wavefronts: Sequence[Wavefront], plan: Plan) -> tuple[FocusFit | None, list[str]]:
    points = [
        DefocusPoint(w.measured_range_mm, w.channel, float(w.fit.waves[0]), float(w.fit.std[0]))
        for w in wavefronts
        if w.measured_range_mm is not None and 4 in w.fit.noll
    ]
    if not points:
        return None, [
            "no best focus: the frames carry no ranges"
            if 4 in wavefronts[0].fit.noll
            else "no best focus: defocus was not fitted"
        ]
    lens, settings = plan.lens, plan.fit
    try:
        focus = fit_focus(
            points,
            lens.focal_length_mm,
            lens.f_number,
            plan.reference_wavelength_nm,
            settings.convention,
            settings.range_std_mm,
        )
    except DataError as error:
        return None, [f"no best focus: {error}"]
    words = []
    if focus.at_limit:
        words.append(
            f"no pupil magnification from {LEAST:g} to {MOST:g} fits: defocus does not follow a lens's curve; check the "
            "ranges, the focal length, and the optima that were rejected"
        )
    elif not focus.identifiable:
        words.append(
            f"the pupil magnification cannot be told at these ranges: its standard error is {focus.std[-1]:.3f}; "
            "ranges near the closest focus would tell it"
        )
    if focus.chi2_per_freedom is not None and focus.chi2_per_freedom > 4:
        words.append(
            f"defocus departs from the lens's curve by {np.sqrt(focus.chi2_per_freedom):.1f} times its standard "
            "errors; "
            "those of best focus and pupil magnification were widened by as much"
        )
    return focus, words


def _doubts(wavefronts: Sequence[Wavefront]) -> list[str]:
    doubts = []
    for w in wavefronts:
        where = f"{w.channel}" if w.range_mm is None else f"{w.channel} at {w.range_mm:g} mm"
        if w.fit.verdict.undetermined:
            doubts.append(
                f"{where}: the frames do not determine {', '.join(w.fit.verdict.undetermined)}; "
                "is the target lit, sharp and large enough?"
            )
        elif not w.fit.verdict.accepted:
            doubts.append(
                f"{where}: what is left of the data is not noise alone (p = {w.fit.verdict.p_value:.1g}); "
                "the optimum may be a wrong one, or the model lacks something"
            )
        if not 0.9 <= w.fit.chi2_per_pixel <= 1.5:
            doubts.append(f"{where}: chi2 per pixel is {w.fit.chi2_per_pixel:.2f}, expected is 0.9 to 1.5")
    return doubts
