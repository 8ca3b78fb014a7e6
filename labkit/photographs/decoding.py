"""Photographs read from files. Nothing is demosaiced.

Raw files go through LibRaw and state their filter pattern, black and white level. Grey TIFF, PNG and PGM files hold bare
numbers: the plan states these. What a program has processed, JPEG and pictures in colours, goes through `processed_picture`.
The type of a file is recognised by its content, not by its name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labkit.errors import InputError, RawError
from labkit.photographs.container import Container, recognise
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.photographs.picture_file import Numbers
from labkit.photographs.processed_picture import (
    is_processed,
    processed_photograph,
    read_file,
)
from labkit.plan import Sensor
from labkit.plan.sensor import MONO, pattern_of
from labkit.storage.apart import run_apart
from labkit.storage.reading import MOST_PHOTOGRAPH_BYTES, read_bytes


def read_photograph(path: Path, sensor: Sensor, cut: Cut = WHOLE) -> Photograph:
    """Read a photograph, or a cut of it: the rest of the frame never comes into this process.

    Parameters
    ----------
    path : the file
    sensor : what the file may not state
    cut : rows and columns to return, from even ones on, as far as the frame reaches

    Raises
    ------
    RawError : the file is missing, truncated or no photograph, or contradicts `sensor`; the message names the file
    """
    try:
        return run_apart(_read, path, sensor, cut)
    except InputError as error:
        raise RawError(f"{path}: {error}") from error.__cause__


def _read(path: Path, sensor: Sensor, cut: Cut) -> Photograph:
    if sensor.headerless_px is not None:
        numbers = _headerless(path, sensor.headerless_px)
        photograph = _bare(numbers, Container("headerless"), sensor)
    elif (container := recognise(path)).kind == "raw":
        # imported here: who reads no raw file loads no LibRaw
        from labkit.photographs.libraw import read_libraw

        photograph = read_libraw(path, container)
        if sensor.filters_removed and len(photograph.pattern) == 2:
            photograph = replace(photograph, pattern=MONO)
    elif is_processed(picture := read_file(path), container, sensor):
        photograph = processed_photograph(path, container, picture, sensor)
    elif picture.bits in (8, 16):
        photograph = _bare(picture.numbers, container, sensor)
    else:
        raise RawError(f"holds {picture.bits} bit numbers: allowed are 8 and 16 bit")
    _refuse_contradiction(photograph, sensor)
    return photograph if cut == WHOLE else photograph.cropped(cut)


def _headerless(path: Path, shape: tuple[int, int]) -> Numbers:
    """Read bare 16-bit numbers, the lower byte first, row by row."""
    rows, cols = shape
    try:
        content = read_bytes(path, MOST_PHOTOGRAPH_BYTES, follow_link=True)
    except OSError as error:
        raise RawError(str(error.strerror)) from error
    if len(content) != 2 * rows * cols:
        raise RawError(
            f"{rows} × {cols} numbers of 16 bit (sensor.headerless_px) are {2 * rows * cols} bytes: it has {len(content)}"
        )
    return np.frombuffer(content, dtype="<u2").reshape(shape)


def _bare(counts: Numbers, container: Container, sensor: Sensor) -> Photograph:
    """Return the photograph of bare numbers. Raises RawError for properties that the plan must state."""
    pattern = sensor.cfa_pattern
    black = sensor.black_level
    white = sensor.white_level
    needed = {
        'cfa_pattern ("RGGB" or "mono")': pattern,
        "black_level (the count of no light)": black,
        "white_level (the count of saturation)": white,
    }
    missing = [words for words, value in needed.items() if value is None]
    if pattern is None or black is None or white is None:
        raise RawError(
            f"a {container.kind.upper()} file does not state these; add to [sensor]: {', '.join(missing)}"
        )
    if white > (full_scale := np.iinfo(counts.dtype).max):
        raise RawError(
            f"holds numbers up to {full_scale}, but sensor.white_level = {white:g} in the plan"
        )
    return Photograph(
        counts.astype(np.uint16),
        np.full((2, 2), black),
        white,
        pattern_of(pattern),
        container.camera,
        container.exposure_s,
        container.iso,
    )


def _refuse_contradiction(photograph: Photograph, sensor: Sensor) -> None:
    """Raise RawError where file and plan both state a property, and differ."""
    file = {
        "cfa_pattern": {photograph.cfa},
        "black_level": {*photograph.black.ravel()},
        "white_level": {photograph.white},
    }
    wrong = [
        f"sensor.{key} = {stated} but the file has {', '.join(map(str, sorted(values)))}"
        for key, values in file.items()
        if (stated := getattr(sensor, key)) is not None and values != {stated}
    ]
    if not wrong:
        return
    advice = "leave out of [sensor] what the files state themselves"
    if sensor.cfa_pattern == "mono" and photograph.pattern != MONO:
        advice += ", or add filters_removed = true if the filters were taken off the sensor"
    raise RawError(f"contradicts the plan: {'; '.join(wrong)}; {advice}")
