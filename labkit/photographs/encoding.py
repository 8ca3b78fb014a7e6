"""How a picture's numbers stand to light, as its file states it: an ICC profile, a gamma, sRGB, or nothing."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import tifffile

from labkit.errors import InputError
from labkit.photographs.picture_file import JPEG, PNG, format_of, png_chunks, read_header
from labkit.storage.reading import opened_photograph
from labkit.types import Floats

MOST_PROFILE_BYTES = 2**24
"""Of an unpacked profile: printers' tables take 2 MB."""

ICC_TAG = 34675
TRC = (b"rTRC", b"gTRC", b"bTRC")
GREY_TRC = b"kTRC"

Curve = Callable[[Floats], Floats]
"""Light, 0 to 1, by the number stored, 0 to 1."""


@dataclass(frozen=True, slots=True)
class Encoding:
    """A file's statements on its tone curve: a profile, sRGB, or a power of the stored number; empty if none."""

    icc: bytes = b""
    srgb: bool = False
    power: float | None = None

    @property
    def stated(self) -> bool:
        """Return whether the file states anything."""
        return bool(self.icc) or self.srgb or self.power is not None


def read_encoding(path: Path) -> Encoding:
    """Read the statements of a JPEG, PNG or TIFF file. Raises InputError for a damaged file, OSError."""
    with opened_photograph(path) as file:
        head = file.read(len(PNG))
        file.seek(0)
        if head.startswith(JPEG):
            return Encoding(icc=read_header(file.read()).icc)
        match format_of(head):
            case "png":
                return _of_png({name: data for name, data, _ in png_chunks(file.read())})
            case "tiff":
                return _of_tiff(file)
    return Encoding()


def _of_tiff(file: BinaryIO) -> Encoding:
    try:
        with tifffile.TiffFile(file) as tiff:
            tag = tiff.pages.first.tags.get(ICC_TAG)
            return Encoding(icc=bytes(tag.value) if tag else b"")
    except Exception as error:  # of whatever a damaged tag breaks
        raise InputError("holds an ICC profile that cannot be read") from error


def srgb(stored: Floats) -> Floats:
    """Return sRGB's curve, IEC 61966-2-1: light, 0 to 1, by the stored number, 0 to 1."""
    return np.where(
        stored <= 0.04045, stored / 12.92, ((np.maximum(stored, 0) + 0.055) / 1.055) ** 2.4
    )


def profile_curves(icc: bytes) -> tuple[Curve, ...]:
    """Return the tone curves of an ICC profile: three of R, G, B, or one of grey (ICC.1:2010, 10.5 and 10.15).

    Raises InputError for a profile that has none, or damaged.
    """
    try:
        tags = _tags(icc)
        names = (
            TRC
            if all(name in tags for name in TRC)
            else (GREY_TRC,)
            if GREY_TRC in tags
            else ()
        )
        curves = tuple(_curve(tags[name]) for name in names)
    except (struct.error, ZeroDivisionError) as error:
        raise InputError("holds an ICC profile that is damaged") from error
    if not curves:
        raise InputError(
            'has an ICC profile without tone curves: give sensor.tone_curve = "sRGB" or "linear"'
        )
    return curves


def profile_name(icc: bytes) -> str:
    """Return a profile's own name, such as Adobe RGB (1998); empty if it cannot be read."""
    try:
        data = _tags(icc).get(b"desc", b"")
        if data.startswith(b"mluc"):
            length, at = struct.unpack_from(">II", data, 20)
            return (
                data[at : at + min(length, 120)].decode("utf-16-be", "replace").rstrip("\0")
            )
        (length,) = struct.unpack_from(">I", data, 8)
        return data[12 : 12 + min(length, 60)].decode("ascii", "replace").rstrip("\0")
    except struct.error:
        return ""


def _tags(icc: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", icc, 128)
    entries = (
        struct.unpack_from(">4sII", icc, 132 + 12 * place)
        for place in range(min(count, 100))
    )
    return {name: icc[at : at + size] for name, at, size in entries}


def _curve(data: bytes) -> Curve:
    """Return the curve of a curveType or a parametricCurveType."""
    kind, values = data[:4], data[8:]
    if kind == b"curv":
        (count,) = struct.unpack_from(">I", values)
        if count == 0:
            return lambda x: x
        table = np.array(
            struct.unpack_from(f">{min(count, 65536)}H", values, 4), dtype=np.float64
        )
        if count == 1:
            power = float(table[0]) / 256
            return lambda x: x**power
        return lambda x: np.interp(x, np.linspace(0, 1, table.size), table / 65535)
    if kind == b"para":
        function = struct.unpack_from(">H", values)[0]
        if function < 5:
            numbers = struct.unpack_from(f">{(1, 3, 4, 5, 7)[function]}i", values, 4)
            return _parametric(function, [number / 65536 for number in numbers])
    raise InputError("holds an ICC profile whose tone curve is of no known kind")


def _parametric(function: int, numbers: list[float]) -> Curve:
    """Return ICC.1:2010, table 65: a power of a line, and below d another line."""
    g, a, b, c, d, e, f = [*numbers, *[1.0, 0.0, 0.0, 0.0, 0.0, 0.0][len(numbers) - 1 :]]
    if function in (1, 2):  # c is then what is added, above and below
        d, e, f, c = -b / a, c if function == 2 else 0.0, c if function == 2 else 0.0, 0.0

    def light(x: Floats) -> Floats:
        bent = np.maximum(a * x + b, 0.0) ** g + e
        return np.where(x >= d, bent, c * x + f)

    return light


def _of_png(chunks: dict[bytes, bytes]) -> Encoding:
    """Return a PNG's encoding: a profile before sRGB, and sRGB before a gamma."""
    if profile := chunks.get(b"iCCP"):
        packed = profile.partition(b"\0")[2][1:]
        unpacking = zlib.decompressobj()
        try:
            icc = unpacking.decompress(packed, MOST_PROFILE_BYTES)
        except zlib.error as error:
            raise InputError("holds an ICC profile that is damaged") from error
        if unpacking.unconsumed_tail:
            raise InputError(
                f"holds an ICC profile of more than {MOST_PROFILE_BYTES >> 20} MiB"
            )
        return Encoding(icc=icc)
    if b"sRGB" in chunks:
        return Encoding(srgb=True)
    stored = int.from_bytes(chunks.get(b"gAMA", b""))
    return Encoding(power=100_000 / stored) if stored else Encoding()
