"""Write raw photographs: DNG for a colour mosaic, TIFF for a mono sensor. rawpy opens the DNG like any
camera's.

Tags of TIFF 6.0 and of the DNG specification 1.4; the DNG's counts are compressed without
loss, and shutter time and ISO are in an Exif directory, as cameras write them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.lossless_jpeg import compress_counts
from labkit.storage.files import write_atomically
from labkit.version import __version__

CFA_COLOURS = {"R": 0, "G": 1, "B": 2}
CFA_PHOTOMETRIC = 32803
BLACK_IS_ZERO = 1
PLAIN_COUNTS, LOSSLESS_JPEG = 1, 7
COUNTS_AT = 8
"""Place of the counts in the file, after its header."""

BYTE = 1
ASCII = 2
SHORT_TYPE = 3
LONG = 4
RATIONAL = 5
SRATIONAL = 10
FORM = {BYTE: "B", ASCII: "B", SHORT_TYPE: "H", LONG: "I", RATIONAL: "2I", SRATIONAL: "2i"}
"""Forms of a value, for `struct`, by types of TIFF."""

Entry = tuple[int, int, Sequence[int]]
"""A tag, the type of its values, and these in the order of the file."""


@dataclass(frozen=True, slots=True)
class RawTags:
    """Metadata of a raw file.

    pattern: the 2x2 cell read row by row, e.g. "GBRG", or "mono"; black_level: one number,
    or one for each place of the cell; orientation: the TIFF flag 1..8, for viewers only,
    which leaves the samples unchanged.
    """

    pattern: str = "RGGB"
    black_level: int | tuple[int, int, int, int] = 0
    white_level: int = 65535
    orientation: int = 1
    exposure_s: float | None = None
    iso: int | None = None
    make: str = "labkit"
    model: str = "simulated bench"
    taken: datetime | None = None

    def __post_init__(self) -> None:
        if self.pattern != "mono" and (
            len(self.pattern) != 4 or set(self.pattern) - set(CFA_COLOURS)
        ):
            raise ValueError(
                f'a pattern is "mono" or four of R, G and B, not {self.pattern!r}'
            )
        if not 1 <= self.orientation <= 8:
            raise ValueError(f"an orientation is 1 to 8, not {self.orientation}")


def write_raw(path: Path, counts: NDArray[np.uint16], tags: RawTags) -> None:
    """Write (rows, cols) counts as a DNG, or as a 16-bit TIFF if the pattern is "mono"; whole or not at all."""
    if counts.dtype != np.uint16 or counts.ndim != 2:
        raise ValueError(
            f"raw counts are a table of uint16, not {counts.dtype} of shape {counts.shape}"
        )
    mono = tags.pattern == "mono"
    data = counts.astype("<u2").tobytes() if mono else _compressed(counts, tags)
    exif_at = COUNTS_AT + len(data) + len(data) % 2
    exif = _directory(_exposure_entries(tags), exif_at)
    entries = [
        *_image_entries(counts.shape, len(data), mono),
        *_camera_entries(tags),
        *([] if mono else _mosaic_entries(tags)),
        (34665, LONG, (exif_at,)),
    ]
    main_at = exif_at + len(exif)
    header = struct.pack("<2sHI", b"II", 42, main_at)
    parts = [header, data, bytes(len(data) % 2), exif, _directory(entries, main_at)]
    write_atomically(path, b"".join(parts))


def _compressed(counts: NDArray[np.uint16], tags: RawTags) -> bytes:
    """Return the counts as lossless JPEG of as many bits as counts and white level need."""
    bits = max(int(counts.max()), tags.white_level).bit_length()
    return compress_counts(counts, bits, 1 if counts.shape[1] % 2 else 2)


def _directory(entries: Sequence[Entry], at: int) -> bytes:
    """Return a TIFF directory, the file's last, that begins at byte `at`, and the values that its entries point to."""
    beyond = at + 2 + 12 * len(entries) + 4
    fields = b""
    values = b""
    for code, kind, numbers in sorted(entries):
        form = FORM[kind]
        packed = struct.pack(f"<{len(numbers) * form[-1]}", *numbers)
        count = len(numbers) // (2 if form[0] == "2" else 1)
        if len(packed) > 4:
            place = struct.pack("<I", beyond + len(values))
            values += packed + bytes(len(packed) % 2)
        else:
            place = packed.ljust(4, b"\0")
        fields += struct.pack("<HHI", code, kind, count) + place
    return struct.pack("<H", len(entries)) + fields + bytes(4) + values


def _text(words: str) -> Sequence[int]:
    return words.encode("ascii", "replace") + b"\0"


def _image_entries(shape: tuple[int, ...], size: int, mono: bool) -> list[Entry]:
    """Return entries of the table of counts, which is one strip of `size` bytes."""
    rows, cols = shape
    return [
        (254, LONG, (0,)),
        (256, LONG, (cols,)),
        (257, LONG, (rows,)),
        (258, SHORT_TYPE, (16,)),
        (259, SHORT_TYPE, (PLAIN_COUNTS if mono else LOSSLESS_JPEG,)),
        (262, SHORT_TYPE, (BLACK_IS_ZERO if mono else CFA_PHOTOMETRIC,)),
        (273, LONG, (COUNTS_AT,)),
        (277, SHORT_TYPE, (1,)),
        (278, LONG, (rows,)),
        (279, LONG, (size,)),
    ]


def _camera_entries(tags: RawTags) -> list[Entry]:
    """Return make, model, orientation, software, and the date if stated."""
    taken = [] if tags.taken is None else [f"{tags.taken:%Y:%m:%d %H:%M:%S}"]
    return [
        (271, ASCII, _text(tags.make)),
        (272, ASCII, _text(tags.model)),
        (274, SHORT_TYPE, (tags.orientation,)),
        (305, ASCII, _text(f"labkit {__version__}")),
        *((306, ASCII, _text(date)) for date in taken),
    ]


def _exposure_entries(tags: RawTags) -> list[Entry]:
    """Return shutter time and ISO, where stated."""
    entries = list[Entry]()
    if tags.exposure_s is not None:
        seconds = Fraction(tags.exposure_s).limit_denominator(1_000_000)
        entries.append((33434, RATIONAL, (seconds.numerator, seconds.denominator)))
    if tags.iso is not None:
        entries.append((34855, SHORT_TYPE, (tags.iso,)))
    return entries


def _mosaic_entries(tags: RawTags) -> list[Entry]:
    """Return entries of a DNG: colour cell, levels, and a colour matrix (the identity: colours mean nothing
    here).
    """
    black = (
        tags.black_level if isinstance(tags.black_level, tuple) else (tags.black_level,) * 4
    )
    unit = tuple(number for i in range(9) for number in (int(i % 4 == 0), 1))
    return [
        (33421, SHORT_TYPE, (2, 2)),
        (33422, BYTE, tuple(CFA_COLOURS[colour] for colour in tags.pattern)),
        (50706, BYTE, (1, 4, 0, 0)),
        (50707, BYTE, (1, 1, 0, 0)),
        (50708, ASCII, _text(f"{tags.make} {tags.model}")),
        (50713, SHORT_TYPE, (2, 2)),
        (50714, LONG, black),
        (50717, LONG, (tags.white_level,)),
        (50721, SRATIONAL, unit),
        (50728, RATIONAL, (1, 1) * 3),
        (50778, SHORT_TYPE, (21,)),
    ]
