"""Search a photograph for a target of any kind: correlation over scale, direction and position in coarse copies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.finder.carpet_search import Likely
from labkit.finder.picture import Picture, Singles
from labkit.target.target import Target
from labkit.types import Floats

TEMPLATE_SIDE = 48
"""Samples along the target's first axis in a copy of the photograph."""

BLUR_PX = 1.2
"""Blur of photograph and template, which widens the peak, so that steps of scale and angle can be coarse."""

LEAST_DEVIATION = 0.01
"""Standard deviation, relative to the photograph's range, where a target may be: JPEG makes dark parts perfectly even."""

TILTS_DEG = np.linspace(-45.0, 45.0, 22, endpoint=False)
SIZE_STEP = 1.06

SMALLEST_SIDE_PX = 48.0
"""Length of the smallest target searched for where no scale is known."""

MOST_OF_AN_OCTAVE = 6
"""Places that each octave of sizes yields."""


def likely_places(
    picture: Picture, target: Target, sides_px: tuple[float, float] | None
) -> Iterator[list[Likely]]:
    """Yield likely places of a target in any direction: octave by octave of sizes, from the largest on, the likeliest first.

    Parameters
    ----------
    picture : the photograph
    target : the target
    sides_px : least and most length of its first axis, pixels; None for all that are in the frame
    """
    per_mm = float(np.min(np.array(picture.shape) / target.size_mm))
    least, most = sides_px or (SMALLEST_SIDE_PX, SIZE_STEP * per_mm * target.size_mm[0])
    steps = max(1, round(np.log(most / least) / np.log(SIZE_STEP))) if most > least else 0
    sides = np.geomspace(most, least, steps + 1)
    templates = _templates(target)
    octave = round(np.log(2) / np.log(SIZE_STEP))
    for start in range(0, len(sides), octave):
        yield _distinct(
            place
            for side in sides[start : start + octave]
            for place in _places(picture, float(side), templates)
        )


def _places(
    picture: Picture, side_px: float, templates: list[tuple[Singles, Floats]]
) -> Iterator[Likely]:
    """Yield the likeliest place of each template in a copy of the photograph in which the target has TEMPLATE_SIDE samples."""
    scale = TEMPLATE_SIDE / side_px
    small = cv2.GaussianBlur(picture.scaled(scale), (0, 0), BLUR_PX)
    relative = np.asarray(small / max(float(np.ptp(small)), 1e-9), np.float32)
    uneven = cache(
        partial(_uneven, relative)
    )  # templates in several directions have one shape
    for template, corners in templates:
        if template.shape[0] <= small.shape[0] and template.shape[1] <= small.shape[1]:
            # OpenCV may give 1 in even areas
            likeness = cv2.matchTemplate(relative, template, cv2.TM_CCOEFF_NORMED)
            _, score, _, (col, row) = cv2.minMaxLoc(likeness, uneven(template.shape))
            if score > 0:  # else all is even
                yield Likely((corners + (row, col) + 0.5) / scale - 0.5, float(score))


def _distinct(places: Iterable[Likely]) -> list[Likely]:
    """Return the likeliest places, none near another."""
    kept = list[Likely]()
    for place in sorted(places, key=lambda one: -one.likeness):
        near = 0.1 * place.side_px
        if len(kept) < MOST_OF_AN_OCTAVE and all(
            np.abs(place.corners - other.corners).max() > near for other in kept
        ):
            kept.append(place)
    return kept


def _uneven(picture: Singles, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return an image that is 1 where a window of a shape that begins there is not even, and 0 elsewhere."""
    rows, cols = (n - side + 1 for n, side in zip(picture.shape, shape, strict=True))
    mean, square = (
        cv2.blur(values, shape[::-1], anchor=(0, 0), borderType=cv2.BORDER_REPLICATE)[
            :rows, :cols
        ]
        for values in (picture, picture**2)
    )
    return np.asarray(square - mean**2 > LEAST_DEVIATION**2, np.uint8)


def _templates(target: Target) -> list[tuple[Singles, Floats]]:
    """Return the target in every tried direction, without directions that look the same."""
    spacing = target.size_mm[0] / TEMPLATE_SIDE
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
