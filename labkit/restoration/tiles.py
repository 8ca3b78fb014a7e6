"""A whole photograph restored in tiles that overlap and are blended, each with the PSF of its place.

A photograph of one tile is the plain problem. Lenses that differ from tile to tile, blended, are a product-convolution
(L. Denis et al., Int. J. Comput. Vis. 115, 253 (2015)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from scipy import ndimage

from labkit.jobs.execute import Run, Workers, in_order
from labkit.restoration.calibration import calibrate_errors
from labkit.restoration.canvas import BAND_ROWS, Canvas
from labkit.restoration.errors import standard_errors
from labkit.restoration.job import Area, Job
from labkit.restoration.roughness import Norm, Roughness
from labkit.restoration.solve import Restored, Start, restore
from labkit.restoration.strength import Choice, Strength, choose
from labkit.restoration.views import Views
from labkit.types import Bools, Floats, Floats32, Progress, no_progress

COARSE_SAMPLES = 2  # samples a pixel, on which the bound's active samples are found first
CHOSEN_ON = 4  # samples a pixel, at most, that a strength is chosen on
STRENGTH_PARTS, STRENGTH_PART_PX = 3, 96  # that a strength is chosen by
TRACE_SEED = 1
BYTES_A_SAMPLE, BYTES_A_PLANE = 130, 12  # of a tile's scene, for each colour and each plane
LEAST_ROWS, LEAST_CELLS = 96, 24  # of the torus that errors are computed on
USUAL_STEPS = 6  # of Newton, on both grids together
REACH_CELLS = 1.5  # distance to a used count beyond which the scene is unknown
HALF, MOST_LOOKED_AT = 0.5, 2048
RICH = 0.8  # least share of used counts of an area whose contrast counts


Pixels = TypeVar("Pixels", Floats32, Bools)


@dataclass(frozen=True, eq=False)
class Picture:
    """A restored photograph.

    Attributes
    ----------
    canvas : (3, colours, rows, columns) of fine samples: scene and standard error, counts above black, and the penalty's
        share of the variance, see `standard_errors`; nan where unknown
    strength : lambda of the whole
    stiffness, chosen_by : as of `Strength`
    chi2_per_pixel : of used counts
    norm : of the scene
    tiles : their number
    unknown : share of samples without a used count near
    """

    canvas: Canvas
    strength: float
    stiffness: float
    chosen_by: str
    chi2_per_pixel: float
    norm: Norm
    tiles: int
    unknown: float

    @property
    def scene(self) -> Floats32:
        """(colours, rows, columns) counts above black."""
        return np.asarray(self.canvas.opened()[0])

    @property
    def std(self) -> Floats32:
        """(colours, rows, columns) standard errors."""
        return np.asarray(self.canvas.opened()[1])

    @property
    def by_penalty(self) -> Floats32:
        """(colours, rows, columns) share of the variance by the penalty."""
        return np.asarray(self.canvas.opened()[2])

    @property
    def penalty_rules(self) -> float:
        """Share of samples whose variance is the penalty's by more than half."""
        counts = [(np.sum(b > HALF), np.isfinite(b).sum()) for b in self.canvas.bands(2)]
        rules, every = np.sum(counts, axis=0)
        return float(rules / max(every, 1))

    @property
    def penalty_share(self) -> float:
        """Median share of the variance by the penalty, of some samples of a large picture."""
        step = -(-max(self.canvas.shape[2:]) // MOST_LOOKED_AT)
        return float(np.nanmedian(self.by_penalty[:, ::step, ::step]))


@dataclass(frozen=True)
class Task:
    """A tile. strength: lambda of a picture of one tile, 0 if it is to be taken from the stiffness."""

    job: Job
    strength: float
    stiffness: float


@dataclass(frozen=True, eq=False)
class Part:
    """A restored tile: layers as of `Picture`; chi2 summed over counts; norm of the tile's scene, over as many pixels."""

    layers: Floats32
    chi2: float
    counts: int
    norm: Norm
    pixels: float


def restore_job(
    job: Job,
    strength: float | Choice,
    tile_px: int,
    overlap_px: int,
    run: Run | None = None,
    progress: Progress = no_progress,
    make_canvas: Callable[[tuple[int, ...]], Canvas] = Canvas,
) -> Picture:
    """Restore a scene.

    Parameters
    ----------
    job : photographs and lenses
    strength : lambda, or how to choose it
    tile_px, overlap_px : a tile's side, and its overlap with others
    run : where tiles are restored; None for this process
    progress : called with the step under way
    make_canvas : makes the picture, of a shape, that tiles are added to; in memory by default
    """
    here = run or Workers(1)
    areas = list(tiles(job.shape, tile_px, overlap_px, job.period))
    alone = len(areas) == 1
    progress(0, USUAL_STEPS + 1 if alone else len(areas) + 1, "choosing how smooth")
    if isinstance(strength, Choice):
        rng = np.random.default_rng(TRACE_SEED)
        by_hand = 0.0
        chosen = choose(parts_of(job), job.coupling, strength, rng)
    else:
        by_hand = strength
        chosen = Strength(2 * strength / guessed_square(job), "hand")
    lambda_ = by_hand if alone else 0.0
    tasks = [Task(job.cut(area), lambda_, chosen.stiffness) for area, _ in areas]
    rows, columns = (job.samples * side for side in job.shape)
    canvas = make_canvas((3, len(job.colours), rows, columns))
    done = _blended(canvas, areas, tasks, here, progress)
    unknown = _hide_unknown(canvas, job)

    def restored(tests: Sequence[Job]) -> Iterator[tuple[int, Floats32]]:
        again = [Task(test, 0.0, chosen.stiffness) for test in tests]
        for index, part in here(restore_tile, again):
            yield index, part.layers

    calibrate_errors(canvas, job, chosen.stiffness, restored)
    norm = _together(done, (1 - unknown) * math.prod(job.shape))
    chi2 = sum(part.chi2 for part in done) / max(sum(part.counts for part in done), 1)
    found = by_hand or 0.5 * chosen.stiffness * norm.square
    how = chosen.stiffness, chosen.chosen_by
    return Picture(canvas, found, *how, chi2, norm, len(areas), unknown)


def _blended(
    canvas: Canvas,
    areas: Sequence[tuple[Area, Floats]],
    tasks: Sequence[Task],
    run: Run,
    progress: Progress,
) -> list[Part]:
    """Add all tiles to a picture; return them without their layers."""
    done = list[Part]()
    samples = tasks[0].job.samples
    for index, part in _parts(tasks, run, progress):
        done.append(replace(part, layers=np.empty(0, np.float32)))
        area, weight = areas[index]
        fine = tuple(slice(samples * of.start, samples * of.stop) for of in area)
        share = _enlarged(weight.astype(np.float32), samples)
        canvas.opened()[:, :, *fine] += share * part.layers
        total = USUAL_STEPS + 1 if len(tasks) == 1 else len(tasks) + 1
        words = f"tile {len(done)} of {len(tasks)}"
        progress(total if len(tasks) == 1 else len(done), total, words)
    return done


def _hide_unknown(canvas: Canvas, job: Job) -> float:
    """Set samples without a used count near to nan; return their share."""
    unknown = ~known(job)
    if not unknown.any():
        return 0.0
    for first in range(0, job.shape[0], BAND_ROWS):
        some = _enlarged(unknown[:, first : first + BAND_ROWS], job.samples)
        start = first * job.samples
        canvas.opened()[:, :, start : start + some.shape[1]][:, some] = np.nan
    return float(np.mean(unknown))


def _parts(
    tasks: Sequence[Task], run: Run, progress: Progress
) -> Iterator[tuple[int, Part]]:
    """Yield each tile's part with its number; a picture of one tile reports its steps."""
    if len(tasks) > 1:
        # sums of overlaps do not depend on which tile ends first
        yield from in_order(run(restore_tile, tasks))
        return
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1
        progress(min(steps, USUAL_STEPS), USUAL_STEPS + 1, f"step {steps}")

    yield 0, restore_tile(tasks[0], step)


def restore_tile(task: Task, step: Callable[[], None] = lambda: None) -> Part:
    """Restore a tile, on few samples first, then on all. step: called after each step of Newton's."""
    job = task.job
    count = len(task.job.colours)
    rows, columns = (side * job.samples for side in job.shape)
    layers = np.zeros((3, count, rows, columns), np.float32)
    means = np.zeros(count)
    there = [c for c in range(count) if job.sees(c)]
    if not there:
        return Part(layers, 0.0, 0, Norm(0.0, means, 0.0), 0.0)
    part = job.only(there)
    start = None
    if job.samples > COARSE_SAMPLES:
        views, restored = _restored(part.of_samples(COARSE_SAMPLES), task, None, step)
        start = restored.finer(views.grid, job.samples)
    views, restored = _restored(part, task, start, step)
    # as far as a count's light reaches, and enough that Nyquist's row, which no plane sees, is a small share; odd
    reach = 2 * -(-job.guard_px // job.period)
    cells = max(LEAST_CELLS, reach, -(-LEAST_ROWS // (job.period * job.samples))) | 1
    small = part.small(cells)
    errors = standard_errors(views, small, part.coupling, task.stiffness, restored.means)
    layers[:, there] = restored.scene[:, *views.grid.inner], *errors
    means[there] = restored.norm.means
    pixels = float(views.seen().sum()) / job.samples**2
    norm = replace(restored.norm, means=means)
    return Part(layers, views.chi2(restored.means), views.data, norm, pixels)


def _restored(
    job: Job, task: Task, start: Start | None, step: Callable[[], None]
) -> tuple[Views, Restored]:
    """Return a tile's views and scene."""
    views = job.views((slice(0, job.shape[0]), slice(0, job.shape[1])))
    assert views is not None
    exact = Roughness(views.grid, views.seen(), 1.0, job.coupling)
    penalty = replace(exact, strength=task.strength)
    if not task.strength:
        held = Norm(1.0, np.zeros(len(job.colours)), 0.0)
        penalty = replace(exact, strength=0.5 * task.stiffness, held=held)
    restored = restore(views, penalty, start, step)
    norm = exact.norm(restored.scene, views.grid.spectrum(restored.scene))
    return views, replace(restored, norm=norm)


def tiles(
    shape: tuple[int, int], tile_px: int, overlap_px: int, period: int
) -> Iterator[tuple[Area, Floats]]:
    """Yield areas of whole cells with their overlap, and weights (rows, columns) of pixels that sum to 1 over all areas."""
    rows, columns = (_stretches(side, tile_px, overlap_px, period) for side in shape)
    across = list(columns)
    for down, by_row in rows:
        for right, by_column in across:
            yield (down, right), np.outer(by_row, by_column)


def _stretches(
    length: int, tile: int, overlap: int, period: int
) -> Iterator[tuple[slice, Floats]]:
    """Yield the tiles of one axis, with weights."""
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
    """Return the parts of a photograph that a strength is chosen by: the richest in contrast, and some others.

    They have samples fine enough for the lens: a scene that a coarser grid cannot hold would pass for noise.
    """
    coarse = job.of_samples(min(CHOSEN_ON, job.nyquist_samples))
    areas = areas_of(job, STRENGTH_PART_PX // job.period * job.period)
    count = min(STRENGTH_PARTS, len(areas))
    chosen = dict.fromkeys(
        k * (len(areas) - 1) // (STRENGTH_PARTS - 1) for k in range(count)
    )
    views = [coarse.views(areas[k]) for k in chosen]
    if not (found := [view for view in views if view is not None]):
        raise ValueError("no part of the photograph has usable counts of every colour")
    return found


def areas_of(job: Job, side: int) -> list[Area]:
    """Return squares of a photograph, the richest in contrast first: of its first colour, if most is used."""
    photograph, (row, column) = job.photographs[0], job.colours[0].places[0]

    def contrast(area: Area) -> float:
        plane = job.plane((row, column), area)
        used = photograph.used[plane]
        return float(photograph.counts[plane][used].std()) if used.mean() > RICH else -1.0

    rows, columns = job.shape
    areas = [
        (slice(r, min(r + side, rows)), slice(c, min(c + side, columns)))
        for r in range(0, max(rows - side // 2, 1), side)
        for c in range(0, max(columns - side // 2, 1), side)
    ]
    return sorted(areas, key=lambda area: -contrast(area))


def guessed_square(job: Job) -> float:
    """Return the square of the scene's norm by its blurred picture without noise: counts squared, pixels."""
    sizes = np.zeros(len(job.colours))
    photograph = job.photographs[0]
    for k, colour in enumerate(job.colours):
        planes = [job.plane(place) for place in colour.places]
        counts = np.concatenate([photograph.counts[p][photograph.used[p]] for p in planes])
        if counts.size:
            noise = colour.gain * max(float(counts.mean()), 0.0) + colour.read_variance
            sizes[k] = np.sqrt(max(float(counts.var()) - noise, 0.01 * noise))
    pixels = float(photograph.used.mean()) * job.shape[0] * job.shape[1]
    return pixels * float(sizes @ job.coupling @ sizes)


def known(job: Job) -> Bools:
    """Return the mask (colours, rows, columns) of pixels near a used count of their colour."""
    result = np.zeros((len(job.colours), *job.shape), bool)
    reach = int(REACH_CELLS * job.period)
    for mask, colour in zip(result, job.colours, strict=True):
        for photograph in job.photographs:
            for place in colour.places:
                plane = job.plane(place)
                mask[plane] |= photograph.used[plane]
        mask[:] = ndimage.maximum_filter(mask, 2 * reach + 1)
    return result


def memory_bytes(job: Job, tile_px: int, overlap_px: int) -> int:
    """Return the memory that a tile takes, about."""
    side = min(tile_px + 4 * overlap_px // 2, max(job.shape)) + 2 * job.guard_px
    planes = len(job.photographs) * sum(len(colour.places) for colour in job.colours)
    bytes_ = BYTES_A_SAMPLE * len(job.colours) + BYTES_A_PLANE * planes
    return int((job.samples * side) ** 2 * bytes_)


def _together(parts: Sequence[Part], shown: float) -> Norm:
    """Return the norm of all tiles' scenes over the shown pixels, overlaps counted once."""
    pixels = np.array([part.pixels for part in parts])
    each = np.array([part.norm.means for part in parts])
    total = max(float(pixels.sum()), 1.0)
    means = pixels @ each / total
    between = float(pixels @ np.sum((each - means) ** 2, axis=1))
    within = sum(part.norm.square for part in parts)
    rough = sum(part.norm.square * part.norm.roughness for part in parts)
    square = (within + between) * shown / total
    return Norm(square, means, rough / max(within + between, 1e-30))


def _enlarged(pixels: Pixels, samples: int) -> Pixels:
    """Return fine samples (..., rows, columns) of pixels."""
    rows = np.repeat(pixels, samples, axis=-2)
    return np.repeat(rows, samples, axis=-1)
