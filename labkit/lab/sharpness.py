"""How sharp a photograph is: by its steepest edges, and by how much blur a known target has taken."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.target import Target

Floats = NDArray[np.float64]

FINEST_PX, STEP = 0.8, 1.15
"""Blur circles are tried from this diameter on, each larger than the last by this factor."""

LARGEST_SHARE = 0.3
"""Of the target's side: a larger blur leaves nothing to be told apart."""

WORKING_SIDE = 500
"""Pixels across the target at most when the blur is told; a blur worth telling is wide in a larger picture too."""


def edge_px(image: ArrayLike) -> float:
    """Pixels over which the sharpest edges rise: contrast over the steepest slope. 1 at best; large without edges.

    image: (rows, cols) grey, such as from `grey_image`.
    """
    grey = cv2.GaussianBlur(np.asarray(image, dtype=np.float32), (0, 0), 0.7)
    slope = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8))
    low, high = np.percentile(grey, (1, 99))
    return float((high - low) / max(float(np.percentile(slope, 99.8)), 1e-9))


def blur_px(image: ArrayLike, target: Target, corners: Floats) -> float:
    """Diameter in pixels of the blur circle with which the rendered target agrees best with the picture of it.

    image: (rows, cols) grey; corners: (4, 2) from `find_target`. Within about a third; what is below two pixels is
    the lens's and the pixels' own. Out of focus the circle is the pupil's shadow, thesis (E.9).
    """
    side = float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))
    scale = min(1.0, WORKING_SIDE / side)
    rows, cols = (max(9, round(side * scale * one / float(np.mean(target.size_mm)))) for one in target.size_mm)
    seen = _straightened(np.asarray(image, dtype=np.float32), corners, rows, cols)
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * target.size_mm[0]
    x = ((np.arange(cols) + 0.5) / cols - 0.5) * target.size_mm[1]
    sharp = target.sample(y, x, 0.4 * rows / target.size_mm[0]).astype(np.float32)
    count = max(2, round(np.log(LARGEST_SHARE * min(rows, cols) / FINEST_PX) / np.log(STEP)))
    diameters = FINEST_PX * STEP ** np.arange(count)
    agreement = [_correlation(seen, _out_of_focus(sharp, float(diameter))) for diameter in diameters]
    return float(diameters[int(np.argmax(agreement))]) / scale


def _straightened(image: NDArray[np.float32], corners: Floats, rows: int, cols: int) -> NDArray[np.float32]:
    """The target's part of a picture on a regular grid of its own."""
    grid = np.array([[-0.5, -0.5], [cols - 0.5, -0.5], [cols - 0.5, rows - 0.5], [-0.5, rows - 0.5]], dtype=np.float32)
    at = np.ascontiguousarray(corners[:, ::-1], dtype=np.float32)
    warped = cv2.warpPerspective(image, cv2.getPerspectiveTransform(at, grid), (cols, rows), flags=cv2.INTER_AREA)
    return np.asarray(warped, dtype=np.float32)


def _out_of_focus(image: NDArray[np.float32], diameter: float) -> NDArray[np.float32]:
    """An image under a disc of that diameter, drawn eight times finer than its pixels."""
    reach = int(np.ceil(diameter / 2))
    fine = np.arange(-8 * reach - 3.5, 8 * reach + 4) / 8
    disc = (np.hypot(fine[:, None], fine[None, :]) <= diameter / 2).astype(np.float32)
    kernel = disc.reshape(2 * reach + 1, 8, 2 * reach + 1, 8).sum(axis=(1, 3))
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
