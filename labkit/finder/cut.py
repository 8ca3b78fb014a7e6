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
"""Surround kept around the target for the ambient light and the halo, in sizes of the target."""

MARGIN_PX = 10
"""The same, at least."""

INSET = 0.04
"""What is left out along the target's edge where the surround is unknown, in sizes of the target."""

INSET_PX = 4
"""The same, at least."""

DARK_PERCENT, LIGHT_PERCENT = 5, 95
"""Percentiles of a target's pixels that are its black and its white."""

MOST_DEPARTING, MOST_DEPARTING_RMS, MOST_DEPARTING_STDS = 0.006, 0.0008, 5.0
"""Departure of a clean surround from even light and the target's halo: at the most and in the mean, of the target's range; and
of its noise. Over 150 photographs of 16 lenses, to 2.5 waves out of focus, clean ones had 0.004 and 0.0004 at the most; behind
a mirror's vanes, whose halo is a cross, 0.007 and 0.0011."""

MOST_LIGHTER = 0.1
"""How much lighter than the target's darkest parts a clean black surround may be, of the target's range: where light falls off
over the target, so does what a printed black reflects."""

LIGHT_DEGREE, HALO_STDS = 2, (0.5, 1.0, 2.0)
"""What a clean surround is made of: a polynomial in row and column, and the target's light, blurred by these widths of the edge
left out."""

AVERAGED_SHARE, AVERAGED_PX = 0.04, 5
"""Side of the squares over which a surround is averaged, in sizes of the target; and the same at least."""

LEAST_AROUND = 30
"""Pixels of a surround that say something of it, and of a square averaged a tenth of these."""


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
    around = _around(corners, light.shape) & used
    levels = _levels(light, used, corners)
    if levels is None or not around.any():
        return None
    dark, bright = levels
    return float((np.median(light[around]) - dark) / (bright - dark))


def _edge_px(corners: Floats) -> int:
    """Return the width of the blurred edge of a target, pixels: half of the margin kept."""
    return round(max(MARGIN_PX, MARGIN * float(np.ptp(corners, axis=0).max())) / 2)


def _around(corners: Floats, shape: tuple[int, ...]) -> Bools:
    """Return the mask of the pixels around a target, without the blur of its edge."""
    gap = _edge_px(corners)
    near = cv2.dilate(
        outline(corners, shape), np.ones((2 * gap + 1, 2 * gap + 1), np.uint8)
    )
    return np.asarray(near == 0)


def _levels(light: Floats, used: Bools, corners: Floats) -> tuple[float, float] | None:
    """Return how light a target's black and its white are; None if no pixel sees it, or it has no contrast."""
    target = light[(outline(corners, light.shape) > 0) & used]
    if not target.size:
        return None
    dark, bright = np.percentile(target, (DARK_PERCENT, LIGHT_PERCENT))
    return (float(dark), float(bright)) if bright > dark else None


def is_surround_even(
    light: Floats, used: Bools, pose: Pose, surround: float, variance: Floats
) -> bool:
    """Return whether what is around a target is of one radiance, but for the target's halo and smooth light.

    Parameters
    ----------
    light, used, pose : as of `surround_level`
    surround : 0 for the target's black, 1 for its white
    variance : (rows, columns) of the light, at most
    """
    corners = pose.corners_px()
    around = _around(corners, light.shape) & used
    levels = _levels(light, used, corners)
    if levels is None or np.count_nonzero(around) < LEAST_AROUND:
        return True
    dark, bright = levels
    length = np.ptp(corners, axis=0).max()
    side = max(AVERAGED_PX, 2 * round(AVERAGED_SHARE * length / 2) + 1)
    count = _summed(np.ones(light.shape), around, side)
    departures = light - _clean_surround(light, used, around, corners)
    seen = count > LEAST_AROUND / 10
    noise, departure, lighter = (
        _summed(values, around, side)[seen] / count[seen]
        for values in (variance, departures, light - dark)
    )
    noise /= count[seen]
    most = np.maximum(
        MOST_DEPARTING * (bright - dark), MOST_DEPARTING_STDS * np.sqrt(noise)
    )
    # an even one may still be a bezel all around
    is_lighter = surround == 0 and bool(np.any(lighter > MOST_LIGHTER * (bright - dark)))
    if is_lighter or np.any(np.abs(departure) > most):
        return False
    return bool(
        np.mean(departure**2) < (MOST_DEPARTING_RMS * (bright - dark)) ** 2 + np.mean(noise)
    )


def _summed(values: Floats, where: Bools, side: int) -> Floats:
    """Return sums over the pixels of a mask in squares about each pixel."""
    return np.asarray(
        cv2.boxFilter(
            np.where(where, values, 0.0),
            cv2.CV_64F,
            (side, side),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
    )


def _clean_surround(light: Floats, used: Bools, around: Bools, corners: Floats) -> Floats:
    """Return the light of a clean surround, by least squares over the pixels `around`."""
    own = np.where((outline(corners, light.shape) > 0) & used, light, 0.0)
    halos = [
        cv2.GaussianBlur(
            own, (0, 0), std * _edge_px(corners), borderType=cv2.BORDER_CONSTANT
        )
        for std in HALO_STDS
    ]
    y, x = (np.linspace(-1, 1, n) for n in light.shape)
    down, right = np.meshgrid(y, x, indexing="ij")
    powers = np.polynomial.legendre.legvander2d(down, right, (LIGHT_DEGREE, LIGHT_DEGREE))
    terms = np.concatenate((powers, np.stack(halos, axis=2)), axis=2)
    fitted = np.linalg.lstsq(terms[around], light[around], rcond=None)[0]
    return np.asarray(terms @ fitted)
