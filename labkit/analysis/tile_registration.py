"""Register a part of a large target in a photograph: a lens's distortion moves it away from where the corners say it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.analysis.target_tiles import TargetPart
from labkit.field.tile_bend import bend_of, lens_distortion
from labkit.field.tile_places import PartsOfTarget, TilePlace
from labkit.imaging.warp import Pose
from labkit.key import Key
from labkit.optics.field import FieldFrame
from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import IN_COLOURS
from labkit.target.target import Target
from labkit.types import Counts, Floats, Floats32

Ints = NDArray[np.intp]

REACH = 0.02
"""Of the target's side, by which distortion may move a part: barrel distortion of 5 % moves the middle of a side by as much."""

REACH_PX = 4.0

DRAWN_BLUR_PX = 1.5
"""Standard deviation of the drawn part's blur, that of a sharp photograph: a blurred one has its peak at the same place."""

SUBSAMPLES = 3
"""Points along each side of a pixel."""

LEAST_CORRELATION = 0.3
"""Below which the corners are kept: the part may be lit badly, or blurred beyond recognition."""

SOME_PITCH_UM = 1.0
"""Of the pixels: distortion in pixels does not depend on it."""

ECC_STEPS, ECC_CHANGE = 60, 1e-6


def one_colour(photograph: Photograph) -> tuple[Counts, int]:
    """Return the counts of a mosaic, and its period; green, and 1, of a picture in colours."""
    if photograph.pattern == IN_COLOURS:
        photograph = photograph.part("G")
    return photograph.counts, len(photograph.pattern)


def register_part(
    counts: Floats | Counts, period: int, target: Target, part: TargetPart, corners: Floats
) -> Floats:
    """Return the target's corners (4, 2), extrapolated from where the part is found.

    The part is shifted first, to the largest correlation, and then sheared and scaled to the largest enhanced correlation
    coefficient (Evangelidis and Psarakis, PAMI 30, 2008).

    Parameters
    ----------
    counts : (rows, columns) of a photograph
    period : pixels after which its colours repeat; 1 of one colour
    target, part : the target, and the part of it
    corners : (4, 2) of the target as it was found as a whole
    """
    pose = Pose.from_corners(corners, target.size_mm)
    inside = part.corners(pose)
    reach = int(np.ceil(max(REACH_PX, REACH * np.ptp(corners, axis=0).max())))
    low = np.maximum(np.ceil(inside.min(axis=0)).astype(int), 0)
    high = np.minimum(np.floor(inside.max(axis=0)).astype(int), counts.shape)
    if np.any(high - low < 2 * REACH_PX):
        return corners
    drawn = _drawn(target, pose, low, high)
    first = np.maximum(low - reach, 0)
    last = np.minimum(high + reach, counts.shape)
    seen = counts[first[0] : last[0], first[1] : last[1]].astype(np.float32)
    # means over the period of the colours: of an even one, their middle is half a pixel above and to the left
    grey = np.asarray(cv2.blur(seen, (period, period)), np.float32)
    offset = 0.5 * (period % 2 == 0)
    match = cv2.matchTemplate(grey, drawn, cv2.TM_CCOEFF_NORMED)
    peak = np.unravel_index(int(np.argmax(match)), match.shape)
    if match[peak] < LEAST_CORRELATION:
        return corners
    moved = np.array(peak) + first - low - offset
    shift = np.array([[1.0, 0, peak[1]], [0, 1.0, peak[0]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ECC_STEPS, ECC_CHANGE)
    everywhere = np.ones(grey.shape, np.uint8)
    try:
        _, affine = cv2.findTransformECC(
            drawn, grey, shift, cv2.MOTION_AFFINE, criteria, everywhere, 3
        )
    except cv2.error:  # it did not converge
        return np.asarray(corners + moved)
    (across, down, right), (mixed, along, below) = np.asarray(affine, np.float64)
    by = np.array([[along, mixed], [down, across]])
    at = (corners - low) @ by.T + [below, right] + first - offset
    return np.asarray(at)


def bends_of_parts(
    shape_px: tuple[int, int],
    size_mm: tuple[float, float],
    corners: Mapping[TargetPart, Sequence[Floats]],
) -> dict[TargetPart, Floats]:
    """Return how the lens's distortion bends each tile (2, 4, 4), see `Pose`; none where the tiles' places show no distortion.

    Parameters
    ----------
    shape_px : (rows, columns) of the photographs
    size_mm : of the target
    corners : (4, 2) of the target as each tile shows them, for each photograph
    """
    poses = {
        part: [part.of(Pose.from_corners(one, size_mm)) for one in of]
        for part, of in corners.items()
        if part.tile is not None
    }
    if len(poses) < 2:
        return {}
    places = [
        TilePlace(Key(float(number), "", part.tile), pose.corners_px())
        for part, of_part in poses.items()
        for number, pose in enumerate(of_part)
    ]
    ends = {part.tile: np.array([part.y, part.x]) for part in poses if part.tile}
    parts = PartsOfTarget(size_mm, ends)
    straight = lens_distortion(FieldFrame(shape_px, SOME_PITCH_UM), parts, places)
    if straight is None:
        return {}
    return {part: bend_of(first, straight) for part, (first, *_) in poses.items()}


def _drawn(target: Target, pose: Pose, low: Ints, high: Ints) -> Floats32:
    """Return the target's radiance in pixels from low to high, blurred."""
    step = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    rows, columns = (
        (np.arange(a, b)[:, None] + step).ravel() for a, b in zip(low, high, strict=True)
    )
    y, x = pose.to_target(rows[:, None], columns[None, :])
    half = pose.half_size_mm
    fine = target.radiance(y * half[0], x * half[1])
    count = high - low
    pixels = fine.reshape(count[0], SUBSAMPLES, count[1], SUBSAMPLES).mean(axis=(1, 3))
    return np.asarray(
        cv2.GaussianBlur(pixels.astype(np.float32), (0, 0), DRAWN_BLUR_PX), np.float32
    )
