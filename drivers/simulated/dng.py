"""Write raw photographs: DNG for a colour mosaic, TIFF for a mono sensor. rawpy opens the DNG like any
camera's.

Tags of the DNG specification 1.4; shutter time and ISO are in an Exif directory, where
decoders expect them.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from labkit.files import write_atomically
from labkit.version import __version__

CFA_COLOURS = {"R": 0, "G": 1, "B": 2}
CFA_PHOTOMETRIC = 32803
EXIF_TAG = 34665
KEPT_FOR_EXIF = EXIF_TAG - 1
"""Placeholder for the Exif entry, which tifffile cannot write: it is changed to Exif afterwards."""

BYTE = 1
ASCII = 2
SHORT_TYPE = 3
LONG = 4
RATIONAL = 5
SRATIONAL = 10


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
    buffer = io.BytesIO()
    mono = tags.pattern == "mono"
    with tifffile.TiffWriter(buffer, byteorder="<") as writer:
        writer.write(
            counts,
            photometric="minisblack" if mono else CFA_PHOTOMETRIC,
            contiguous=False,
            metadata=None,
            software=f"labkit {__version__}",
            datetime=tags.taken,
            extratags=_camera_tags(tags) + ([] if mono else _mosaic_tags(tags)),
        )
    _append_exif(buffer, tags)
    write_atomically(path, buffer.getvalue())


def _append_exif(file: io.BytesIO, tags: RawTags) -> None:
    """Append an Exif directory to a little-endian TIFF, and write its offset into the entry reserved for it."""
    entries = []
    at = file.seek(0, io.SEEK_END)
    at += at % 2
    seconds = Fraction(tags.exposure_s or 0).limit_denominator(1_000_000)
    if tags.exposure_s is not None:
        entries.append(struct.pack("<HHII", 33434, RATIONAL, 1, at))
    if tags.iso is not None:
        entries.append(struct.pack("<HHIHH", 34855, SHORT_TYPE, 1, tags.iso, 0))
    file.seek(at)
    file.write(struct.pack("<II", seconds.numerator, seconds.denominator))
    file.write(struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4))
    file.seek(0)
    with tifffile.TiffFile(file) as tiff:
        kept = tiff.pages.first.tags[KEPT_FOR_EXIF].offset
        file.seek(kept)
        file.write(struct.pack("<HHII", EXIF_TAG, LONG, 1, at + 8))


def _camera_tags(tags: RawTags) -> list[tuple[int, int, int, object, bool]]:
    """Make, model, orientation and the place of the Exif directory as (code, type, count, value, once)."""
    return [
        (271, ASCII, 0, tags.make, True),
        (272, ASCII, 0, tags.model, True),
        (274, SHORT_TYPE, 1, tags.orientation, True),
        (KEPT_FOR_EXIF, LONG, 1, 0, True),
    ]


def _mosaic_tags(tags: RawTags) -> list[tuple[int, int, int, object, bool]]:
    """Return the tags of a DNG: colour cell, levels, and a colour matrix (the identity: colours mean nothing
    here).
    """
    black = (
        tags.black_level if isinstance(tags.black_level, tuple) else (tags.black_level,) * 4
    )
    unit = tuple(number for i in range(9) for number in (int(i % 4 == 0), 1))
    return [
        (33421, SHORT_TYPE, 2, (2, 2), True),
        (33422, BYTE, 4, bytes(CFA_COLOURS[colour] for colour in tags.pattern), True),
        (50706, BYTE, 4, bytes((1, 4, 0, 0)), True),
        (50707, BYTE, 4, bytes((1, 1, 0, 0)), True),
        (50708, ASCII, 0, f"{tags.make} {tags.model}", True),
        (50713, SHORT_TYPE, 2, (2, 2), True),
        (50714, LONG, 4, black, True),
        (50717, LONG, 1, tags.white_level, True),
        (50721, SRATIONAL, 9, unit, True),
        (50728, RATIONAL, 3, (1, 1) * 3, True),
        (50778, SHORT_TYPE, 1, 21, True),
    ]
