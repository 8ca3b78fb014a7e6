"""Checks of a photograph: whether it is of a session's sensor, and neither overexposed nor black."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import scipy.fft

from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.types import Counts, FrameKind

SATURATED_SHARE = 0.2
"""Share of a colour's bright pixels (above half scale) saturated if its white is clipped. An unclipped white
saturates isolated reflections only, a clipped white nearly all bright pixels."""

SATURATED_LEAST = 5e-3
"""Of all of a colour's pixels: fewer saturated than this are a reflection, for a target fills more of the frame."""

SIGNAL_SIGMAS = 5.0
"""Light must stand out of the pixel noise by this much somewhere. Of 9-pixel medians, whose noise is 0.41 of a
pixel's, the largest in 10 million stays below 2.2 sigma."""

SIGNAL_SHARE = 2e-3
"""Nor is this little of the way from black to white light: black levels are off by as much when a sensor is warm."""

DARK_SHARE = 0.1
"""A dark or bias frame whose median lies this far from black to white has seen light."""

CLIPPED_STEPS = 3
"""Clipped pixels are more than this times those of the counts next to the largest, as many as this."""

VISIBLE_NOISE = 1.0
"""Counts: noise of as much spreads bright pixels over many counts, so that few are at the largest, unless that is where the
sensor or a converter clips."""

ROUNDING_STD = 1 / np.sqrt(12)
"""Standard deviation of rounding to whole counts."""

MOST_NOISE_ROWS = 512
MOST_NOISE_TILES, LEAST_NOISE_TILE_PX = 16, 16
"""Noise is looked for in up to 16 x 16 tiles, none smaller than this: a target need not fill all of them."""


def difference(photograph: Photograph, first: Photograph) -> str | None:
    """Return how a photograph's sensor differs from that of its session's first one; None if it does not."""
    this, that = (
        {
            "camera": of.camera or "unknown",
            "size": "×".join(map(str, of.frame_px)),
            "filter array": of.cfa,
            "white level": f"{of.white:g}",
            "tone curve": "none" if of.tone is None else of.tone.name,
        }
        for of in (photograph, first)
    )
    for what in this:
        if this[what] != that[what]:
            return f"is of another {what} than the first photograph: {this[what]}, not {that[what]}"
    return None


def exposure_problem(
    photograph: Photograph, kind: FrameKind, channels: Iterable[str], place: Cut = WHOLE
) -> str | None:
    """Return why a frame of a kind cannot be used, or None. Raises RawError for a channel that it lacks.

    place: rows and columns with the target, where they are known: a window beside it may be
    overexposed, and a room bright where the target is dark.
    """
    for name in channels:
        part = photograph.part(name, place)
        for plane in part.planes(name):
            if problem := _plane_problem(part, kind, plane):
                mono = photograph.cfa == "mono"
                return problem if mono else f"{problem}, in channel {name}"
    return None


def _plane_problem(photograph: Photograph, kind: FrameKind, where: Cut) -> str | None:
    plane = np.ascontiguousarray(photograph.counts[where])
    black = photograph.black_of(where)
    white = photograph.white
    if kind in ("dark", "bias"):
        lit = float(np.median(plane)) - black > DARK_SHARE * (white - black)
        return f"has seen light: it is no {kind} frame" if lit else None
    smooth: Counts = cv2.medianBlur(plane, 3).astype(np.uint16)  # hot pixels stand alone
    saturated = np.count_nonzero(smooth >= white)
    bright = np.count_nonzero(smooth > (black + white) / 2)
    if saturated > max(SATURATED_LEAST * plane.size, SATURATED_SHARE * bright):
        percent = 100 * saturated / plane.size
        return f"is overexposed: {percent:.2g} % of its pixels, and most of its bright ones, are full ({white:g})"
    signal = float(smooth.max()) - black
    noise = pixel_noise(plane)
    if signal < SIGNAL_SIGMAS * noise:
        noise = min(
            noise, aperiodic_noise(plane)
        )  # the stripes of a panel close by differ as much as their light
    if signal < max(SIGNAL_SIGMAS * noise, SIGNAL_SHARE * (white - black)):
        return f"is black: {signal:.3g} counts of light at most, where the noise of a pixel is {noise:.2g}"
    return _clipped_below(white, plane, smooth) if photograph.tone is None else None


def is_constant(photograph: Photograph) -> bool:
    """Return whether all pixels of each place of the filter cell are equal: clipped, or without any noise."""
    planes = (photograph.counts[plane] for plane in photograph.every_plane)
    return all(plane.min() == plane.max() for plane in planes)


def _clipped_below(white: float, plane: Counts, smooth: Counts) -> str | None:
    """Return why bright pixels clipped below the stated white level cannot be used; None if they are not clipped.

    Sensors at low gain, a black level subtracted, and converters clip below the level that a file states.
    """
    top = int(smooth.max())
    below = f"below the white level of {white:g}: give less light"
    if plane.min() == plane.max():
        return f"is clipped: all its pixels are {top}, {below}"
    at_top = smooth == top
    bright = int(np.count_nonzero(smooth > (int(smooth.min()) + top) / 2))
    clipped = int(np.count_nonzero(at_top))
    near = int(np.count_nonzero((smooth < top) & (smooth >= top - CLIPPED_STEPS)))
    few = max(SATURATED_LEAST * plane.size, SATURATED_SHARE * bright)
    if clipped <= max(few, CLIPPED_STEPS * near):
        return None
    # without noise where nothing is clipped, equal pixels are a picture of few levels
    sample = slice(None, None, -(-len(plane) // MOST_NOISE_ROWS))
    steps = np.abs(np.diff(plane[sample].astype(np.int32), axis=1))
    inside = ~(at_top[sample, 1:] | at_top[sample, :-1])
    if not inside.any() or np.median(steps[inside]) / 0.6745 / np.sqrt(2) < VISIBLE_NOISE:
        return None
    percent = 100 * clipped / plane.size
    return f"is clipped: {percent:.2g} % of its pixels are {top}, {below}"


def pixel_noise(plane: Counts) -> float:
    """Return the standard deviation of one pixel's noise where the picture is smoothest, at least that of rounding."""
    levels = [
        np.median(np.abs(np.diff(tile.astype(np.float64), axis=1)))
        for tile in _tiles(plane)
    ]
    smoothest = np.quantile(levels, 0.1)
    return float(max(smoothest / 0.6745 / np.sqrt(2), ROUNDING_STD))


def aperiodic_noise(plane: Counts) -> float:
    """Return the noise of a picture with a pattern that repeats, such as a panel's own pixels.

    A pattern is in few places of a tile's spectrum, noise in all alike: a quarter of its squares are below 0.288 of their
    mean. Within a tenth for flats, too large where a picture has structure of all sizes.
    """
    levels = []
    for counts in _tiles(plane):
        tile = counts.astype(np.float32)
        window = np.outer(*(np.hanning(n + 2)[1:-1] for n in tile.shape))
        power = np.abs(scipy.fft.rfft2((tile - tile.mean()) * window)) ** 2 / np.sum(
            window**2
        )
        levels.append(float(np.quantile(power, 0.25)) / -np.log(0.75))
    return float(max(np.sqrt(np.quantile(levels, 0.1)), ROUNDING_STD))


def _tiles(plane: Counts) -> list[Counts]:
    rows, cols = (
        max(1, min(MOST_NOISE_TILES, size // LEAST_NOISE_TILE_PX)) for size in plane.shape
    )
    return [
        part
        for band in np.array_split(plane, rows)
        for part in np.array_split(band, cols, axis=1)
    ]
