"""Make a small preview of a photograph: bright enough for a screen, clipped areas red, the target outlined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.photographs.photograph import Photograph
from labkit.types import Floats

JPEG_PREVIEW_PX = 900
RED, CYAN, ORANGE, BLACK = (40, 40, 230), (255, 220, 40), (30, 140, 255), (0, 0, 0)
"""Blue, green, red of clipped pixels, of the outline, of likely places, and of the outline's dark border on white."""


@dataclass(frozen=True, slots=True)
class Look:
    """A photograph that is no frame of a session, judged or still to be: from a preflight or for focusing.

    corners_px: (n, 4, 2) of the targets (row, col), None if none is found; edge_px: rise of the
    sharpest edges in pixels, None for an even image; note: remark on the photograph; likely_px:
    corners of the likeliest places where no target is found.
    """

    name: str
    range_mm: float | None
    mosaic: Photograph
    corners_px: Floats | None = None
    edge_px: float | None = None
    note: str = ""
    likely_px: Sequence[Floats] = ()


def jpeg(
    mosaic: Photograph,
    corners_px: Floats | None = None,
    likely_px: Sequence[Floats] = (),
) -> bytes:
    """Return a JPEG at most 900 pixels wide; patches with a clipped pixel are red, the targets are outlined.

    corners_px: (n, 4, 2) of the targets (row, column); likely_px: of places where one was
    looked for in vain, outlined and numbered.
    """
    # coarse first, and still finer than the preview: no copy of the whole frame is made
    step = max(2, mosaic.shape[1] // JPEG_PREVIEW_PX // 2 * 2)
    level, full = _cells(mosaic, step)
    scale = min(1.0, JPEG_PREVIEW_PX / level.shape[1])
    size = max(1, round(level.shape[1] * scale)), max(1, round(level.shape[0] * scale))
    small = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
    grey = np.rint(255 * np.clip(small, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    colour = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    colour[cv2.resize(full, size, interpolation=cv2.INTER_AREA) > 0] = RED
    per_pixel = np.array(size) / (step * np.array(level.shape[::-1]))
    if corners_px is not None:
        _outline(colour, (corners_px[..., ::-1] + 0.5) * per_pixel - 0.5, CYAN)
    for number, corners in enumerate(likely_px, start=1):
        at = (corners[:, ::-1] + 0.5) * per_pixel - 0.5
        _outline(colour, at[None], ORANGE)
        _write(colour, str(number), at)
    done, written = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return written.tobytes() if done else b""


def _write(picture: NDArray[np.uint8], text: str, corners: Floats) -> None:
    """Write a text beside corners (4, 2) as (x, y)."""
    height, width = picture.shape[:2]
    x, y = (corners.max(axis=0) + 4).astype(int)
    at = (int(np.clip(x, 2, width - 20)), int(np.clip(y, 16, height - 4)))
    for colour, thickness in ((BLACK, 4), (ORANGE, 1)):
        cv2.putText(
            picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, thickness, cv2.LINE_AA
        )


def _outline(
    picture: NDArray[np.uint8], corners: Floats, line_colour: tuple[int, int, int]
) -> None:
    """Draw round corners (n, 4, 2) as (x, y)."""
    shift = 4  # OpenCV's fixed point
    points = np.rint(corners * 2**shift).astype(np.int32)
    line = (
        2 if max(picture.shape) > JPEG_PREVIEW_PX // 2 else 1
    )  # a smaller picture is shown enlarged
    for colour, thickness in ((BLACK, line + 2), (line_colour, line)):
        cv2.polylines(picture, list(points), True, colour, thickness, cv2.LINE_AA, shift)


def _cells(
    mosaic: Photograph, step: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return light, 0 black to 1 white, and 1 where a pixel is saturated, of squares of step × step pixels."""
    (high, wide), (rows, cols) = mosaic.shape, (size // step for size in mosaic.shape)
    pixels = mosaic.counts.reshape(high, wide, -1)[: rows * step, : cols * step]
    mean = cv2.resize(pixels, (cols, rows), interpolation=cv2.INTER_AREA)
    grey = np.asarray(mean, np.float32).reshape(rows, cols, -1).mean(axis=2)
    black = float(mosaic.black.mean())
    light = (grey - black) / (mosaic.white - black)
    bands = (pixels >= mosaic.white).reshape(rows, step, -1).any(axis=1)
    full = bands.reshape(rows, cols, -1).any(axis=2)
    return np.asarray(light, np.float32), np.asarray(full, np.float32)
