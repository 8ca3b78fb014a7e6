"""Where photographs of one scene stand beside one another."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from labkit.errors import DataError
from labkit.restoration.job import Photograph
from labkit.types import Floats, Floats32

MOST_STEPS, ENOUGH = 200, 1e-7  # of the search
SMOOTH_CELLS = 5  # width of the filter that noise and aliases are taken off by
MOST_TURN = 0.02  # of a motion that tiles take as shifts: rows and columns that turn or grow by more, a pixel in fifty


def registered(first: Photograph, other: Photograph, period: int) -> Floats:
    """(2, 3) motion of a photograph beside the first, as `Photograph.motion` has it; affine, by correlation of grey cells.

    G. Evangelidis and E. Psarakis, IEEE Trans. PAMI 30, 1858 (2008). Raises DataError where they do not show the same, or one
    is turned against the other by more than tiles can follow.
    """
    one, two = _grey(first, period), _grey(other, period)
    begin = np.eye(2, 3, dtype=np.float32)
    shift, _ = cv2.phaseCorrelate(one, two, cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F))
    begin[:, 2] = shift
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, MOST_STEPS, ENOUGH)
    try:
        _, warp = cv2.findTransformECC(one, two, begin, cv2.MOTION_AFFINE, criteria, None, SMOOTH_CELLS)
    except cv2.error:
        raise DataError("two photographs do not show the same scene: restore them apart") from None
    turned = np.asarray(warp, float)[::-1, [1, 0, 2]]  # rows before columns
    motion = turned - np.eye(2, 3)
    if np.abs(motion[:, :2]).max() > MOST_TURN:
        raise DataError(
            f"one photograph is turned or grown against the other by {np.abs(motion[:, :2]).max():.2g}; at most {MOST_TURN:g}: "
            "restore them apart"
        )
    middle = (period - 1) / 2
    motion[:, 2] = period * motion[:, 2] - motion[:, :2] @ np.full(2, middle)
    return np.asarray(motion)


def _grey(photograph: Photograph, period: int) -> Floats32:
    """Sums over cells, gaps filled from around, on a scale of 0 to 1."""
    counts = np.where(photograph.used, photograph.counts / np.maximum(photograph.light, 1e-3), 0.0)
    rows, columns = (side // period for side in counts.shape)
    cells = counts.reshape(rows, period, columns, period).sum(axis=(1, 3))
    share = photograph.used.reshape(rows, period, columns, period).mean(axis=(1, 3))
    around = ndimage.gaussian_filter(cells, 2.0) / np.maximum(ndimage.gaussian_filter(share, 2.0), 1e-3)
    grey = np.where(share == 1, cells, around)
    return np.asarray((grey - grey.min()) / max(np.ptp(grey), 1e-9), np.float32)
