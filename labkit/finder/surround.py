"""Measure the surround's radiance in photographs, relative to the target's black and white."""

from __future__ import annotations

import cv2
import numpy as np

from labkit.finder.cut import MARGIN, MARGIN_PX, outline
from labkit.imaging.warp import Pose
from labkit.types import Bools, Floats

DARK_PERCENT, LIGHT_PERCENT = 5, 95
"""Percentiles of a target's pixels that are its black and its white."""


def surround_level(light: Floats, used: Bools, pose: Pose) -> float | None:
    """Return the surround's relative radiance.

    Parameters
    ----------
    light : (rows, columns), counts over relative illumination
    used : (rows, columns) mask of the usable pixels
    pose : of the target in these rows and columns

    Returns
    -------
    0 for the target's black, 1 for its white; None if no pixel sees the surround, or the
    target has no contrast
    """
    corners = pose.corners_px()
    inside = outline(corners, light.shape)
    # half of the margin that is kept: the blur of the target's edge is left out
    gap = round(max(MARGIN_PX, MARGIN * np.ptp(corners, axis=0).max()) / 2)
    near = cv2.dilate(inside, np.ones((2 * gap + 1, 2 * gap + 1), np.uint8))
    target = light[(inside > 0) & used]
    around = light[(near == 0) & used]
    if not (target.size and around.size):
        return None
    dark, bright = np.percentile(target, (DARK_PERCENT, LIGHT_PERCENT))
    if bright <= dark:
        return None
    return float((np.median(around) - dark) / (bright - dark))
