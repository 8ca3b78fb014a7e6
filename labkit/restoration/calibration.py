"""Standard errors fitted to the photograph: larger where its scene is rougher, right for a like scene whose truth is known.

The penalty supposes a Gaussian scene, everywhere equally rough. Photographs have few edges and large even areas: most
errors are far smaller than the supposed standard deviation, and errors at edges larger. So the penalty's part of a variance
follows the squared slope about a sample. Then the scene made half as large, which is nearly free of blur, is photographed by
the same lens and restored again: the truth of the smaller scene is known. Scenes are alike at all scales (D. Ruderman and
W. Bialek, Phys. Rev. Lett. 73, 814 (1994)), so the test has the photograph's errors.

A restored scene lacks the detail lost to blur, and would be restored too well. So a second round tests the scene
with a random error, as large as the first round found errors to be: a sample of all scenes compatible with the photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from labkit.restoration.canvas import BAND_ROWS, Canvas
from labkit.restoration.errors import random_error
from labkit.restoration.job import Area, Exposure, Job
from labkit.types import Floats, Floats32

SMALLER = 2  # times, of the scene whose truth is known
PARTS, PART_PX, LEAST_PART_PX = 4, 96, 16  # of the photograph of that scene
RIM = 8  # of a part's side: a rim of an eighth is left out
SLOPES_PX = 1.0  # standard deviation of the neighbourhood whose slopes count
ONE_STD = 0.6827  # of a normal distribution within one standard deviation
TEST_SEED = 2
TEST_ROUNDS = 2  # of tests: of the restored scene, then of a scene as rough as it may be
LEAST_SLOPES = np.finfo(np.float32).tiny


def squared_slopes(scene: Floats32, samples: int) -> Floats32:
    """Return smoothed squared slopes (colours, rows, columns) of a scene; nan beside nan."""
    down, right = np.gradient(scene, axis=(1, 2))
    squares = down**2 + right**2
    width = 0, SLOPES_PX * samples, SLOPES_PX * samples
    return np.asarray(ndimage.gaussian_filter(squares, width, mode="nearest"))


def localised(layers: Floats32, samples: int, mean: Floats) -> Floats32:
    """Return the three layers of a picture, or of a part, with errors by its slopes.

    mean: (colours,) squared slopes at which the errors are as the penalty supposes
    """
    scene, std, by_penalty = layers
    slopes = squared_slopes(scene, samples)
    rougher = np.nan_to_num(slopes / np.maximum(mean, LEAST_SLOPES)[:, None, None], nan=1.0)
    noise = 1 - by_penalty
    penalty = rougher * by_penalty
    both = noise + penalty
    return np.asarray([scene, std * np.sqrt(both), penalty / both], np.float32)


def _bands(canvas: Canvas, samples: int) -> Iterator[tuple[slice, slice, slice]]:
    """Yield rows of a picture to be worked on at once, the same with a halo about them, and their place within it."""
    halo = int(4 * SLOPES_PX * samples) + 2
    rows = canvas.shape[2]
    for first in range(0, rows, BAND_ROWS):
        last = min(first + BAND_ROWS, rows)
        top = max(first - halo, 0)
        inside = slice(first - top, last - top)
        yield slice(first, last), slice(top, last + halo), inside


def mean_slopes(canvas: Canvas, samples: int) -> Floats:
    """Return the mean squared slopes (colours,) of a picture."""
    total = np.zeros(canvas.shape[1])
    count = np.zeros(canvas.shape[1])
    for _, wide, inside in _bands(canvas, samples):
        scene = np.array(canvas.opened()[0, :, wide])
        slopes = squared_slopes(scene, samples)[:, inside]
        total += np.nansum(slopes, axis=(1, 2))
        count += np.isfinite(slopes).sum(axis=(1, 2))
    return total / np.maximum(count, 1)


def localise(canvas: Canvas, samples: int, mean: Floats, factors: Floats) -> None:
    """Make the errors of a picture those by its slopes, times factors (colours,). mean: as of `localised`."""
    # a band's slopes are those of the scene, which stays
    for band, wide, inside in _bands(canvas, samples):
        layers = localised(np.array(canvas.opened()[:, :, wide]), samples, mean)
        of_band = canvas.opened()[1:, :, band]
        of_band[:] = layers[1:, :, inside]
        of_band[0] *= factors[:, None, None]


def tests_of(
    canvas: Canvas, job: Job, stiffness: float, mean: Floats, factors: Floats
) -> list[tuple[Job, Floats32]]:
    """Return photographs of parts of the restored scene made smaller, and the parts: the truth.

    Parameters
    ----------
    canvas, job : picture with errors as the penalty supposes, and what it was restored from
    stiffness : as of `Strength`
    mean : as of `localised`
    factors : (colours,) size of the random error of parts, relative to localised errors; 0 for none
    """
    rng = np.random.default_rng(TEST_SEED)
    found = []
    for area in _parts(job):
        down, right = (slice(job.samples * s.start, job.samples * s.stop) for s in area)
        layers = np.array(canvas.opened()[:, :, down, right])
        scene = layers[0]
        if factors.any() and (views := job.views(area)) is not None:
            local = localised(layers, job.samples, mean)[1] / layers[1]
            local *= factors.astype(np.float32)[:, None, None]
            error = random_error(views, job.coupling, stiffness, rng)
            scene = np.maximum(scene + local * error, 0)
        colours, rows, columns = scene.shape
        blocks = colours, rows // SMALLER, SMALLER, columns // SMALLER, SMALLER
        truth = scene.reshape(blocks).mean(axis=(2, 4))
        if np.isfinite(truth).all():
            found.append((_photographed(job, area, truth, rng), truth))
    return found


def _parts(job: Job) -> list[Area]:
    """Return squares of the photograph along its diagonals, in whole cells; none if too small."""
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


def ratios(layers: Floats32, truth: Floats32, samples: int, mean: Floats) -> Floats:
    """Return errors over standard errors (colours, samples) of a restored part, without its rim."""
    scene, std, _ = localised(layers, samples, mean)
    apart = np.abs(scene - truth) / std
    rims = (max(side // RIM, 1) for side in apart.shape[1:])
    down, right = (slice(rim, -rim) for rim in rims)
    return np.asarray(apart[:, down, right].reshape(len(apart), -1), float)


def calibrate_errors(
    canvas: Canvas,
    job: Job,
    stiffness: float,
    restored: Callable[[Sequence[Job]], Iterator[tuple[int, Floats32]]],
) -> None:
    """Make a picture's errors such that 68 % of a similar scene is within them.

    A photograph too small for a test keeps its errors' scale.

    Parameters
    ----------
    canvas, job : the picture, and its photographs
    stiffness : as of `Strength`
    restored : returns the layers of photographs, with their numbers
    """
    mean = mean_slopes(canvas, job.samples)
    factors = np.zeros(len(job.colours))
    for _ in range(TEST_ROUNDS):
        tests = tests_of(canvas, job, stiffness, mean, factors)
        if not tests:
            factors = np.ones(len(job.colours))
            break
        answers = restored([test for test, _ in tests])
        every = [ratios(part, tests[k][1], job.samples, mean) for k, part in answers]
        factors = np.quantile(np.concatenate(every, axis=1), ONE_STD, axis=1)
    localise(canvas, job.samples, mean, factors)
