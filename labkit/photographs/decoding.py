"""Photographs read from files. Nothing is demosaiced.

Raw files go through LibRaw and state their filter pattern, black and white level. Grey TIFF, PNG and PGM files hold bare
numbers: the plan states these. What a program has processed, JPEG and pictures in colours, goes through `processed_picture`.
The type of a file is recognised by its content, not by its name.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labkit.apart import run_apart
from labkit.errors import InputError, RawError
from labkit.photographs.container import Container, recognise
from labkit.photographs.photograph import Photograph
from labkit.photographs.picture_file import Numbers
from labkit.photographs.processed_picture import (
    is_processed,
    processed_photograph,
    read_file,
)
from labkit.plan import Sensor
from labkit.plan.sensor import pattern_of


def read_photograph(path: Path, sensor: Sensor) -> Photograph:
    """The mosaic in a file.

    sensor: what the file does not state. Raises RawError, naming file and cause, for a file that is missing, truncated,
    no photograph, or states otherwise than `sensor`.
    """
    try:
        return run_apart(_read, path, sensor)
    except InputError as error:
        raise RawError(f"{path}: {error}") from error.__cause__


def _read(path: Path, sensor: Sensor) -> Photograph:
    mosaic = (
        _read_recognised(path, sensor)
        if sensor.headerless_px is None
        else _read_headerless(path, sensor)
    )
    _refuse_contradiction(mosaic, sensor)
    return mosaic


def _read_recognised(path: Path, sensor: Sensor) -> Photograph:
    container = recognise(path)
    if container.kind != "raw":
        return _read_numbers(path, container, sensor)
    from labkit.photographs.libraw import (
        read_libraw,  # who reads no raw file loads no LibRaw
    )

    return read_libraw(path, container)


def _read_headerless(path: Path, sensor: Sensor) -> Photograph:
    """A file of bare 16-bit numbers, the lower byte first, row by row: nothing in it says what it is, so the plan must."""
    assert sensor.headerless_px is not None
    (rows, cols), size = (
        sensor.headerless_px,
        path.stat().st_size if path.is_file() else None,
    )
    if size != 2 * rows * cols:
        have = "there is no such file" if size is None else f"it has {size}"
        raise RawError(
            f"{rows} × {cols} numbers of 16 bit (sensor.headerless_px) are {2 * rows * cols} bytes: {have}"
        )
    return _bare_mosaic(
        np.fromfile(path, dtype="<u2").reshape(rows, cols), Container("headerless"), sensor
    )


def _read_numbers(path: Path, container: Container, sensor: Sensor) -> Photograph:
    picture = read_file(path)
    if is_processed(picture, container, sensor):
        return processed_photograph(path, container, picture, sensor)
    if picture.bits not in (8, 16):
        raise RawError(f"holds {picture.bits} bit numbers: allowed are 8 and 16 bit")
    return _bare_mosaic(picture.numbers, container, sensor)


def _bare_mosaic(counts: Numbers, container: Container, sensor: Sensor) -> Photograph:
    """Of numbers, with what the plan states of them. Raises RawError where it does not."""
    needed = {
        "cfa_pattern": '"RGGB" or "mono"',
        "black_level": "the count of no light",
        "white_level": "the count of saturation",
    }
    if missing := [
        f"{key} ({words})" for key, words in needed.items() if getattr(sensor, key) is None
    ]:
        raise RawError(
            f"a {container.kind.upper()} file does not state these; add to [sensor]: {', '.join(missing)}"
        )
    assert sensor.cfa_pattern is not None
    assert sensor.black_level is not None
    assert sensor.white_level is not None
    full_scale = np.iinfo(counts.dtype).max
    if sensor.white_level > full_scale:
        raise RawError(
            f"holds numbers up to {full_scale}, but sensor.white_level = {sensor.white_level:g} in the plan"
        )
    return Photograph(
        counts=counts.astype(np.uint16),
        black=np.full((2, 2), sensor.black_level),
        white=sensor.white_level,
        pattern=pattern_of(sensor.cfa_pattern),
        camera=container.camera,
        exposure_s=container.exposure_s,
        iso=container.iso,
    )


def _refuse_contradiction(mosaic: Photograph, sensor: Sensor) -> None:
    """Raise RawError where the file and the plan both state something, and not the same."""
    file = {
        "cfa_pattern": {mosaic.cfa},
        "black_level": {*mosaic.black.ravel()},
        "white_level": {mosaic.white},
    }
    wrong = [
        f"sensor.{key} = {getattr(sensor, key)} but the file has {', '.join(str(value) for value in sorted(values))}"
        for key, values in file.items()
        if getattr(sensor, key) is not None and values != {getattr(sensor, key)}
    ]
    if wrong:
        raise RawError(
            f"contradicts the plan: {'; '.join(wrong)}; leave out of [sensor] what the files state themselves"
        )
