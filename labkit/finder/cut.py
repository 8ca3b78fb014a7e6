"""Select the part of a photograph with the target, and measure the radiance of the target's surround."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.finder.registration import OWN_CORNERS, homography, mapped
from labkit.imaging.warp import Pose
from labkit.photographs.photograph import Cut
from labkit.types import Bools, Floats

MARGIN = 0.06
"""Surround that is kept around the target for the ambient light and the halo, in sizes of the target."""

MARGIN_PX = 10
"""The same, at least."""

INSET = 0.04
"""What is left out along the target's edge where the surround is unknown, in sizes of the target."""

INSET_PX = 4
"""The same, at least."""

DARK_PERCENT, LIGHT_PERCENT = 5, 95
"""Percentiles of a target's pixels that are its black and its white."""


def cut_within(corners: Sequence[Floats], shape: tuple[int, ...]) -> Cut:
    """Return rows and columns that quadrilaterals of corners (4, 2) span in all frames, starting at even ones."""
    return _even(np.concatenate(list(corners)), 0.0, shape)


def cut_around(corners: Sequence[Floats], shape: tuple[int, ...]) -> Cut:
    """Return rows and columns around the target in all frames, starting at even ones."""
    every = np.concatenate(list(corners))
    size = np.ptp(every, axis=0).max()
    return _even(every, max(MARGIN_PX, MARGIN * size), shape)


def _even(places: Floats, margin: float, shape: tuple[int, ...]) -> Cut:
    """Return rows and columns that places (n, 2) span with a margin, of even starts and sizes."""
    low = np.maximum(np.floor(places.min(axis=0) - margin), 0).astype(int) // 2 * 2
    high = np.minimum(np.ceil(places.max(axis=0) + margin).astype(int) + 1, shape)
    high -= (high - low) % 2
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))


def outline(corners: Floats, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return an image (rows, columns) that is 1 within corners (4, 2), row and column, and 0 elsewhere."""
    polygon = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(polygon, np.round(corners[:, ::-1]).astype(np.int32), 1)
    return polygon


def sees_no_neighbour(
    pose: Pose, clear_mm: float, size_mm: tuple[float, float], shape: tuple[int, ...]
) -> Bools:
    """Return the pixels that see a target of a grid, or the surround up to `clear_mm` around."""
    own_mm = OWN_CORNERS * size_mm
    by = homography(own_mm, pose.corners_px())
    return outline(mapped(by, own_mm + 2 * OWN_CORNERS * clear_mm), shape) > 0


def sees_target_only(pose: Pose, shape: tuple[int, ...]) -> Bools:
    """Return the mask of the pixels that see the target only."""
    corners = pose.corners_px()
    inset = int(np.ceil(max(INSET_PX, INSET * np.ptp(corners, axis=0).max())))
    framed = cv2.copyMakeBorder(outline(corners, shape), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    eroded = cv2.erode(
        framed,
        np.ones((2 * inset + 1, 2 * inset + 1), np.uint8),
        borderType=cv2.BORDER_REPLICATE,
    )
    return np.asarray(eroded[1:-1, 1:-1] > 0)


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
