"""A summary of a photograph for the operator's page: a small picture, light and sharpness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labkit.finder.preview import Look, jpeg
from labkit.finder.sharpness import sharpest_edge_px
from labkit.photographs.photograph import Photograph
from labkit.types import FrameKind, Indices

HISTOGRAM_BINS = 64

BAND_PX = 1_000_000


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """A photograph in numbers. edge_px: rise of the sharpest edges in pixels, None for an even photograph.

    histogram: share of pixels in 64 equal steps from black to white, and beyond; note:
    remark on the photograph
    """

    number: int
    name: str
    range_mm: float | None
    clipped_percent: float
    median_percent: float
    edge_px: float | None
    histogram: list[float]
    note: str = ""


def look_at(name: str, kind: FrameKind, range_mm: float | None, mosaic: Photograph) -> Look:
    """Return a frame of a session as the page shows it."""
    return Look(
        name,
        range_mm,
        mosaic,
        edge_px=sharpest_edge_px(mosaic) if kind == "target" else None,
    )


def summarise(number: int, look: Look) -> tuple[FrameSummary, bytes]:
    """Return a photograph's summary, and its picture as JPEG."""
    light = exposure(look.mosaic)
    summary = FrameSummary(
        number,
        look.name,
        look.range_mm,
        *light,
        look.edge_px,
        histogram(look.mosaic),
        look.note,
    )
    return summary, jpeg(look.mosaic, look.corners_px, look.likely_px)


def exposure(mosaic: Photograph) -> tuple[float, float]:
    """Return the percentage of pixels at or above white, and the median in percent of the way from black to
    white.
    """
    below = np.cumsum(_of_each_count(mosaic)) / mosaic.counts.size
    clipped = 1 - below[: int(np.ceil(mosaic.white))][-1]
    median = int(np.searchsorted(below, 0.5))
    black = float(mosaic.black.mean())
    return float(100 * clipped), 100 * (median - black) / (mosaic.white - black)


def histogram(mosaic: Photograph) -> list[float]:
    """Return the share of pixels in 64 equal steps from black to white; values beyond count in the first and
    last.
    """
    of_count = _of_each_count(mosaic)
    black = float(mosaic.black.mean())
    step = np.floor(
        (np.arange(of_count.size) - black) / (mosaic.white - black) * HISTOGRAM_BINS
    )
    share = np.bincount(
        np.clip(step, 0, HISTOGRAM_BINS - 1).astype(int),
        weights=of_count,
        minlength=HISTOGRAM_BINS,
    )
    return [float(value) for value in share / mosaic.counts.size]


def _of_each_count(mosaic: Photograph) -> Indices:
    """Return how many pixels (65536,) have each count."""
    # band by band: NumPy counts in copies of eight bytes a pixel
    bands = np.array_split(mosaic.counts, max(1, mosaic.counts.size // BAND_PX))
    tallies = [np.bincount(band.ravel(), minlength=2**16) for band in bands]
    return np.asarray(np.sum(tallies, axis=0))
