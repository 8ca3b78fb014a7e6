"""Search an image for a target of any kind: correlation over scale, rotation and position."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.target import Target
from labkit.types import Floats

Singles = NDArray[np.float32]

COARSE_SIDE = 64
"""Width of the target in the binned picture of the search, pixels."""

BLUR_PX = 1.2
"""Blur of picture and template, which widens the peak, so that steps of scale and angle can be coarse."""

LEAST_DEVIATION = 0.01
"""Standard deviation, of a picture from 0 to 1, where a target may be: JPEG makes dark parts perfectly even."""

TILTS_DEG = np.linspace(-15.0, 15.0, 11)
SCALE_STEP = 1.05


def swept_hypotheses(
    image: Singles, target: Target, sides_px: Floats, most: int = 6
) -> Iterator[Floats]:
    """Yield corners (4, 2) (row, col) of the likeliest places, best first.

    image: (rows, cols); sides_px: the target's heights to try. All four quarter turns are
    tried, each ±15 degrees.
    """
    templates = _templates(target)
    places: list[tuple[float, Floats]] = []
    for side in sides_px:
        shape = tuple(max(1, round(n * COARSE_SIDE / side)) for n in image.shape)
        how = cv2.INTER_AREA if side > COARSE_SIDE else cv2.INTER_LINEAR
        small = cv2.GaussianBlur(
            cv2.resize(image, shape[::-1], interpolation=how), (0, 0), BLUR_PX
        )
        scale = np.array(image.shape) / np.array(shape)
        for template, corners in templates:
            if template.shape[0] > shape[0] or template.shape[1] > shape[1]:
                continue
            _, score, _, (col, row) = cv2.minMaxLoc(
                _likeness(np.asarray(small, dtype=np.float32), template)
            )
            places.append((score, (corners + (row, col) + 0.5) * scale - 0.5))
    places.sort(key=lambda place: place[0], reverse=True)
    kept: list[Floats] = []
    for _, corners in places:
        if len(kept) < most and all(
            np.max(np.abs(corners - other)) > 0.1 * np.ptp(corners) for other in kept
        ):
            kept.append(corners)
            yield corners


def _likeness(picture: Singles, template: Singles) -> Singles:
    """Return the correlation with the template at each place; 0 where the image is even.

    OpenCV may give 1 in even areas.
    """
    likeness = cv2.matchTemplate(picture, template, cv2.TM_CCOEFF_NORMED)
    rows, cols = likeness.shape
    mean, square = (
        cv2.blur(
            values, template.shape[::-1], anchor=(0, 0), borderType=cv2.BORDER_REPLICATE
        )[:rows, :cols]
        for values in (picture, picture**2)
    )
    return np.asarray(
        np.where(square - mean**2 > LEAST_DEVIATION**2, likeness, 0.0), dtype=np.float32
    )


def _templates(target: Target) -> list[tuple[Singles, Floats]]:
    """Return the target in every tried direction, without directions that look the same."""
    spacing = target.size_mm[0] / COARSE_SIDE
    rows, cols = (int(side / spacing / 2) + 3 for side in target.size_mm)
    y, x = np.arange(-rows, rows + 1) * spacing, np.arange(-cols, cols + 1) * spacing
    sharp = target.sample(y, x, 0.4 / spacing).astype(np.float32)
    flat = np.asarray(cv2.GaussianBlur(sharp, (0, 0), BLUR_PX), dtype=np.float32)
    made: list[tuple[Singles, Floats]] = []
    for quarter in range(4):
        turned = [
            _turned(flat, target.size_mm, spacing, 90.0 * quarter + tilt)
            for tilt in TILTS_DEG
        ]
        upright = turned[len(turned) // 2][0]
        known = (tilted[0] for tilted in made[len(TILTS_DEG) // 2 :: len(TILTS_DEG)])
        if not any(
            other.shape == upright.shape and np.abs(other - upright).max() < 0.01
            for other in known
        ):
            made += turned
    return made


def _turned(
    flat: Singles, size_mm: tuple[float, float], spacing: float, degrees: float
) -> tuple[Singles, Floats]:
    """Return the part of the rotated target inside an upright rectangle, and the target's corners in its
    pixels.
    """
    height, width = size_mm
    turn = np.deg2rad(degrees)
    cos, sin = np.cos(turn), np.sin(turn)
    # the largest upright rectangle of the target's (turned) proportions that fits inside
    tilt = np.deg2rad((degrees + 45.0) % 90.0 - 45.0)
    upright = (height, width) if round(degrees / 90.0) % 2 == 0 else (width, height)
    shrink = 1.0 / (np.cos(tilt) + abs(np.sin(tilt)) * max(upright) / min(upright))
    rows, cols = (max(8, int(side * shrink / spacing)) for side in upright)
    y = (np.arange(rows)[:, None] - (rows - 1) / 2) * spacing
    x = (np.arange(cols)[None, :] - (cols - 1) / 2) * spacing
    # the point (y, x) of the picture shows the target's point turned back
    back_row = (cos * y - sin * x) / spacing + (flat.shape[0] - 1) / 2
    back_col = (sin * y + cos * x) / spacing + (flat.shape[1] - 1) / 2
    template = cv2.remap(
        flat, back_col.astype(np.float32), back_row.astype(np.float32), cv2.INTER_LINEAR
    )
    corners = np.array(
        [[-height, -width], [-height, width], [height, width], [height, -width]]
    ) / (2 * spacing)
    turned = np.column_stack(
        (
            cos * corners[:, 0] + sin * corners[:, 1],
            -sin * corners[:, 0] + cos * corners[:, 1],
        )
    )
    return np.asarray(template, dtype=np.float32), turned + np.array(
        [(rows - 1) / 2, (cols - 1) / 2]
    )
