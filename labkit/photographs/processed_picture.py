"""Pictures that are no mosaic: JPEG, and TIFF and PNG in colours. Their tone curve is inverted; other processing remains.

Each colour is a plane of its own at full resolution. Demosaicing, sharpening and noise reduction cannot be inverted: the
measured point spread includes their effect, and the results state this.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labkit.errors import InputError, RawError
from labkit.findings.findings import found
from labkit.photographs.container import Container
from labkit.photographs.encoding import read_encoding, srgb
from labkit.photographs.photograph import Photograph
from labkit.photographs.picture_file import Picture, read_picture
from labkit.photographs.tone_curve import (
    FULL_COUNTS,
    ToneCurve,
    measured_curve,
    stated_curve,
    tone_curve,
)
from labkit.plan import MeasuredTone, Sensor
from labkit.plan.sensor import IN_COLOURS, MONO


def read_file(path: Path) -> Picture:
    """Read the numbers in a JPEG, PNG, PGM or TIFF. Raises RawError."""
    try:
        return read_picture(path, processed=True)
    except InputError as error:
        raise RawError(str(error)) from error
    except OSError as error:
        raise RawError(str(error.strerror)) from error


def is_processed(picture: Picture, container: Container, sensor: Sensor) -> bool:
    """Return whether a picture is no mosaic of bare linear numbers."""
    return (
        picture.numbers.ndim == 3
        or container.kind == "jpeg"
        or sensor.tone_curve not in ("file", "linear")
    )


def processed_photograph(
    path: Path, container: Container, picture: Picture, sensor: Sensor
) -> Photograph:
    """Return a processed picture in counts that are proportional to light.

    Raises RawError if the plan declares it raw, if nothing states its tone curve, or for an unusable profile.
    """
    in_colours = picture.numbers.ndim == 3
    kind = container.kind.upper()
    jpeg = container.kind == "jpeg"
    if sensor.cfa_pattern not in (None, "RGB" if in_colours else "mono"):
        colours = "" if jpeg else " in colours" if in_colours else " without colours"
        raise RawError(
            f'is a {kind}{colours}, but the plan\'s sensor.cfa_pattern = "{sensor.cfa_pattern}" declares raw numbers: '
            f"give the raw file, or leave out cfa_pattern, black_level and white_level"
        )
    try:
        curve = _curve(path, container, picture, sensor)
    except InputError as error:
        raise RawError(str(error)) from error
    numbers = picture.numbers
    black = 0.0
    white = FULL_COUNTS
    undone = "taken as linear, as the plan states"
    if curve is None:
        black = sensor.black_level or 0.0
        white = sensor.white_level or float(picture.white)
    else:
        numbers = curve.linear(numbers)
        undone = f"tone curve undone by {curve.name}"
    notes = [
        found("picture-processed", file_format=kind, bits=picture.bits, tone_curve=undone)
    ]
    if picture.coarse_colours:
        notes.append(found("colours-at-half-resolution"))
    return Photograph(
        numbers.astype(np.uint16).reshape(numbers.shape[0], -1),
        np.full((1, 3) if in_colours else (2, 2), black),
        white,
        IN_COLOURS if in_colours else MONO,
        container.camera,
        container.exposure_s,
        container.iso,
        curve,
        tuple(notes),
        jpeg,
    )


def _curve(
    path: Path, container: Container, picture: Picture, sensor: Sensor
) -> ToneCurve | None:
    """Return the tone curve to undo; None for linear numbers."""
    if sensor.tone_curve == "linear":
        return None
    if sensor.tone_curve == "sRGB":
        return tone_curve("sRGB, as the plan states", [srgb], picture.white)
    colours = picture.numbers.shape[-1] if picture.numbers.ndim == 3 else 1
    if isinstance(sensor.tone_curve, MeasuredTone):
        measured = sensor.tone_curve
        if len(measured.numbers) not in (1, colours):
            raise InputError(
                f"has {colours} colours, but sensor.tone_curve in the plan has {len(measured.numbers)}"
            )
        return measured_curve(measured.light, measured.numbers, picture.white)
    encoding = read_encoding(path)
    if picture.bits == 16 and not encoding.stated:
        raise RawError(
            f"is a {container.kind.upper()} in colours of 16 bit that does not say how its numbers stand to light: "
            'add to [sensor]: tone_curve = "linear" or "sRGB"'
        )
    curve = stated_curve(encoding, picture.white)
    if len(curve.levels) not in (1, colours):
        raise InputError(
            "has an ICC profile of other colours than its own: give sensor.tone_curve"
        )
    return curve
