"""JPEG pictures: what their headers state, read without decoding anything, and the numbers as they are stored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from labkit.errors import InputError
from labkit.photographs.picture_file import (
    DAMAGED,
    MOST_PIXELS,
    Picture,
    check_size,
    decode,
)

JPEG = b"\xff\xd8"
EXIF, ICC = b"Exif\0\0", b"ICC_PROFILE\0"
APP1, APP2, START_OF_SCAN, END = 0xE1, 0xE2, 0xDA, 0xD9
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of segments that declare a picture's size: all of C0 to CF but tables of Huffman codes and the like."""

ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
"""Markers that no length follows."""


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """What a JPEG states before its pixels.

    colours: numbers a pixel, 1 or 3; coarse_colours: colours are stored at a lower resolution than brightness;
    exif, icc: as embedded, empty where there is none.
    """

    rows: int
    cols: int
    colours: int
    coarse_colours: bool
    exif: bytes
    icc: bytes


def read_header(content: bytes) -> JpegHeader:
    """The header of a JPEG. Raises InputError for one that is damaged, or neither grey nor of three colours."""
    frame, exif, profile = b"", b"", dict[int, bytes]()
    for marker, data in _segments(content):
        if marker == APP1 and data.startswith(EXIF):
            exif = exif or data[len(EXIF) :]
        elif marker == APP2 and data.startswith(ICC) and len(data) > len(ICC) + 1:
            profile[data[len(ICC)]] = data[
                len(ICC) + 2 :
            ]  # numbered: a long profile lies in several segments
        elif marker in FRAMES:
            frame = frame or data
    if len(frame) < 6 or len(frame) < 6 + 3 * frame[5]:
        raise InputError(DAMAGED)
    bits, colours = frame[0], frame[5]
    if bits != 8 or colours not in (1, 3):
        raise InputError(
            f"holds {colours} colours of {bits} bit: allowed in a JPEG are grey and RGB, of 8 bit"
        )
    sampling = {frame[7 + 3 * place] for place in range(colours)}
    return JpegHeader(
        rows=int.from_bytes(frame[1:3]),
        cols=int.from_bytes(frame[3:5]),
        colours=colours,
        coarse_colours=len(sampling) > 1,
        exif=exif,
        icc=b"".join(profile[number] for number in sorted(profile)),
    )


def read_jpeg(path: Path, most_pixels: int = MOST_PIXELS) -> tuple[Picture, JpegHeader]:
    """The picture in a JPEG file, not turned whatever it says of its orientation, and its header.

    Raises OSError where it cannot be read, InputError, its message without the file's name, where it is damaged or too large.
    """
    content = path.read_bytes()
    header = read_header(content)
    check_size((header.rows, header.cols), most_pixels)
    shape = (
        (header.rows, header.cols) if header.colours == 1 else (header.rows, header.cols, 3)
    )
    return Picture(decode("JPEG", content, shape, 8), 8, 255), header


def _segments(content: bytes) -> Iterator[tuple[int, bytes]]:
    """(marker, data) of each segment before the pixels. Raises InputError where they do not join."""
    at = len(JPEG)
    while at + 4 <= len(content):
        if content[at] != 0xFF:
            break
        marker = content[at + 1]
        if marker == 0xFF or marker in ALONE:  # filling
            at += 1 if marker == 0xFF else 2
            continue
        if marker in (START_OF_SCAN, END):
            return
        length = int.from_bytes(content[at + 2 : at + 4])
        if length < 2:
            break
        yield marker, content[at + 4 : at + 2 + length]
        at += 2 + length
    raise InputError(DAMAGED)
