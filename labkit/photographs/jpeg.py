"""Read the headers of JPEG pictures without decoding."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from labkit.apart import DAMAGED
from labkit.errors import InputError

JPEG = b"\xff\xd8"
EXIF_MARK = b"Exif\0\0"
ICC = b"ICC_PROFILE\0"
APP1 = 0xE1
APP2 = 0xE2
START_OF_SCAN = 0xDA
END = 0xD9
FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of segments that declare a picture's size: all of C0 to CF but tables of Huffman codes and the like."""

ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
"""Markers without a length."""


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """Statements of a JPEG before its pixels.

    Attributes
    ----------
    shape : (rows, cols), or (rows, cols, 3) in colours
    coarse_colours : whether colours have a lower resolution than brightness
    exif, icc : as embedded, empty if absent
    """

    shape: tuple[int, ...]
    coarse_colours: bool
    exif: bytes
    icc: bytes


def read_header(content: bytes) -> JpegHeader:
    """Read the header of a JPEG. Raises InputError for a damaged file, or colours other than grey and RGB."""
    frame = b""
    exif = b""
    profile = dict[int, bytes]()
    for marker, data in _segments(content):
        if marker == APP1 and data.startswith(EXIF_MARK):
            exif = exif or data[len(EXIF_MARK) :]
        elif marker == APP2 and data.startswith(ICC) and len(data) > len(ICC) + 1:
            # numbered: a long profile takes several segments
            profile[data[len(ICC)]] = data[len(ICC) + 2 :]
        elif marker in FRAME_MARKERS:
            frame = frame or data
    if len(frame) < 6 or len(frame) < 6 + 3 * frame[5]:
        raise InputError(DAMAGED)
    bits = frame[0]
    colours = frame[5]
    if bits != 8 or colours not in (1, 3):
        raise InputError(
            f"holds {colours} colours of {bits} bit: allowed in a JPEG are grey and RGB, of 8 bit"
        )
    size = int.from_bytes(frame[1:3]), int.from_bytes(frame[3:5])
    sampling = {frame[7 + 3 * place] for place in range(colours)}
    return JpegHeader(
        size if colours == 1 else (*size, 3),
        len(sampling) > 1,
        exif,
        b"".join(profile[number] for number in sorted(profile)),
    )


def _segments(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (marker, data) of each segment before the pixels. Raises InputError where they do not join."""
    at = len(JPEG)
    while at + 4 <= len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if marker in (START_OF_SCAN, END):
            return
        if marker == 0xFF or marker in ALONE:  # filling
            at += 1 if marker == 0xFF else 2
            continue
        length = int.from_bytes(content[at + 2 : at + 4])
        if length < 2:
            break
        yield marker, content[at + 4 : at + 2 + length]
        at += 2 + length
    raise InputError(DAMAGED)
