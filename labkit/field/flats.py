"""Relative illumination of each channel by the flats of the session that holds the results."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np

from labkit.errors import LabkitError
from labkit.field.illumination import RelativeIllumination, measure_illumination
from labkit.key import same_range
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import IN_COLOURS, places_of
from labkit.results import Results
from labkit.session.session import Session
from labkit.types import Floats


def session_illumination(results: Results) -> dict[str, RelativeIllumination]:
    """Return the light over the frame of each channel by the flats of the middle range; empty without flats at hand."""
    if results.folder is None:
        return {}
    range_mm = results.ranges_mm[len(results.ranges_mm) // 2]
    try:
        frames = Session.open(results.folder.resolve().parents[1]).frames
        flats = [frame for frame in frames if frame.kind == "flat"]
        flats = [f for f in flats if same_range(f.range_mm, range_mm)] or flats
        darks = [frame for frame in frames if frame.kind == "dark"]
        pictures, dark = (
            (read_photograph(frame.path, results.plan.sensor) for frame in of)
            for of in (flats, darks)
        )
        pitch_um = results.plan.sensor.pixel_pitch_um
        return illumination(pictures, dark, results.channels, pitch_um)
    except (LabkitError, OSError, IndexError):
        return {}


def illumination(
    flats: Iterable[Photograph],
    darks: Iterable[Photograph],
    channels: Sequence[str],
    pitch_um: float,
) -> dict[str, RelativeIllumination]:
    """Return the light over the frame of each channel that the flats light enough; empty for pictures in colours.

    Of photographs read one by one, one is in memory at a time.
    """
    light, pattern = _mean_light(flats)
    if light is None or pattern == IN_COLOURS:
        return {}
    dark, _ = _mean_light(darks)
    if dark is not None:
        light -= dark
    found = dict[str, RelativeIllumination]()
    every = len(pattern)
    for channel in channels:
        places = places_of(pattern, channel)
        planes = [(slice(y, None, every), slice(x, None, every)) for y, x in places]
        with suppress(ValueError):  # hardly lit
            found[channel] = measure_illumination(light, planes, pitch_um)
    return found


def _mean_light(
    photographs: Iterable[Photograph],
) -> tuple[Floats | None, tuple[str, ...]]:
    """Return the mean counts above black (rows, columns), nan where any is saturated, and the pattern; None of nothing."""
    total: Floats | None = None
    pattern: tuple[str, ...] = ()
    count = 0
    for photograph in photographs:
        light = photograph.light
        light[photograph.saturated] = np.nan
        if total is None:
            total = light
        else:
            total += light
        pattern = photograph.pattern
        count += 1
    if total is not None:
        total /= count
    return total, pattern
