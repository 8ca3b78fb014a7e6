"""Find the target in an image without help: the start of every fit (thesis §2.4.2).

Hypotheses come from a carpet's nested squares, or from correlation over scale and rotation.
Registration with the rendered target refines each; a hypothesis is accepted only if the
image agrees with the target everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.finder.carpet_squares import central_square, square_hypotheses
from labkit.finder.registration import (
    HOPELESS,
    Agreement,
    parent_agreement,
    quick_agreement,
    register,
)
from labkit.finder.template_search import SCALE_STEP, swept_hypotheses
from labkit.plan.sensor import IN_COLOURS
from labkit.target import Target
from labkit.types import Floats

Singles = NDArray[np.float32]

LEAST_AGREEMENT = 0.6
"""Least correlation of a picture with the rendered target, for the whole target and for the median of 3×3 parts; the worst
part needs half. Pictures of other objects stay below 0.4, targets out of focus above 0.9."""

CLEAR_AGREEMENT, BEYOND_DOUBT = 0.9, 0.97
"""Least correlation of a target partly outside the frame, and of a better pose. A smaller whole carpet reaches 0.94 on a
carpet partly outside the frame; a carpet far out of focus has 0.98 and more."""

SCALE_TOLERANCE = 0.15
"""How far `mm_per_pixel` may be off."""

LEAST_TARGET_SIDE_PX = 12.0
"""A quadrilateral with a shorter side is a sliver: stretched, any edge of a picture looks like a target far out of focus.
The sweep looks for targets of 16 pixels and more; registration may shrink one by a quarter of that."""

MOST_HYPOTHESES = 12

MOST_OUTSIDE = 0.05
"""Largest share of a target's side outside the frame, where the drawing is known and modelled."""

LEAST_TARGET_CONTRAST = 1.3
"""Bright over dark, below which a picture shows no target. Prints have 5 at the least; an even panel stays below 1.2,
and stretched to black and white its fading corners look like a small carpet far out of focus."""


def margin_px(corners: Floats, shape: tuple[int, ...]) -> float:
    """Return the distance of a target's corners (4, 2) from the frame's edge; negative outside."""
    last = np.array(shape) - 0.5
    return -max(float(np.max(-0.5 - corners)), float(np.max(corners - last)))


def find_target(
    image: ArrayLike, target: Target, *, mm_per_pixel: float | None = None
) -> Floats:
    """Return the target's four corners in an image, to about half a pixel.

    If several poses look the same (a carpet has eight), the pose of least rotation is
    returned.

    Parameters
    ----------
    image : (rows, cols) grey, linear or nearly so, any scale and offset; NaN where there is
        no value; `grey_image` makes it from a mosaic
    target : the target
    mm_per_pixel : millimetres on the target for each pixel, within 15 %; not needed for a
        carpet, faster for other targets

    Returns
    -------
    (4, 2) corners (row, col), pixel centres at integers, in the order of the target's own
    (0, 0), (0, w), (h, w), (h, 0)

    Raises
    ------
    TargetError
        the target is not in the frame, or outside by more than 5 % of its side
    """
    picture = prepared(image)
    agreements: list[Agreement] = []
    complaints: list[TargetError] = []
    for start in _hypotheses(picture, target, mm_per_pixel):
        corners, agreement = register(picture, target, start)
        if not is_target_shaped(corners):
            continue
        agreements.append(agreement)
        if not (believable(agreement) and right_scale(corners, target, mm_per_pixel)):
            continue
        if complaints and agreement.whole < BEYOND_DOUBT:
            continue
        try:
            return _checked(picture, target, corners)
        except TargetError as complaint:  # of a blurred picture a wrong pose may be believed: there may be a better one
            complaints.append(complaint)
            if agreement.whole > CLEAR_AGREEMENT:
                break
    if complaints:
        raise complaints[0]
    best = max(
        (min(a.whole, a.median_part, 2 * a.least_part) for a in agreements), default=0.0
    )
    raise TargetError(
        f"no target found in the frame: the likeliest place correlates {best:.2f} with it, "
        f"{LEAST_AGREEMENT:g} is needed; check [target] in the plan, focus and light, or give its corners_px"
    )


def grey_image(counts: ArrayLike, pattern: Sequence[str]) -> Floats:
    """Return a grey image, about 0..1, of a mosaic, in the mosaic's pixels.

    Each plane of the cell is scaled to its own range. The binomial filter over neighbours
    then removes the rest of the mosaic without a shift. A picture in colours, ("RGB",) with
    counts (rows, 3 cols), becomes the mean of each pixel's three. counts: (rows, cols),
    black removed; pattern: the colour filter's cell, such as ("RG", "GB"), or ("M",).
    Raises TargetError for a nearly even image.
    """
    mosaic = _picture("counts", counts)
    height, width = len(pattern), len(pattern[0])
    if mosaic.shape[0] < height or mosaic.shape[1] < width:
        raise ValueError(
            f"counts has shape {mosaic.shape}; at least one cell of the filter, {(height, width)}, is needed"
        )
    grey = np.empty_like(mosaic)
    contrast = 0.0
    for row in range(height):
        for col in range(width):
            plane = mosaic[row::height, col::width]
            grey[row::height, col::width] = _normalised(plane)
            dark, bright = np.nanpercentile(plane, (0.5, 99.5))
            contrast = max(contrast, bright / dark if dark > 0 else np.inf)
    if contrast < LEAST_TARGET_CONTRAST:
        raise TargetError(
            f"no target found in the frame: it is nearly even, bright parts {contrast:.2f} times as bright as dark ones; "
            "is the target shown, or white?"
        )
    if height * width == 1:
        return grey
    if pattern == IN_COLOURS:
        return np.asarray(grey.reshape(grey.shape[0], -1, width).mean(axis=2))
    kernel = np.array([0.25, 0.5, 0.25])
    return np.asarray(
        cv2.sepFilter2D(grey, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101),
        dtype=np.float64,
    )


def prepared(image: ArrayLike) -> Singles:
    """Return an image as the search takes it: black about 0, white about 1, without hot pixels and gaps.

    Raises TargetError for an image without contrast or pixels.
    """
    return _normalised(_picture("image", image))


def _picture(name: str, value: ArrayLike) -> Floats:
    """Return an image as float64, with NaN where there is no value."""
    real_array(
        name,
        np.nan_to_num(value) if np.asarray(value).dtype.kind == "f" else value,
        (None, None),
        "any scale",
    )
    return np.asarray(value, dtype=np.float64)


def _normalised(image: Floats) -> Singles:
    """Return an image with black about 0, white about 1 and hot pixels clipped.

    Raises TargetError for an image without contrast or pixels.
    """
    if image.ndim != 2 or min(image.shape) < 8 or not np.isfinite(image).any():
        raise TargetError(
            f"no target found in the frame: it has no pixels to look at (shape {image.shape})"
        )
    low, high = np.nanpercentile(image, (0.5, 99.5))
    if not high > low:
        raise TargetError(
            "no target found in the frame: it is of one grey all over; check exposure and lens cap"
        )
    scaled = np.clip((image - low) / (high - low), -0.2, 1.2)
    return np.asarray(
        np.where(np.isfinite(scaled), scaled, np.nanmedian(scaled)), dtype=np.float32
    )


def _hypotheses(
    picture: Singles, target: Target, mm_per_pixel: float | None
) -> Iterator[Floats]:
    """Yield starts for the registration: from squares first, if the target has them, then from the sweep."""
    starts: Iterator[Floats] = iter(())
    fraction = central_square(target)
    if fraction is not None:
        likely = (
            corners
            for corners in square_hypotheses(picture, fraction)
            if right_scale(corners, target, mm_per_pixel, slack=2.0)
            and quick_agreement(picture, target, corners) > HOPELESS
        )
        starts = islice(likely, MOST_HYPOTHESES)
    return chain(starts, swept(picture, target, mm_per_pixel))


def swept(picture: Singles, target: Target, mm_per_pixel: float | None) -> Iterator[Floats]:
    """Yield the likeliest places of any target, by correlation over scale, rotation and position."""
    if mm_per_pixel is not None:
        middle = target.size_mm[0] / mm_per_pixel
        low, high = middle * (1 - SCALE_TOLERANCE), middle * (1 + SCALE_TOLERANCE)
    else:
        shape = np.array(picture.shape) / np.array(target.size_mm) * target.size_mm[0]
        low, high = max(16.0, 0.15 * shape.min()), 1.1 * shape.min()
    steps = max(1, round(np.log(high / low) / np.log(SCALE_STEP)))
    yield from swept_hypotheses(picture, target, np.geomspace(low, high, steps + 1))


def believable(agreement: Agreement) -> bool:
    """Return whether a picture agrees with the target everywhere."""
    return (
        min(agreement.whole, agreement.median_part, 2 * agreement.least_part)
        >= LEAST_AGREEMENT
    )


def is_target_shaped(corners: Floats) -> bool:
    """Return whether a quadrilateral is convex, and no sliver."""
    shortest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min())
    return shortest >= LEAST_TARGET_SIDE_PX and cv2.isContourConvex(
        corners.astype(np.float32)
    )


def right_scale(
    corners: Floats, target: Target, mm_per_pixel: float | None, slack: float = 1.3
) -> bool:
    """Return whether a target's size agrees with the scale, if that is known."""
    if mm_per_pixel is None:
        return True
    ratio = (
        np.linalg.norm(corners[0] - corners[2]) * mm_per_pixel / np.hypot(*target.size_mm)
    )
    tolerance = 1 + slack * SCALE_TOLERANCE
    return bool(1 / tolerance < ratio < tolerance)


def _checked(picture: Singles, target: Target, corners: Floats) -> Floats:
    """Return the corners if they belong to the whole target and are nearly inside the frame."""
    beyond = -margin_px(corners, picture.shape)
    if beyond > MOST_OUTSIDE * np.ptp(corners, axis=0).max():
        raise TargetError(
            f"the target reaches {beyond:.0f} pixels out of the frame: move it, or the camera, back in"
        )
    if (
        central_square(target) is not None
        and parent_agreement(picture, target, corners) > LEAST_AGREEMENT
    ):
        raise TargetError(
            "only a part of the target is in the frame: move it, or the camera, back in"
        )
    return corners
