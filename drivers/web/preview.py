"""A summary of a photograph for the operator's page: a small picture, how light it is, how sharp."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.finder.sharpness import sharpest_edge_px
from labkit.raw.mosaic import Mosaic
from labkit.types import FrameKind

BINS = 64
PREVIEW_PX = 900
RED = (40, 40, 230)
"""Blue, green, red of a clipped pixel in the preview."""


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """A photograph in numbers. edge_px: pixels over which its sharpest edges rise, None for one that is to be even.

    histogram: share of pixels in 64 equal steps from black to white, and what is beyond.
    """

    number: int
    name: str
    kind: FrameKind
    range_mm: float | None
    clipped_percent: float
    median_percent: float
    edge_px: float | None
    histogram: list[float]


def summarise(
    number: int, name: str, kind: FrameKind, range_mm: float | None, mosaic: Mosaic
) -> tuple[FrameSummary, bytes]:
    """A photograph's summary, and its picture as JPEG."""
    edge_px = sharpest_edge_px(mosaic) if kind == "target" else None
    summary = FrameSummary(number, name, kind, range_mm, *exposure(mosaic), edge_px, histogram(mosaic))
    return summary, picture(mosaic)


def exposure(mosaic: Mosaic) -> tuple[float, float]:
    """Percentage of pixels at or above white, and the middle pixel in percent of the way from black to white."""
    clipped = 100 * np.count_nonzero(mosaic.counts >= mosaic.white) / mosaic.counts.size
    black = float(mosaic.black.mean())
    return float(clipped), float(100 * (np.median(mosaic.counts[::3, ::3]) - black) / (mosaic.white - black))


def histogram(mosaic: Mosaic) -> list[float]:
    """Share of pixels in 64 equal steps from black to white; what is below or above counts in the first and last."""
    of_count = np.bincount(mosaic.counts.ravel(), minlength=1)
    black = float(mosaic.black.mean())
    step = np.floor((np.arange(of_count.size) - black) / (mosaic.white - black) * BINS)
    share = np.bincount(np.clip(step, 0, BINS - 1).astype(int), weights=of_count, minlength=BINS)
    return [float(value) for value in share / mosaic.counts.size]


def picture(mosaic: Mosaic) -> bytes:
    """A JPEG at most 900 pixels wide, brightened as a screen needs; every patch with a clipped pixel is red."""
    level = levels(mosaic)
    scale = min(1.0, PREVIEW_PX / level.shape[1])
    size = max(1, round(level.shape[1] * scale)), max(1, round(level.shape[0] * scale))
    small = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
    grey = np.rint(255 * np.clip(small, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    colour = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    clipped = (mosaic.counts >= mosaic.white).astype(np.float32)
    colour[cv2.resize(clipped, size, interpolation=cv2.INTER_AREA) > 0] = RED
    done, jpeg = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 88])
    return jpeg.tobytes() if done else b""


def levels(mosaic: Mosaic) -> NDArray[np.float32]:
    """(rows/2, cols/2) light, 0 black to 1 white, each 2×2 cell in one."""
    rows, cols = (size // 2 * 2 for size in mosaic.counts.shape)
    counts = mosaic.counts[:rows, :cols].astype(np.float32)
    cells: NDArray[np.float32] = counts.reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))
    black = float(mosaic.black.mean())
    return (cells - np.float32(black)) / np.float32(mosaic.white - black)
