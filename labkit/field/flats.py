"""Relative illumination of each channel by the flats of the session that holds the results."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from labkit.errors import LabkitError
from labkit.field.illumination import RelativeIllumination, measure_illumination
from labkit.key import same_range
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import places_of
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
            [read_photograph(frame.path, results.plan.sensor) for frame in of]
            for of in (flats, darks)
        )
    except (LabkitError, OSError, IndexError):
        return {}
    pitch_um = results.plan.sensor.pixel_pitch_um
    return illumination(pictures, dark, results.channels, pitch_um)


def illumination(
    flats: Sequence[Photograph],
    darks: Sequence[Photograph],
    channels: Sequence[str],
    pitch_um: float,
) -> dict[str, RelativeIllumination]:
    """Return the light over the frame of each channel that the flats light enough; empty for pictures in colours."""
    if not flats or flats[0].counts.shape != flats[0].shape:
        return {}
    light = _mean_light(flats)
    if darks:
        light = light - _mean_light(darks)
    found = dict[str, RelativeIllumination]()
    pattern = flats[0].pattern
    for channel in channels:
        every = len(pattern)
        places = places_of(pattern, channel)
        planes = [(slice(y, None, every), slice(x, None, every)) for y, x in places]
        with suppress(ValueError):  # hardly lit
            found[channel] = measure_illumination(light, planes, pitch_um)
    return found


def _mean_light(pictures: Sequence[Photograph]) -> Floats:
    """Return the mean counts above black (rows, columns); nan where any is saturated."""
    total = np.zeros(pictures[0].shape)
    for picture in pictures:
        total += np.where(picture.saturated, np.nan, picture.light)
    return np.asarray(total / len(pictures))
