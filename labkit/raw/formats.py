"""File formats below the mosaic: told from their content, checked for being whole, bare numbers read."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from labkit.errors import RawError

Numbers = NDArray[np.uint8] | NDArray[np.uint16]

PNG = b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
OTHER_RAW = re.compile(
    rb"IIRO|IIRS|MMOR|IIU\0"  # Olympus, Panasonic
    rb"|FUJIFILMCCD-RAW|\0MRM|FOVb|IIII|MMMM|ARRI"  # Fujifilm, Minolta, Sigma, Phase One, Arri
    rb"|.{4}ftypcrx|.{6}HEAPCCDR",  # Canon CR3, CRW
    re.DOTALL,
)
SPACE = rb"(?:\s+|#[^\n]*\n)+"
PGM = re.compile(rb"P([25])" + SPACE + rb"(\d+)" + SPACE + rb"(\d+)" + SPACE + rb"(\d+)\s")

MIN_IS_WHITE, MIN_IS_BLACK, RGB = 0, 1, 2
MAKE, MODEL, EXPOSURE_S, ISO, DNG_VERSION, DNG_MODEL = 271, 272, 33434, 34855, 50706, 50708


@dataclass(frozen=True, slots=True)
class Container:
    """What a file is, and what its tags say of camera and exposure."""

    kind: Literal["raw", "tiff", "png", "pgm"]
    camera: str = ""
    exposure_s: float | None = None
    iso: int | None = None


def recognise(path: Path) -> Container:
    """What `path` holds, by its content. Raises RawError for a file that is no photograph, or not whole."""
    try:
        with path.open("rb") as file:
            head = file.read(32)
    except OSError as error:
        raise RawError(str(error.strerror)) from error
    if head.startswith(PNG):
        return Container("png")
    if head[:2] in (b"P2", b"P5"):
        return Container("pgm")
    if head.startswith(TIFF):
        return _recognise_tiff(path)
    if OTHER_RAW.match(head):
        return Container("raw")
    if head.startswith(b"\xff\xd8"):
        raise RawError("is a JPEG: its numbers are no longer proportional to light; use the raw file")
    if not head:
        raise RawError("is empty")
    # LibRaw would go by the file's size alone here, and once took a 14 bit crop for a photograph of another shape
    raise RawError("is no photograph: allowed are raw files, and 8 or 16 bit TIFF, PNG and PGM")


def read_numbers(path: Path, container: Container) -> Numbers:
    """(rows, cols) numbers of a TIFF, PNG or PGM file, in the order they are stored. Raises RawError."""
    if container.kind == "tiff":
        numbers = _read_tiff(path)
    else:
        content = path.read_bytes()
        (_check_png if container.kind == "png" else _check_pgm)(content)
        numbers = _decode(content)
    if numbers.ndim != 2:
        raise RawError(f"has {numbers.shape[-1]} colours a pixel: labkit needs the mosaic, one number a pixel")
    if numbers.dtype not in (np.uint8, np.uint16):
        raise RawError(f"holds {numbers.dtype} numbers: allowed are 8 and 16 bit integers")
    return numbers


def _recognise_tiff(path: Path) -> Container:
    """A raw file in TIFF's clothes, or a plain TIFF."""
    try:
        with tifffile.TiffFile(path) as tiff:
            first = tiff.pages.first
            tags = {
                code: tag.value for code in (MAKE, MODEL, EXPOSURE_S, ISO, DNG_MODEL) if (tag := first.tags.get(code))
            }
            _check_strips(tiff, path.stat().st_size)
            plain = DNG_VERSION not in first.tags and first.photometric in (MIN_IS_WHITE, MIN_IS_BLACK, RGB)
    except RawError:
        raise
    except Exception as error:  # tifffile lets through whatever a damaged tag happens to break
        raise RawError(f"is truncated or damaged ({error})") from error
    named = path.suffix.lower() in (".tif", ".tiff")
    return Container(
        "tiff" if plain and (named or MAKE not in tags) else "raw",
        camera=_camera(tags),
        exposure_s=_seconds(tags.get(EXPOSURE_S)),
        iso=int(tags[ISO]) if isinstance(tags.get(ISO), int) else None,
    )


def _check_strips(tiff: tifffile.TiffFile, size: int) -> None:
    """Raise RawError if a page's data would lie beyond the end of the file."""
    pages = [page for page in tiff.pages if isinstance(page, tifffile.TiffPage)]
    for page in pages:
        pages += [sub for sub in page.pages or () if isinstance(sub, tifffile.TiffPage)]
        end = max((at + count for at, count in zip(page.dataoffsets, page.databytecounts, strict=False)), default=0)
        if end > size:
            raise RawError(f"is truncated: {size} bytes, but its tags say at least {end}")


def _camera(tags: dict[int, Any]) -> str:
    words = [str(tags[code]).strip(" \0") for code in (MAKE, MODEL) if code in tags]
    return " ".join(words) or str(tags.get(DNG_MODEL, "")).strip(" \0")


def _seconds(value: object) -> float | None:
    match value:
        case (int(over), int(under)) if under:
            return over / under
    return None


def _read_tiff(path: Path) -> NDArray[Any]:
    try:
        with tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            if page.photometric == MIN_IS_WHITE:
                raise RawError("counts darkness (MinIsWhite): labkit needs numbers that grow with light")
            if len(tiff.pages) > 1:
                raise RawError(f"holds {len(tiff.pages)} pictures: allowed is one")
            try:
                return page.asarray()
            except ValueError as error:
                if "imagecodecs" not in str(error):
                    raise
        return _decode(path.read_bytes())
    except RawError:
        raise
    except Exception as error:  # as in _recognise_tiff
        raise RawError(f"is truncated or damaged ({error})") from error


def _decode(content: bytes) -> NDArray[Any]:
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise RawError("is truncated or damaged")
    return np.asarray(picture)


def _check_png(content: bytes) -> None:
    """Raise RawError unless a PNG is whole, grey, and of 8 or 16 bit. cv2 would decode a damaged one in part."""
    at, name = len(PNG), b""
    while name != b"IEND":
        length, name = int.from_bytes(content[at : at + 4]), content[at + 4 : at + 8]
        end = at + 8 + length
        if len(content) < end + 4 or zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4]):
            raise RawError("is truncated or damaged")
        at = end + 4
    bits, colours = content[24], content[25]
    if colours != 0:
        raise RawError("has colours or transparency: labkit needs the mosaic, one number a pixel")
    if bits not in (8, 16):
        raise RawError(f"holds {bits} bit numbers: allowed are 8 and 16 bit")


def _check_pgm(content: bytes) -> None:
    """Raise RawError unless a PGM is whole."""
    header = PGM.match(content)
    if not header:
        raise RawError("is a damaged PGM: its header cannot be read")
    binary, (cols, rows, most) = header[1] == b"5", (int(number) for number in header.groups()[1:])
    if not 1 <= most <= 65535:
        raise RawError(f"has a largest number of {most}: allowed is 1 to 65535")
    rest = content[header.end() :]
    there, needed = (len(rest), rows * cols * (2 if most > 255 else 1)) if binary else (len(rest.split()), rows * cols)
    if there < needed:
        raise RawError(f"is truncated: {there} of {needed} {'bytes' if binary else 'numbers'} are there")
