"""Motions between photographs of the same scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy import ndimage

from labkit.errors import DataError
from labkit.restoration.job import Area, Exposure, Job, middle_of
from labkit.restoration.kriging import Kriging, Stiffness
from labkit.restoration.views import Views
from labkit.types import AnyComplexes, Floats, Floats32

MOST_SEARCH_STEPS, SEARCH_TOLERANCE = 200, 1e-7  # of the search
SMOOTH_CELLS = 5  # width of the filter that noise and aliases are taken off by
MOTION_SAMPLES, MIDDLE_PX = (
    4,
    192,
)  # samples a pixel, and pixels, that motions are estimated with
SOFT_PENALTY, REGISTERED_LONGEST_PX = 1e-3, 120.0  # of the penalty meanwhile
USUAL_TURN = 2e-4  # of frames taken one after the other, standard deviation
MOST_TURN = 0.02  # of a motion that tiles take as shifts: rows and columns that turn or grow by more, a pixel in fifty


def registered(
    first: Exposure,
    other: Exposure,
    period: int,
    places: Sequence[tuple[int, int]] | None = None,
) -> Floats:
    """Return the motion (2, 3) of a photograph from the first one, see `Exposure`: a shift, by correlation of grey cells.

    places: of the cell's pixels to compare, all by default. It is right to some tenths of a pixel, since cells alias:
    `refined` goes on from there. G. Evangelidis and E. Psarakis, IEEE Trans. PAMI 30, 1858 (2008). Raises DataError where
    they do not show the same.
    """
    places = places or [(row, column) for row in range(period) for column in range(period)]
    one, two = _grey(first, period, places), _grey(other, period, places)
    begin, whole = np.eye(2, 3, dtype=np.float32), np.ones(two.shape, np.uint8)
    shift, _ = cv2.phaseCorrelate(
        one, two, cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    )
    begin[:, 2] = shift
    criteria = (
        cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT,
        MOST_SEARCH_STEPS,
        SEARCH_TOLERANCE,
    )
    try:
        _, warp = cv2.findTransformECC(
            one, two, begin, cv2.MOTION_TRANSLATION, criteria, whole, SMOOTH_CELLS
        )
    except cv2.error:
        raise DataError(
            "two photographs do not show the same scene: restore them apart"
        ) from None
    turned = np.asarray(warp, float)[::-1, [1, 0, 2]]  # rows before columns
    motion = turned - np.eye(2, 3)
    return np.asarray(motion * period)


def refined(job: Job) -> Job:
    """Return the job with the motions under which the first photograph, restored, best predicts the others, then all of them.

    Gauss-Newton steps of six numbers a photograph; what of the scene is not known passes for noise. Raises DataError for one
    turned or grown against the first by more than tiles can follow.
    """
    if len(job.photographs) == 1:
        return job
    area = _middle(job)
    coarse = job.of_samples(min(MOTION_SAMPLES, job.nyquist_samples))
    for known in (1, 1, *2 * [len(job.photographs)]):
        views = replace(coarse, photographs=coarse.photographs[:known]).views(area)
        if views is None:
            return job
        scene = _scene(views, coarse)
        moved = [
            replace(p, motion=p.motion + _step(coarse, p, area, scene))
            for p in coarse.photographs[1:]
        ]
        coarse = replace(coarse, photographs=(coarse.photographs[0], *moved))
    for photograph in coarse.photographs:
        if (turn := float(np.abs(photograph.motion[:, :2]).max())) > MOST_TURN:
            raise DataError(
                f"one photograph is turned or grown against the first by {turn:.2g}; at most {MOST_TURN:g}: restore them apart"
            )
    return coarse.of_samples(job.samples)


def _scene(views: Views, job: Job) -> AnyComplexes:
    """Return half planes of the scene without the bound, under a penalty about as strong as a chosen one."""
    levels = views.levels()
    means = views.flat(levels)
    weights = views.weights(means)
    density = sum(float(w.mean()) for w in weights) / len(job.photographs) / job.period**2
    rough = SOFT_PENALTY * density / (np.pi / 2) ** 2 / job.samples**2
    kriging = Kriging(
        views,
        Stiffness(
            views.grid,
            job.coupling,
            rough,
            rough * (2 * np.pi / REGISTERED_LONGEST_PX) ** 2,
        ),
        weights,
    )
    spectra = kriging.scene(kriging.solve(views.counts - means))
    size = views.grid.shape[0] * views.grid.shape[1]
    spectra[:, 0, 0] += (levels * size).astype(np.float32)
    return spectra


def _step(job: Job, photograph: Exposure, area: Area, scene: AnyComplexes) -> Floats:
    """Return the change (2, 3) of a photograph's motion."""
    views = replace(job, photographs=(photograph,)).views(area)
    if views is None:
        return np.zeros((2, 3))
    grid, half = views.grid, max(views.grid.frame) / 2
    centre = np.array(middle_of(area))
    normal = np.diag(np.tile([1.0, 1.0, 0.0], 2) / (half * USUAL_TURN) ** 2)
    right = -normal @ (half * photograph.motion).ravel()
    turns = [(-2j * np.pi * w).astype(np.complex64) for w in grid.frequencies]
    for view, mean in zip(views, views.means(scene), strict=True):
        spectrum = scene[view.component]
        slopes = [
            view.light * grid.sample(turn * spectrum * view.transfer) for turn in turns
        ]
        rows, columns = (
            (np.arange(n) * grid.period + p + part.start - c) / half
            for n, p, part, c in zip(mean.shape, view.place, area, centre, strict=True)
        )
        places = np.broadcast_arrays(rows[:, None], columns, np.ones(mean.shape))
        design = np.array([slope * place for slope in slopes for place in places])
        apart = view.counts - mean
        left = float(np.mean(apart[view.used] ** 2))
        weight = np.where(view.used, 1 / (view.expected(mean).variance + left), 0.0)
        normal += np.einsum("irc,jrc,rc->ij", design, design, weight)
        right += np.einsum("irc,rc,rc->i", design, apart, weight)
    normal += 1e-9 * np.trace(normal) * np.eye(6)
    change = np.linalg.solve(normal, right).reshape(2, 3)
    change[:, :2] /= half
    change[:, 2] -= change[:, :2] @ centre
    return np.asarray(change)


def _middle(job: Job) -> Area:
    """Return the middle of the photographs, in whole cells, as large as useful."""
    sides = [min(side, MIDDLE_PX) // job.period * job.period for side in job.shape]
    rows, columns = (
        (side - part) // 2 // job.period * job.period
        for side, part in zip(job.shape, sides, strict=True)
    )
    return slice(rows, rows + sides[0]), slice(columns, columns + sides[1])


def _grey(photograph: Exposure, period: int, places: Sequence[tuple[int, int]]) -> Floats32:
    """Return means over cells, gaps filled from around, on a scale of 0 to 1."""
    rows, columns = (side // period for side in photograph.counts.shape)
    cells, known = np.zeros((rows, columns)), np.zeros((rows, columns))
    for row, column in places:
        plane = slice(row, None, period), slice(column, None, period)
        light = photograph.counts[plane] / np.maximum(photograph.light[plane], 1e-3)
        cells += np.where(photograph.used[plane], light, 0.0)
        known += photograph.used[plane] / len(places)
    cells /= len(places)
    near, share = (ndimage.gaussian_filter(each, 2.0) for each in (cells, known))
    grey = np.where(known > 1 - 1e-9, cells, near / np.maximum(share, 1e-3))
    return np.asarray((grey - grey.min()) / max(np.ptp(grey), 1e-9), np.float32)
