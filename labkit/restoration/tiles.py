"""A whole photograph restored in tiles that overlap and are blended, each with the PSF of its place: one picture without seams.

Where a photograph is one tile this is the plain problem. Lenses that differ from tile to tile, blended, are a
product-convolution (L. Denis et al., Int. J. Comput. Vis. 115, 253 (2015)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import ndimage

from labkit.execute import run_all
from labkit.restoration.errors import standard_errors
from labkit.restoration.job import Area, Job
from labkit.restoration.roughness import Norm, Roughness
from labkit.restoration.solve import Restored, restore
from labkit.restoration.strength import Choice, Strength, choose
from labkit.restoration.views import Views
from labkit.types import Bools, Floats, Floats32, Progress, no_progress

COARSE_SAMPLES = (
    2  # samples to a pixel, on which the bound's active samples are found first
)
CHOSEN_ON = 4  # samples to a pixel, at most, that a strength is chosen on
STRENGTH_PARTS, STRENGTH_PART_PX = 3, 96  # what a strength is chosen by
STRENGTH_SEED = 1
BYTES_A_SAMPLE, BYTES_A_PLANE = (
    130,
    12,
)  # of a tile's scene, for each colour, and for each plane
LEAST_ROWS = 96
USUAL_STEPS = 6  # of Newton, on both grids together
REACH_CELLS = 1.5  # from a used count, beyond which nothing is said of the scene


@dataclass(frozen=True, eq=False)
class Picture:
    """scene, std, by_penalty: (colours, rows, columns) samples of the photograph, counts above black, nan where nothing is
    known; see `ErrorMap`. strength: lambda of the whole; stiffness: as `Strength`
    has it; norm: of the scene; tiles: how many."""

    scene: Floats32
    std: Floats32
    by_penalty: Floats32
    strength: float
    stiffness: float
    chosen_by: str
    chi2_per_pixel: float
    norm: Norm
    tiles: int


@dataclass(frozen=True)
class Task:
    """A tile, as it travels to a worker. area: of its data in the job's photographs; penalty: lambda of all, or a stiffness."""

    job: Job
    area: Area
    strength: float
    stiffness: float
    whole: bool


@dataclass(frozen=True, eq=False)
class Part:
    """What comes back. chi2: summed over counts; norm: of this tile's scene, over as many pixels."""

    scene: Floats32
    std: Floats32
    by_penalty: Floats32
    chi2: float
    counts: int
    norm: Norm
    pixels: float


def restore_job(
    job: Job,
    strength: float | Choice,
    tile_px: int,
    overlap_px: int,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Picture:
    """Restore a scene. strength: lambda, or how to choose it; tile_px: a tile's side; overlap_px: with others."""
    areas = list(tiles(job.shape, tile_px, overlap_px, job.period))
    total = len(areas) + 1 if len(areas) > 1 else USUAL_STEPS + 1
    progress(0, total, "choosing how smooth")
    square = guessed_square(job)
    if isinstance(strength, str):
        chosen = choose(
            parts_of(job), job.coupling, strength, np.random.default_rng(STRENGTH_SEED)
        )
    else:
        chosen = Strength(2 * strength / square, "hand")
    by_hand = strength if isinstance(strength, int | float) else 0.0
    tasks = [
        Task(job.cut(area), _at_origin(area), by_hand, chosen.stiffness, len(areas) == 1)
        for area, _ in areas
    ]
    samples, colours = job.samples, len(job.colours)
    size = (colours, job.shape[0] * samples, job.shape[1] * samples)
    scene, std, by_penalty = (np.zeros(size, np.float32) for _ in range(3))
    done: list[Part] = []
    for index, part in _parts(tasks, workers, progress):
        done.append(part)
        (rows, columns), weight = _fine(areas[index][0], samples), areas[index][1]
        weight = np.repeat(np.repeat(weight, samples, axis=0), samples, axis=1).astype(
            np.float32
        )
        for whole, own in (
            (scene, part.scene),
            (std, part.std),
            (by_penalty, part.by_penalty),
        ):
            whole[:, rows, columns] += weight * own
        progress(
            len(done) if len(areas) > 1 else total,
            total,
            f"tile {len(done)} of {len(areas)}",
        )
    unknown = ~known(job)
    for whole in (scene, std, by_penalty):
        whole[np.repeat(np.repeat(unknown, samples, axis=1), samples, axis=2)] = np.nan
    norm = _together(done, float(np.mean(~unknown)) * job.shape[0] * job.shape[1])
    chi2 = sum(part.chi2 for part in done) / max(sum(part.counts for part in done), 1)
    found = 0.5 * chosen.stiffness * norm.square if by_hand == 0.0 else by_hand
    return Picture(
        scene,
        std,
        by_penalty,
        found,
        chosen.stiffness,
        chosen.chosen_by,
        chi2,
        norm,
        len(areas),
    )


def _parts(
    tasks: Sequence[Task], workers: int, progress: Progress
) -> Iterator[tuple[int, Part]]:
    """Each tile's part with its number; the only one of a picture tells its steps meanwhile."""
    if len(tasks) > 1:
        yield from run_all(restore_tile, tasks, workers)
        return
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1
        progress(min(steps, USUAL_STEPS), USUAL_STEPS + 1, f"step {steps}")

    yield 0, restore_tile(tasks[0], step)


def restore_tile(task: Task, step: Callable[[], None] = lambda: None) -> Part:
    """One tile: on few samples first, then on all. step: called after each of Newton's."""
    job, count = task.job, len(task.job.colours)
    shape = (count, *(side * job.samples for side in job.shape))
    nothing = np.zeros(shape, np.float32)
    there = [c for c in range(count) if job.sees(c)]
    if not there:
        return Part(nothing, nothing, nothing, 0.0, 0, Norm(0.0, np.zeros(count), 0.0), 0.0)
    part = job.only(there)
    views, restored = _restored(part, task, step)
    small = part.small(_middle(job.shape), _small_cells(job))
    errors = standard_errors(views, small, part.coupling, task.stiffness, restored.means)
    scene, std, by_penalty = (nothing.copy() for _ in range(3))
    scene[there] = restored.scene[:, *views.grid.inner]
    std[there], by_penalty[there] = errors.std, errors.by_penalty
    means = np.zeros(count)
    means[there] = restored.norm.means
    pixels = float(views.seen().sum()) / job.samples**2
    chi2 = views.chi2_per_pixel(restored.means) * views.data
    norm = replace(restored.norm, means=means)
    return Part(scene, std, by_penalty, chi2, views.data, norm, pixels)


def _small_cells(job: Job) -> int:
    """Cells along a side that errors are computed on: as far as a count's light reaches, and enough, odd if that helps, that
    Nyquist's row, which no plane sees, is a small share."""
    return (
        max(
            24,
            2 * -(-job.guard_px // job.period),
            -(-LEAST_ROWS // (job.period * job.samples)),
        )
        | 1
    )


def _restored(job: Job, task: Task, step: Callable[[], None]) -> tuple[Views, Restored]:
    """Of a tile, with its views."""
    start, done = None, list[tuple[Views, Restored]]()
    for samples in dict.fromkeys((min(COARSE_SAMPLES, job.samples), job.samples)):
        views = job.of_samples(samples).views(task.area)
        assert views is not None
        penalty = Roughness(views.grid, views.seen(), task.strength, job.coupling)
        if not (task.whole and task.strength):
            held = Norm(1.0, np.zeros(len(job.colours)), 0.0)
            penalty = replace(penalty, strength=0.5 * task.stiffness, held=held)
        restored = restore(views, penalty, start, lambda number, gained: step())
        done.append((views, restored))
        start = restored.finer(views.grid, job.samples) if samples < job.samples else None
    views, restored = done[-1]
    exact = Roughness(views.grid, views.seen(), 1.0, job.coupling)
    norm = exact.norm(restored.scene, views.grid.spectrum(restored.scene))
    return views, replace(restored, norm=norm)


def tiles(
    shape: tuple[int, int], tile_px: int, overlap_px: int, period: int
) -> Iterator[tuple[Area, Floats]]:
    """Areas of whole cells, each with its overlap, and weights (rows, columns) of its pixels that sum to 1 over all areas."""
    for rows, by_row in _stretches(shape[0], tile_px, overlap_px, period):
        for columns, by_column in _stretches(shape[1], tile_px, overlap_px, period):
            yield (rows, columns), np.outer(by_row, by_column)


def _stretches(
    length: int, tile: int, overlap: int, period: int
) -> Iterator[tuple[slice, Floats]]:
    count = max(1, -(-length // tile))
    edges = [round(k * length / count / period) * period for k in range(count + 1)]
    half = -(-overlap // (2 * period)) * period
    for low, high in pairwise(edges):
        first, last = max(low - 2 * half, 0), min(high + 2 * half, length)
        place = np.arange(first, last) + 0.5
        weight = np.ones(last - first)
        if low > 0:
            weight *= np.clip((place - (low - half)) / (2 * half), 0, 1)
        if high < length:
            weight *= np.clip(((high + half) - place) / (2 * half), 0, 1)
        yield slice(first, last), weight


def parts_of(job: Job) -> list[Views]:
    """Those of a photograph that a strength is chosen by: the richest in contrast, and some between.

    On samples fine enough for the lens: what a coarser grid cannot hold of the scene would pass for noise.
    """
    coarse = job.of_samples(min(CHOSEN_ON, job.nyquist_samples))
    areas = areas_of(job, STRENGTH_PART_PX // job.period * job.period)
    chosen = dict.fromkeys(
        k * (len(areas) - 1) // (STRENGTH_PARTS - 1)
        for k in range(min(STRENGTH_PARTS, len(areas)))
    )
    views = [coarse.views(areas[k]) for k in chosen]
    if not (found := [view for view in views if view is not None]):
        raise ValueError("no part of the photograph has usable counts of every colour")
    return found


def areas_of(job: Job, side: int) -> list[Area]:
    """Squares of a photograph, the richest in contrast first."""
    areas = [
        (slice(r, min(r + side, job.shape[0])), slice(c, min(c + side, job.shape[1])))
        for r in range(0, max(job.shape[0] - side // 2, 1), side)
        for c in range(0, max(job.shape[1] - side // 2, 1), side)
    ]
    return sorted(areas, key=lambda area: -_contrast(job, area))


def _contrast(job: Job, area: Area) -> float:
    """Of the first photograph's first colour; none where much is clipped."""
    photograph, (row, column) = job.photographs[0], job.colours[0].places[0]
    plane = (
        slice(area[0].start + row, area[0].stop, job.period),
        slice(area[1].start + column, area[1].stop, job.period),
    )
    used = photograph.used[plane]
    return float(photograph.counts[plane][used].std()) if used.mean() > 0.8 else -1.0


def guessed_square(job: Job) -> float:
    """The norm's square of the scene as its blurred picture has it, noise taken off: counts squared, pixels."""
    sizes, photograph = [], job.photographs[0]
    for colour in job.colours:
        planes = [
            (slice(r, None, job.period), slice(c, None, job.period))
            for r, c in colour.places
        ]
        counts = np.concatenate([photograph.counts[p][photograph.used[p]] for p in planes])
        noise = (
            colour.gain * max(float(counts.mean()), 0.0) + colour.read_variance
            if counts.size
            else 1.0
        )
        sizes.append(
            np.sqrt(max(float(counts.var()) - noise, 0.01 * noise)) if counts.size else 0.0
        )
    pixels = float(photograph.used.mean()) * job.shape[0] * job.shape[1]
    return pixels * float(np.array(sizes) @ job.coupling @ np.array(sizes))


def known(job: Job) -> Bools:
    """(colours, rows, columns) pixels that are near a used count of their colour."""
    result = np.zeros((len(job.colours), *job.shape), bool)
    for mask, colour in zip(result, job.colours, strict=True):
        for photograph in job.photographs:
            for row, column in colour.places:
                plane = slice(row, None, job.period), slice(column, None, job.period)
                mask[plane] |= photograph.used[plane]
        reach = int(REACH_CELLS * job.period)
        mask[:] = ndimage.maximum_filter(mask, 2 * reach + 1)
    return result


def memory_bytes(job: Job, tile_px: int, overlap_px: int) -> int:
    """What a tile takes, about."""
    side = min(tile_px + 4 * overlap_px // 2, max(job.shape)) + 2 * job.guard_px
    planes = len(job.photographs) * sum(len(colour.places) for colour in job.colours)
    return int(
        (job.samples * side) ** 2
        * (BYTES_A_SAMPLE * len(job.colours) + BYTES_A_PLANE * planes)
    )


def _together(parts: Sequence[Part], shown: float) -> Norm:
    """The norm of all tiles' scenes: of as many pixels as are shown, overlaps counted once."""
    pixels = sum(part.pixels for part in parts)
    means = np.sum([part.pixels * part.norm.means for part in parts], axis=0) / max(
        pixels, 1.0
    )
    between = sum(
        part.pixels * float(np.sum((part.norm.means - means) ** 2)) for part in parts
    )
    within = sum(part.norm.square for part in parts)
    rough = sum(part.norm.square * part.norm.roughness for part in parts)
    square = (within + between) * shown / max(pixels, 1.0)
    return Norm(square, means, rough / max(within + between, 1e-30))


def _at_origin(area: Area) -> Area:
    return slice(0, area[0].stop - area[0].start), slice(0, area[1].stop - area[1].start)


def _fine(area: Area, samples: int) -> Area:
    rows, columns = (slice(samples * part.start, samples * part.stop) for part in area)
    return rows, columns


def _middle(shape: tuple[int, int]) -> tuple[float, float]:
    return (shape[0] - 1) / 2, (shape[1] - 1) / 2
