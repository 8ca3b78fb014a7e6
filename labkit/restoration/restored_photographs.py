"""From photographs and a session to restored scenes in a folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from labkit.analysis.measured_camera import optics_behind
from labkit.calibration.calibrate import calibrate
from labkit.calibration.needed import Needed
from labkit.errors import DataError
from labkit.jobs.execute import Workers
from labkit.key import same_range
from labkit.optics.lens import blur_per_wave_um
from labkit.plan.sensor import MONO
from labkit.restoration import output
from labkit.restoration.blind import SPAN_WAVES, fitted_defocus
from labkit.restoration.canvas import Canvas
from labkit.restoration.colours import colour_coupling
from labkit.restoration.exposures import (
    Shot,
    area_to_read,
    read_shot,
    refuse_other_camera,
)
from labkit.restoration.job import Area, Colour, Job, begun_at
from labkit.restoration.lens import nearest, waves_at
from labkit.restoration.noise import with_own_noise
from labkit.restoration.registration import refined, registered
from labkit.restoration.strength import DISCREPANCY, Choice
from labkit.restoration.tile_size import planned_tiles
from labkit.restoration.tiles import Picture, restore_job
from labkit.results import Results
from labkit.session.session import Session
from labkit.types import Floats, Floats32, Progress, no_progress

LEAST_GUARD_PX = 12
GUARD_AIRY = 24.0  # beyond the geometric blur, lambda N, for diffraction
ROUNDING = 1 / 12  # counts squared
PENALTY_RULES = 0.01  # share of samples, beyond which it is reported


@dataclass(frozen=True)
class Wanted:
    """How a scene is to be restored; None chooses.

    Attributes
    ----------
    strength : lambda, or how to choose it
    channels : only these; empty for all
    range_mm : from which the photographs were taken
    samples : for each pixel
    crop : only these rows and columns
    tile_px, memory_gb, workers : side of a tile, memory to use at most, number of processes
    fit_defocus : estimate the photograph's own defocus
    force : use the PSF though the photograph contradicts it
    method, baseline : name of a method to compare with, and its function; None for labkit's own
    sixteen_bit : write a 16-bit TIFF too
    """

    strength: float | Choice = DISCREPANCY
    channels: tuple[str, ...] = ()
    range_mm: float | None = None
    samples: int | None = None
    crop: Area | None = None
    tile_px: int | None = None
    memory_gb: float | None = None
    fit_defocus: bool = False
    force: bool = False
    method: str = "model"
    baseline: Callable[[Job], Floats32] | None = None
    sixteen_bit: bool = False
    workers: int = 1


@dataclass(frozen=True)
class Restoration:
    """The written folder, the content of restore.json, and notes."""

    folder: Path
    about: dict[str, Any]
    notes: tuple[str, ...] = ()


Say = Callable[[str], None]


def restore_images(
    images: Sequence[Path],
    results: Results,
    session: Session | None,
    out: Path,
    wanted: Wanted,
    say: Say = lambda text: None,
    progress: Progress = no_progress,
) -> Restoration:
    """Restore photographs of a scene, from a range, with a session's lens.

    Parameters
    ----------
    images : the photographs
    results, session : of the lens; the session if its photographs are available
    out : folder to make
    wanted : how
    say, progress : called with the size of the task before it begins, and with the step under way

    Raises
    ------
    RawError, DataError, InputError
    """
    output.refuse_full(out)
    shots = [read_shot(path, results.plan, wanted.crop) for path in images]
    if not wanted.force:
        for path in images:
            refuse_other_camera(path, session.frames if session else (), results.plan)
    range_mm = wanted.range_mm
    ranges = results.ranges_mm
    if range_mm is None and not wanted.fit_defocus:
        if len(ranges) > 1:
            known = ", ".join(f"{r:g}" for r in ranges if r is not None)
            raise DataError(
                f"from which range was it taken? Give --range (measured: {known} mm), or --fit-defocus"
            )
        range_mm = ranges[0]
    return _restore(shots, results, range_mm, out, wanted, say, progress)


def restore_session(
    session: Session,
    results: Results,
    range_mm: float | None,
    out: Path,
    wanted: Wanted,
    say: Say = lambda text: None,
    progress: Progress = no_progress,
) -> Restoration:
    """Restore a session's own target frames of one range. Raises DataError if there are none; see `restore_images`."""
    output.refuse_full(out)
    frames = [
        f for f in session.frames if f.kind == "target" and same_range(f.range_mm, range_mm)
    ]
    if not frames:
        known = ", ".join(f"{w.range_mm:g}" for w in results if w.range_mm is not None)
        raise DataError(
            f"{session.folder}: no target frames at {range_mm} mm: there are some at {known}"
        )
    plan = results.plan
    names = wanted.channels or results.channels
    needed = {range_mm: Needed(area_to_read(wanted.crop))}
    calibration = calibrate(session.frames, plan, needed)
    shots = [read_shot(f.path, plan, wanted.crop, names, f, calibration) for f in frames]
    return _restore(shots, results, range_mm, out, wanted, say, progress)


def _restore(
    shots: Sequence[Shot],
    results: Results,
    range_mm: float | None,
    out: Path,
    wanted: Wanted,
    say: Say,
    progress: Progress,
) -> Restoration:
    """Restore a scene and write it."""
    began = perf_counter()
    notes = list[str]()
    first = shots[0]
    names = _channels(first, results, wanted)
    job = _job(shots, _colours(first, results, names, range_mm, wanted), wanted)
    if (clipped := max(shot.clipped for shot in shots)) > 0:
        notes.append(
            f"{100 * clipped:.2g} % of the pixels are clipped: the scene is restored from what is around them"
        )
    if wanted.force:
        job = with_own_noise(job, notes)
    fitted = {}
    if wanted.fit_defocus:
        job, defocus = fitted_defocus(job, progress)
        job = replace(job, guard_px=_guard(job.colours))
        fitted = {
            "fitted_defocus_waves": defocus.waves,
            "fitted_defocus_std_waves": defocus.std,
        }
        notes += defocus.doubts
    size = planned_tiles(job, wanted.tile_px, wanted.memory_gb, wanted.workers)
    say(str(size))
    white = first.photograph.full_light
    if wanted.baseline is None:
        overlap_px = 2 * job.guard_px
        folder = output.made(out) if size.tiles > 1 else None
        canvas_in = partial(Canvas, folder=folder)
        with Workers(size.workers) as run:
            picture = restore_job(
                job, wanted.strength, size.tile_px, overlap_px, run, progress, canvas_in
            )
        canvas = picture.canvas
        more = _about(picture, notes)
    else:
        canvas = Canvas.of(wanted.baseline(job)[None])
        more = {"lambda": None, "method": wanted.method}
    about = {
        "schema": 1,
        "channels": names,
        "spacing_um": job.pitch_um / job.samples,
        "origin_px": list(first.origin),
        "range_mm": range_mm,
        "samples_per_px": job.samples,
        "defocus_waves": {c.name: c.defocus for c in job.colours},
        **fitted,
        **more,
        "seconds": round(perf_counter() - began, 2),
        "frames": len(shots),
        "white_counts": white,
        "notes": notes,
    }
    output.write(out, canvas, about, white if wanted.sixteen_bit else None)
    return Restoration(out, about, tuple(notes))


def _about(picture: Picture, notes: list[str]) -> dict[str, Any]:
    """Return the part of restore.json on the restoration itself, and note doubts."""
    unknown = picture.unknown
    rules = picture.penalty_rules
    if rules > PENALTY_RULES:
        notes.append(
            f"in {100 * rules:.0f} % of the samples the penalty rules: more than half of their error's variance is what it "
            "supposes of the scene, not noise"
        )
    if unknown > 0:
        notes.append(
            f"{100 * unknown:.2g} % of the samples have no usable count near: they are not restored (nan)"
        )
    return {
        "lambda": {
            "value": picture.strength,
            "chosen_by": picture.chosen_by,
            "stiffness": picture.stiffness,
            "roughness": picture.norm.roughness,
        },
        "chi2_per_pixel": picture.chi2_per_pixel,
        "penalty_share": picture.penalty_share,
        "penalty_rules": rules,
        "unknown": unknown,
        "tiles": picture.tiles,
    }


def _channels(shot: Shot, results: Results, wanted: Wanted) -> list[str]:
    """Return the channels, in the results' order. Raises DataError for a channel without a PSF unless it is forced."""
    names = list(wanted.channels or results.channels)
    for name in names:
        if name not in results.channels and not wanted.force:
            nearest(results, name, None)
        shot.photograph.pixels(name)  # raises for a colour that it lacks
    if shot.photograph.pattern == MONO and len(names) > 1:
        raise DataError(
            f"the photograph has one colour, the session {', '.join(names)}: say which with --channel"
        )
    return names


def _colours(
    shot: Shot,
    results: Results,
    names: Sequence[str],
    range_mm: float | None,
    wanted: Wanted,
) -> list[Colour]:
    """Return the colours with their lateral colour: displacements of the target's corners from those in the first."""
    colours = []
    corners = []
    for name in names:
        taken = name if name in results.channels else results.channels[0]
        wavefront = nearest(results, taken, range_mm)
        colours.append(
            Colour(
                name,
                shot.photograph.pixels(name).places,
                optics_behind(results, results.plan, wavefront),
                waves_at(results, wavefront, None if wanted.fit_defocus else range_mm),
                wavefront.gain,
                wavefront.read_noise**2 + ROUNDING,
            )
        )
        if taken == name and wavefront.placement is not None:
            corners.append(wavefront.placement.corners_px[0])
    if len(colours) == 1 or len(corners) < len(colours):
        return colours
    at = np.column_stack([corners[0], np.ones(len(corners[0]))])
    motions = [np.linalg.lstsq(at, own - corners[0], rcond=None)[0].T for own in corners]
    origin = np.array(shot.origin, float)
    return [
        replace(colour, motion=begun_at(np.asarray(motion), origin))
        for colour, motion in zip(colours, motions, strict=True)
    ]


def _job(shots: Sequence[Shot], colours: Sequence[Colour], wanted: Wanted) -> Job:
    """Return the job, its photographs registered."""
    exposures = [shot.exposure for shot in shots]
    period = shots[0].period
    first, *others = exposures
    if any(other.counts.shape != first.counts.shape for other in others):
        raise DataError("the photographs differ in size: restore them apart")
    moved = [replace(o, motion=registered(first, o, period)) for o in others]
    guard_px = _guard(colours, SPAN_WAVES if wanted.fit_defocus else 0.0)
    coupling: Floats = np.eye(len(colours))
    job = Job((first, *moved), tuple(colours), period, 1, guard_px, coupling)
    job = job.of_samples(wanted.samples or job.nyquist_samples)
    return refined(replace(job, coupling=colour_coupling(job)) if len(colours) > 1 else job)


def _guard(colours: Sequence[Colour], least_waves: float = 0.0) -> int:
    """Return the distance in pixels from which light reaches a pixel, without the halo's last share."""
    reach = 0.0
    for colour in colours:
        optics = colour.optics
        waves = max(float(np.linalg.norm(colour.waves)), least_waves)
        blur_um = waves * blur_per_wave_um(optics.f_number, optics.reference_um)
        far_um = blur_um / 2 + GUARD_AIRY * optics.airy_um / 2
        reach = max(reach, far_um / optics.pitch_um)
    return max(LEAST_GUARD_PX, math.ceil(reach))
