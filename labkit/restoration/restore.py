"""From photographs and a session to restored scenes in a folder."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from labkit.analysis.measured_camera import optics_behind
from labkit.calibration.calibrate import calibrate
from labkit.calibration.photon_transfer import ROUNDING_VARIANCE
from labkit.errors import DataError
from labkit.optics.lens import blur_per_wave_um
from labkit.plan.sensor import MONO
from labkit.restoration import output
from labkit.restoration.blind import SPAN_WAVES, fitted_defocus
from labkit.restoration.colours import colour_coupling
from labkit.restoration.job import Area, Colour, Exposure, Job
from labkit.restoration.lens import nearest, waves_at
from labkit.restoration.photographs import (
    Shot,
    own_exif,
    period_of,
    read_frame,
    read_shot,
    refuse_other_camera,
    with_motion,
)
from labkit.restoration.registration import refined, registered
from labkit.restoration.strength import Choice
from labkit.restoration.tiles import Picture, memory_bytes, restore_job
from labkit.restoration.unknowns import doubts, with_own_noise
from labkit.results import Results, Wavefront
from labkit.session.session import Session
from labkit.types import Floats, Floats32, Progress, no_progress

RESTORED_TILE_PX, LEAST_TILE_PX = 256, 64
LEAST_GUARD_PX, GUARD_AIRY = (
    12,
    24.0,
)  # beyond the geometric blur: of pixels, and of lambda N, for diffraction


@dataclass(frozen=True)
class Wanted:
    """How a scene is to be restored; what is None is chosen.

    strength: lambda, or how it is chosen. samples: to a pixel. tile_px: a tile's side. memory_gb: to use at most. force: take a
    PSF though the photograph contradicts it.
    method: its name; baseline: another method than labkit's own. sixteen_bit: write such a TIFF too.
    """

    strength: float | Choice = "discrepancy"
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
    """What was written, and what is to be said of it."""

    folder: Path
    about: dict[str, Any]
    notes: tuple[str, ...] = field(default_factory=tuple)


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
    """Restore photographs of one scene, from one range, with a session's lens. session: where its photographs are at hand.

    say: called with what it will take before it begins. Raises RawError, DataError, InputError.
    """
    output.refuse_full(out)
    shots = [read_shot(path, results.plan, wanted.crop) for path in images]
    if not wanted.force:
        frames = [] if session is None else session.frames
        for path, shot in zip(images, shots, strict=True):
            refuse_other_camera(path, shot.mosaic, own_exif(frames), None, results.plan)
    range_mm = wanted.range_mm
    if range_mm is None and not wanted.fit_defocus:
        range_mm = _only_range(results)
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
    """Restore a session's own target frames of one range. Raises DataError where there are none."""
    output.refuse_full(out)
    frames = [
        f for f in session.frames if f.kind == "target" and _same(f.range_mm, range_mm)
    ]
    if not frames:
        known = ", ".join(f"{w.range_mm:g}" for w in results if w.range_mm is not None)
        raise DataError(
            f"{session.folder}: no target frames at {range_mm} mm: there are some at {known}"
        )
    names = wanted.channels or results.channels
    calibration = calibrate(session.frames, results.plan)
    shots = [
        read_frame(frame, results.plan, calibration, names, wanted.crop) for frame in frames
    ]
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
    began, notes = perf_counter(), list[str]()
    names, origin = _channels(shots[0], results, wanted), _origin(shots[0], wanted)
    colours = [_colour(shots[0], results, name, range_mm, wanted) for name in names]
    job = _job(shots, _with_lateral_colour(colours, results, range_mm), wanted, origin)
    if (clipped := max(shot.clipped for shot in shots)) > 0:
        notes.append(
            f"{100 * clipped:.2g} % of the pixels are clipped: the scene is restored from what is around them"
        )
    if wanted.force:
        job = with_own_noise(job, notes)
    fitted: dict[str, Any] = {}
    if wanted.fit_defocus:
        job, defocus = fitted_defocus(job, progress)
        job = replace(job, guard_px=_guard(job.colours))
        fitted = {
            "fitted_defocus_waves": defocus.waves,
            "fitted_defocus_std_waves": defocus.std,
        }
        notes += doubts(defocus)
    tile = _tile(job, wanted)
    workers = _workers(job, tile, wanted)
    say(_will_take(job, tile, workers))
    white = shots[0].mosaic.white - float(np.mean(shots[0].mosaic.black))
    std: Floats32 | None = None
    if wanted.baseline is None:
        picture = restore_job(
            job, wanted.strength, tile, 2 * job.guard_px, workers, progress
        )
        scene, std, more = picture.scene, picture.std, _about(picture)
        notes += _remarks(picture)
    else:
        scene, more = (
            wanted.baseline(job),
            {"lambda": None, "method": wanted.method},
        )
    more |= {
        "seconds": round(perf_counter() - began, 2),
        "frames": len(shots),
        "white_counts": white,
        "notes": notes,
    }
    about = _where(job, names, origin, range_mm) | fitted | more
    output.write(out, scene, std, about, white if wanted.sixteen_bit else None)
    return Restoration(out, about, tuple(notes))


def _where(
    job: Job, names: Sequence[str], origin: tuple[int, int], range_mm: float | None
) -> dict[str, Any]:
    """The contract's first part of restore.json."""
    return {
        "schema": 1,
        "channels": list(names),
        "spacing_um": job.pitch_um / job.samples,
        "origin_px": list(origin),
        "range_mm": range_mm,
        "samples_per_px": job.samples,
        "defocus_waves": {c.name: _defocus(c) for c in job.colours},
    }


def _about(picture: Picture) -> dict[str, Any]:
    return {
        "lambda": {
            "value": picture.strength,
            "chosen_by": picture.chosen_by,
            "stiffness": picture.stiffness,
            "roughness": picture.norm.roughness,
        },
        "chi2_per_pixel": picture.chi2_per_pixel,
        "penalty_share": float(np.nanmedian(picture.by_penalty)),
        "penalty_rules": float(np.nanmean(picture.by_penalty > 0.5)),
        "unknown": float(np.mean(np.isnan(picture.scene))),
        "tiles": picture.tiles,
    }


def _remarks(picture: Picture) -> list[str]:
    rules, unknown = (
        float(np.nanmean(picture.by_penalty > 0.5)),
        float(np.mean(np.isnan(picture.scene))),
    )
    notes = []
    if rules > 0.01:
        notes.append(
            f"in {100 * rules:.0f} % of the samples the penalty rules: more than half of their error's variance is what it "
            "supposes of the scene, not noise"
        )
    if unknown > 0:
        notes.append(
            f"{100 * unknown:.2g} % of the samples have no usable count near: they are not restored (nan)"
        )
    return notes


def _channels(shot: Shot, results: Results, wanted: Wanted) -> list[str]:
    """Names, in the order of the results. Raises DataError for one without a PSF unless it is forced."""
    names = list(wanted.channels or results.channels)
    for name in names:
        if name not in results.channels and not wanted.force:
            nearest(results, name, None)
        shot.mosaic.pixels(name)  # of a colour that it has
    if shot.mosaic.pattern == MONO and len(names) > 1:
        raise DataError(
            f"the photograph has one colour, the session {', '.join(names)}: say which with --channel"
        )
    return names


def _colour(
    shot: Shot, results: Results, name: str, range_mm: float | None, wanted: Wanted
) -> Colour:
    taken = name if name in results.channels else results.channels[0]
    wavefront = nearest(results, taken, range_mm)
    return Colour(
        name,
        shot.mosaic.pixels(name).places,
        optics_behind(results, results.plan, wavefront),
        waves_at(results, wavefront, None if wanted.fit_defocus else range_mm),
        wavefront.gain,
        wavefront.read_noise**2 + ROUNDING_VARIANCE,
    )


def _with_lateral_colour(
    colours: list[Colour], results: Results, range_mm: float | None
) -> list[Colour]:
    """Each with its motion beside the first, by where the fits found the target's corners in each colour."""
    placed = [_corners(results, colour.name, range_mm) for colour in colours]
    if len(colours) == 1 or any(corners is None for corners in placed):
        return colours
    first = placed[0]
    assert first is not None
    return [
        replace(c, motion=_affine(first, own))
        for c, own in zip(colours, placed, strict=True)
        if own is not None
    ]


def _corners(results: Results, channel: str, range_mm: float | None) -> Floats | None:
    if channel not in results.channels:
        return None
    placement = nearest(results, channel, range_mm).placement
    return None if placement is None else placement.corners_px[0]


def _affine(points: Floats, moved: Floats) -> Floats:
    """(2, 3) least-squares motion of points (n, 2)."""
    at = np.column_stack([points, np.ones(len(points))])
    return np.asarray(np.linalg.lstsq(at, moved - points, rcond=None)[0].T)


def _job(
    shots: Sequence[Shot],
    colours: Sequence[Colour],
    wanted: Wanted,
    origin: tuple[int, int],
) -> Job:
    period = period_of(shots[0].mosaic)
    first = shots[0].photograph
    if any(shot.photograph.counts.shape != first.counts.shape for shot in shots):
        raise DataError("the photographs differ in size: restore them apart")
    photographs = [first]
    for shot in shots[1:]:
        photographs.append(with_motion(shot, registered(first, shot.photograph, period)))
    at = np.array([origin[0], origin[1]], float)
    colours = [replace(c, motion=_begun_at(c.motion, at)) for c in colours]
    guard_px = _guard(colours, SPAN_WAVES if wanted.fit_defocus else 0.0)
    job = Job(tuple(photographs), tuple(colours), period, 1, guard_px, np.eye(len(colours)))
    job = job.of_samples(wanted.samples or job.nyquist_samples)
    return refined(replace(job, coupling=colour_coupling(job)) if len(colours) > 1 else job)


def _begun_at(motion: Floats, origin: Floats) -> Floats:
    """A motion of the whole photograph in coordinates of its cut."""
    moved = motion.copy()
    moved[:, 2] += motion[:, :2] @ origin
    return moved


def _guard(colours: Sequence[Colour], least_waves: float = 0.0) -> int:
    """From how far light reaches a pixel, but for the halo's last share, pixels; by so many waves at least."""
    reach = 0.0
    for colour in colours:
        optics = colour.optics
        waves = max(float(np.linalg.norm(colour.waves)), least_waves)
        blur_um = waves * blur_per_wave_um(optics.f_number, optics.reference_um)
        reach = max(
            reach, (blur_um / 2 + GUARD_AIRY * optics.airy_um / 2) / optics.pitch_um
        )
    return max(LEAST_GUARD_PX, math.ceil(reach))


def _tile(job: Job, wanted: Wanted) -> int:
    """The largest that memory allows. Raises DataError where none does, or the given one does not fit."""
    free = _free_bytes(wanted)

    def fits(tile: int) -> bool:
        return _whole_bytes(job, tile, 1) <= free

    sizes = [max(job.shape)] if max(job.shape) <= RESTORED_TILE_PX else []
    sizes += [
        tile
        for tile in (RESTORED_TILE_PX, 192, 128, 96, LEAST_TILE_PX)
        if tile < max(job.shape)
    ]
    best = next((tile for tile in sizes if fits(tile)), None)
    asked = wanted.tile_px
    needed = _whole_bytes(job, asked or sizes[-1], 1)
    if asked is not None and fits(asked):
        return asked
    if best is None:
        raise DataError(
            f"restoring {job.shape[0]} x {job.shape[1]} pixels at {job.samples} samples a pixel takes {needed / 1e9:.2g} GB "
            f"even in tiles of {sizes[-1]} pixels, and {free / 1e9:.2g} GB are free: take fewer with --samples, or --crop"
        )
    if asked is not None:
        raise DataError(
            f"--tile {asked}: that takes {needed / 1e9:.2g} GB, and {free / 1e9:.2g} GB are free: --tile {best} fits"
        )
    return best


def _free_bytes(wanted: Wanted) -> float:
    if wanted.memory_gb is not None:
        return wanted.memory_gb * 1e9
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            return 0.8e3 * next(
                float(line.split()[1]) for line in file if line.startswith("MemAvailable")
            )
    except (OSError, StopIteration):
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _tiles(job: Job, tile: int) -> int:
    rows, columns = job.shape
    return math.ceil(rows / tile) * math.ceil(columns / tile)


def _workers(job: Job, tile: int, wanted: Wanted) -> int:
    """As many as are wanted, have a tile, and memory allows: at least one."""
    most = min(wanted.workers, _tiles(job, tile))
    return next(
        (
            n
            for n in range(most, 1, -1)
            if _whole_bytes(job, tile, n) <= _free_bytes(wanted)
        ),
        1,
    )


def _whole_bytes(job: Job, tile: int, workers: int) -> float:
    """Of a picture and so many tiles."""
    picture = 8.0 * len(job.colours) * job.shape[0] * job.shape[1] * job.samples**2
    return picture + workers * memory_bytes(job, tile, 2 * job.guard_px)


def _will_take(job: Job, tile: int, workers: int) -> str:
    (rows, columns), count, memory = (
        job.shape,
        _tiles(job, tile),
        _whole_bytes(job, tile, workers),
    )
    plural = "one tile" if count == 1 else f"{count} tiles of {tile} pixels"
    return (
        f"{rows} x {columns} pixels, {job.samples} samples a pixel ({job.pitch_um / job.samples:.3g} um): {plural}, "
        f"about {memory / 1e9:.2g} GB"
    )


def _only_range(results: Results) -> float | None:
    ranges = results.ranges_mm
    if len(ranges) > 1:
        known = ", ".join(f"{r:g}" for r in ranges if r is not None)
        raise DataError(
            f"from which range was it taken? Give --range (measured: {known} mm), or --fit-defocus"
        )
    return ranges[0]


def _origin(shot: Shot, wanted: Wanted) -> tuple[int, int]:
    """(row, column) of the first pixel."""
    if wanted.crop is None:
        return 0, 0
    period = period_of(shot.mosaic)
    row, column = (-(-part.start // period) * period for part in wanted.crop)
    return row, column


def _defocus(colour: Colour) -> float | None:
    noll = colour.optics.noll
    return float(colour.waves[noll.index(4)]) if 4 in noll else None


def _same(one: float | None, other: float | None) -> bool:
    return one is other if one is None or other is None else abs(one - other) < 1e-6


__all__ = [
    "Exposure",
    "Floats32",
    "Restoration",
    "Wanted",
    "Wavefront",
    "restore_images",
    "restore_session",
]
