"""Standard errors fitted to the photograph: larger where its scene is rougher, right for a like scene whose truth is known.

The penalty supposes a Gaussian scene, everywhere equally rough. Photographs have few edges and much that is even: most
errors are far smaller than the supposed standard deviation, and those at edges larger. So the penalty's part of a variance
follows the squared slope about a sample. Then the scene made half as large, which is nearly free of blur, is photographed by
the same lens and restored again: of that scene the truth is known. Scenes are alike at all scales (D. Ruderman and W. Bialek,
Phys. Rev. Lett. 73, 814 (1994)), so the errors in that test are those of the photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from labkit.restoration.canvas import BAND_ROWS, Canvas
from labkit.restoration.job import Area, Exposure, Job
from labkit.types import Floats, Floats32

SMALLER = 2  # times, of the scene whose truth is known
PARTS, PART_PX, LEAST_PART_PX = 4, 96, 16  # of the photograph of that scene
RIM = 8  # of a part's side: a rim of an eighth is left out
SLOPES_PX = 1.0  # standard deviation of the neighbourhood whose slopes count
ONE_STD = 0.6827  # of a normal distribution within one standard deviation
TEST_SEED = 2
LEAST_SLOPES = np.finfo(np.float32).tiny


def squared_slopes(scene: Floats32, samples: int) -> Floats32:
    """Return smoothed squared slopes (colours, rows, columns) of a scene; nan beside nan."""
    down, right = np.gradient(scene, axis=(1, 2))
    squares = down**2 + right**2
    width = 0, SLOPES_PX * samples, SLOPES_PX * samples
    return np.asarray(ndimage.gaussian_filter(squares, width, mode="nearest"))


def localised(layers: Floats32, slopes: Floats32, mean: Floats) -> Floats32:
    """Return the three layers of a picture with errors by its slopes. mean: (colours,) of the slopes of all of the picture."""
    scene, std, by_penalty = layers
    rougher = np.nan_to_num(slopes / np.maximum(mean, LEAST_SLOPES)[:, None, None], nan=1.0)
    noise = 1 - by_penalty
    penalty = rougher * by_penalty
    both = noise + penalty
    return np.asarray([scene, std * np.sqrt(both), penalty / both], np.float32)


def localise(canvas: Canvas, samples: int) -> None:
    """Make the errors of a picture those by its slopes."""
    halo = int(4 * SLOPES_PX * samples) + 2
    rows = canvas.shape[2]

    def slopes() -> Iterator[tuple[slice, Floats32]]:
        for first in range(0, rows, BAND_ROWS):
            last = min(first + BAND_ROWS, rows)
            top = max(first - halo, 0)
            scene = np.array(canvas.opened()[0, :, top : last + halo])
            yield (
                slice(first, last),
                squared_slopes(scene, samples)[:, first - top :][:, : last - first],
            )

    sums = [
        (np.nansum(s, axis=(1, 2)), np.isfinite(s).sum(axis=(1, 2))) for _, s in slopes()
    ]
    total, count = np.sum(sums, axis=0)
    for band, of_band in slopes():
        layers = canvas.opened()[:, :, band]
        layers[:] = localised(np.array(layers), of_band, total / np.maximum(count, 1))


def tests_of(canvas: Canvas, job: Job) -> list[tuple[Job, Floats32]]:
    """Return photographs of parts of the restored scene made smaller, and those parts: the truth."""
    rng = np.random.default_rng(TEST_SEED)
    found = []
    for area in _parts(job):
        down, right = (slice(job.samples * s.start, job.samples * s.stop) for s in area)
        scene = np.array(canvas.opened()[0, :, down, right])
        colours, rows, columns = scene.shape
        blocks = colours, rows // SMALLER, SMALLER, columns // SMALLER, SMALLER
        truth = scene.reshape(blocks).mean(axis=(2, 4))
        if np.isfinite(truth).all():
            found.append((_photographed(job, area, truth, rng), truth))
    return found


def _parts(job: Job) -> list[Area]:
    """Return squares of the photograph along its diagonal, and that across it, in whole cells; none if it is too small."""
    cell = SMALLER * job.period
    side = min(SMALLER * PART_PX, *job.shape) // cell * cell
    if side < SMALLER * LEAST_PART_PX:
        return []
    rows, columns = (shape - side for shape in job.shape)
    count = min(PARTS, 1 + min(rows, columns) // side)
    places = [(k + 0.5) / count for k in range(count)]
    corners = [
        (round(rows * place / cell) * cell, round(columns * other / cell) * cell)
        for k, place in enumerate(places)
        for other in (places[(2 * k + 1) % count],)
    ]
    return [(slice(r, r + side), slice(c, c + side)) for r, c in corners]


def _photographed(job: Job, area: Area, truth: Floats32, rng: np.random.Generator) -> Job:
    """Return a scene's photographs by the lens of an area, with noise."""
    rows, columns = (slice(s.start, s.start + (s.stop - s.start) // SMALLER) for s in area)
    every = np.ones((rows.stop - rows.start, columns.stop - columns.start), bool)
    shots = tuple(
        Exposure(every * np.float32(0), every, every * np.float32(1), p.motion)
        for p in job.cut((rows, columns)).photographs
    )
    part = replace(job.cut((rows, columns)), photographs=shots)
    views = part.views((slice(0, every.shape[0]), slice(0, every.shape[1])))
    assert views is not None
    inner = zip(views.grid.inner, views.grid.shape, strict=True)
    beyond = [(0, 0), *((side.start, whole - side.stop) for side, whole in inner)]
    spectra = views.grid.spectrum(np.pad(truth, beyond, mode="symmetric"))
    counts = [np.zeros(every.shape, np.float32) for _ in shots]
    images = iter(zip(views, views.means(spectra), strict=True))
    for colour in part.colours:
        for image in counts:
            for place in colour.places:
                view, mean = next(images)
                noise = rng.normal(size=mean.shape) * np.sqrt(view.expected(mean).variance)
                image[part.plane(place)] = mean + noise
    exposed = tuple(replace(s, counts=c) for s, c in zip(shots, counts, strict=True))
    return replace(part, photographs=exposed)


def ratios(layers: Floats32, truth: Floats32, samples: int) -> Floats:
    """Return errors over standard errors (colours, samples) of a restored part, without its rim."""
    slopes = squared_slopes(layers[0], samples)
    scene, std, _ = localised(layers, slopes, slopes.mean(axis=(1, 2)))
    apart = np.abs(scene - truth) / std
    rims = (max(side // RIM, 1) for side in apart.shape[1:])
    down, right = (slice(rim, -rim) for rim in rims)
    return np.asarray(apart[:, down, right].reshape(len(apart), -1), float)


def scaled(canvas: Canvas, factors: Floats) -> None:
    """Multiply the errors of a picture by factors (colours,)."""
    for first in range(0, canvas.shape[2], BAND_ROWS):
        canvas.opened()[1, :, first : first + BAND_ROWS] *= factors[:, None, None]


def calibrate_errors(
    canvas: Canvas,
    job: Job,
    restored: Callable[[Sequence[Job]], Iterator[tuple[int, Floats32]]],
) -> None:
    """Make a picture's errors such that 68 % of a scene like it is within one of them.

    restored: returns the layers of photographs, with their numbers. A photograph too small for a test keeps its errors' scale.
    """
    localise(canvas, job.samples)
    tests = tests_of(canvas, job)
    if not tests:
        return
    answers = restored([test for test, _ in tests])
    every = [ratios(layers, tests[k][1], job.samples) for k, layers in answers]
    scaled(canvas, np.quantile(np.concatenate(every, axis=1), ONE_STD, axis=1))
