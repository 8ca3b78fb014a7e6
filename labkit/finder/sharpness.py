"""Measure the sharpness of a photograph: its steepest edges, and the blur of a known target."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.errors import TargetError
from labkit.finder.picture import Picture, grey_image
from labkit.finder.registration import neighbourhood
from labkit.photographs.photograph import WHOLE, Cut, Photograph, overlap
from labkit.target.target import Target
from labkit.types import Floats

FINEST_PX, BLUR_FACTOR = 0.8, 1.15
"""Blur circles are tried from this diameter on, each larger than the last by this factor."""

LIT_CELLS = 200
"""Across a photograph, when its lit part is looked for."""

MOST_LIT_ROWS = 1024
"""Of the lit part, about its middle: a photograph of 24 million pixels is then looked at within a second."""

LARGEST_SHARE = 0.3
"""Of the target's side: a larger blur leaves no structure."""

BLUR_SIDE = 500
"""Pixels across the target at most when the blur is measured; a blur that matters is wide in a larger picture too."""


def sharpest_edge_px(mosaic: Photograph, place: Cut = WHOLE) -> float | None:
    """Return edge_px of the lit part of a photograph; None for a nearly even image, such as a flat.

    place: rows and columns with the target, from even ones on, where they are known: the sharpest edges beside it are at
    other ranges.
    """
    part = _lit_part(mosaic, overlap(place, mosaic.box))
    try:
        return edge_px(grey_image(part.light, part.pattern))
    except TargetError:
        return None


def edge_px(image: ArrayLike) -> float:
    """Return the rise of the sharpest edges in pixels: contrast over the steepest slope.

    The least value is 2.6, or 3.2 with colour filters. The steepest slope is a quantile,
    exceeded by as many pixels as lie along two sides of the image: a target has longer
    edges, and noise does not count. image: (rows, cols) grey, such as from `grey_image`,
    filled by a target.
    """
    grey = cv2.GaussianBlur(np.asarray(image, dtype=np.float32), (0, 0), 0.7)
    slope = np.hypot(
        cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8),
        cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8),
    )
    low, high = np.percentile(grey, (1, 99))
    edge_pixels = min(2 * min(grey.shape), slope.size)
    return float(
        (high - low)
        / max(float(np.partition(slope, -edge_pixels, axis=None)[-edge_pixels]), 1e-9)
    )


def _lit_part(mosaic: Photograph, cut: Cut) -> Photograph:
    """Return the box around a cut's pixels brighter than halfway, and a margin, from even to even rows and columns."""
    counts = mosaic.counts[mosaic.slices(cut, mosaic.box)]
    rows, cols = (side.stop - side.start for side in cut)
    cell = max(2, len(mosaic.pattern))  # what begins elsewhere has other colours
    step = max(1, max(rows, cols) // LIT_CELLS // cell) * cell
    coarse = cv2.resize(
        counts.reshape(rows, cols, -1),
        (max(1, cols // step), max(1, rows // step)),
        interpolation=cv2.INTER_AREA,
    )
    if coarse.ndim == 3:
        coarse = coarse.mean(axis=2)
    bright = (
        coarse.astype(np.float64)
        >= (float(np.percentile(coarse, 5)) + float(coarse.max())) / 2
    )

    def span(along: NDArray[np.intp], size: int) -> tuple[int, int]:
        return max(0, int(along.min() - 1) * step), min(
            size // 2 * 2, int(along.max() + 3) * step
        )

    along_rows, along_cols = np.nonzero(bright)
    (top, bottom), (left, right) = span(along_rows, rows), span(along_cols, cols)
    spare = max(0, bottom - top - MOST_LIT_ROWS) // 2 // cell * cell
    lit = slice(top + spare, bottom - spare), slice(left, right)
    return replace(
        mosaic, counts=counts[mosaic.slices(lit, (slice(0, rows), slice(0, cols)))]
    )


def blur_px(
    image: ArrayLike | Photograph | Picture, target: Target, corners: Floats
) -> float:
    """Return the diameter in pixels of the blur circle at which the rendered target agrees best with the image.

    image, corners: as `find_target` takes and returns them. The diameter is right
    within about a third; below two pixels, lens and pixels themselves blur as much. Out of
    focus the circle is the pupil's shadow, thesis (E.9).
    """
    side = float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))
    near, at, factor = neighbourhood(Picture.of(image), corners, BLUR_SIDE)
    scale = min(1.0 / factor, BLUR_SIDE / side)
    rows, cols = (
        max(9, round(side * scale * side_mm / float(np.mean(target.size_mm))))
        for side_mm in target.size_mm
    )
    straightened = _straightened(near, at, rows, cols)
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * target.size_mm[0]
    x = ((np.arange(cols) + 0.5) / cols - 0.5) * target.size_mm[1]
    sharp = target.sample(y, x, 0.4 * rows / target.size_mm[0]).astype(np.float32)
    count = max(
        2, round(np.log(LARGEST_SHARE * min(rows, cols) / FINEST_PX) / np.log(BLUR_FACTOR))
    )
    diameters = FINEST_PX * BLUR_FACTOR ** np.arange(count)
    agreement = [
        _correlation(straightened, _out_of_focus(sharp, float(diameter)))
        for diameter in diameters
    ]
    return float(diameters[int(np.argmax(agreement))]) / scale


def _straightened(
    image: NDArray[np.float32], corners: Floats, rows: int, cols: int
) -> NDArray[np.float32]:
    """Return the target's part of an image on a regular grid."""
    grid = np.array(
        [[-0.5, -0.5], [cols - 0.5, -0.5], [cols - 0.5, rows - 0.5], [-0.5, rows - 0.5]],
        dtype=np.float32,
    )
    at = np.ascontiguousarray(corners[:, ::-1], dtype=np.float32)
    warped = cv2.warpPerspective(
        image, cv2.getPerspectiveTransform(at, grid), (cols, rows), flags=cv2.INTER_AREA
    )
    return np.asarray(warped, dtype=np.float32)


def _out_of_focus(image: NDArray[np.float32], diameter: float) -> NDArray[np.float32]:
    """Return an image blurred by a disc of a diameter, drawn eight times finer than the pixels."""
    reach = int(np.ceil(diameter / 2))
    fine = np.arange(-8 * reach - 3.5, 8 * reach + 4) / 8
    disc = (np.hypot(fine[:, None], fine[None, :]) <= diameter / 2).astype(np.float32)
    kernel = disc.reshape(2 * reach + 1, 8, 2 * reach + 1, 8).sum(axis=(1, 3))
    return np.asarray(
        cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
