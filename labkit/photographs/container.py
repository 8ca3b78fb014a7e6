"""Formats of files, recognised by their content and checked for being whole."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import tifffile

from labkit.errors import InputError, RawError, shown
from labkit.photographs.exif import read_exif
from labkit.photographs.metadata import refuse_impossible
from labkit.photographs.picture_file import (
    JPEG,
    OTHER_COLOURS,
    check_strips,
    format_of,
)
from labkit.storage.apart import run_apart
from labkit.storage.reading import opened_photograph

OTHER_RAW = re.compile(
    rb"IIRO|IIRS|MMOR|IIU\0"  # Olympus, Panasonic
    rb"|FUJIFILMCCD-RAW|\0MRM|FOVb|IIII|MMMM|ARRI"  # Fujifilm, Minolta, Sigma, Phase One, Arri
    rb"|.{4}ftypcrx|.{6}HEAPCCDR",  # Canon CR3, CRW
    re.DOTALL,
)
RAW_SUFFIXES = re.compile(
    r"\.(3fr|ar[iw]|cr[23w]|dcr|dng|erf|fff|iiq|kdc|mos|mrw|n[er][fw]|orf|pef|ra[fw]|rw2|sr[2fw]|x3f)",
    re.IGNORECASE,
)
"""Endings of cameras' raw files."""

PLAIN_PHOTOMETRICS = (0, 1, 2, *OTHER_COLOURS)  # white or black is zero, RGB
MAKE, DNG_VERSION = 271, 50706
CFA_SIZE, CFA_LAYOUT = 33421, 50711
"""Tags of a TIFF."""

OTHER_PICTURES = {
    rb"P[13467fF]\s": "a picture in PBM, PPM, PFM or PAM",
    rb"GIF8": "a GIF",
    rb"BM": "a BMP",
    rb"RIFF.{4}WEBP": "a WebP",
    rb".{4}ftyp": "a picture in HEIF or AVIF, or a film",
    rb"(\0\0\0\x0cjP  |\xffO\xffQ)": "a JPEG 2000",
    rb"v/1\x01": "an OpenEXR",
    rb"SIMPLE  =": "a FITS",
    rb"8BPS": "a Photoshop document",
    rb"%PDF": "a PDF",
}
"""Files of pictures that are not read, by their first bytes."""

Kind = Literal["raw", "tiff", "png", "pgm", "jpeg", "headerless"]


@dataclass(frozen=True, slots=True)
class Container:
    """The type of a file, and camera, exposure and filter array by its tags.

    cfa_px: (rows, columns) of the filter array's cell, by tags of a raw file in TIFF's form; None if not stated
    staggered: whether its rows or columns are shifted against each other
    """

    kind: Kind
    camera: str = ""
    exposure_s: float | None = None
    iso: int | None = None
    cfa_px: tuple[int, int] | None = None
    staggered: bool = False

    def __post_init__(self) -> None:
        refuse_impossible((self.camera,), (self.exposure_s, self.iso))


def recognise(path: Path) -> Container:
    """Return the type of a file by its content. Raises RawError for a file that is no photograph, or not whole."""
    try:
        return run_apart(_recognise, path)
    except RawError:
        raise
    except InputError as error:
        raise RawError(str(error)) from error


def _recognise(path: Path) -> Container:
    try:
        with opened_photograph(path) as file:
            head = file.read(32)
    except OSError as error:
        raise RawError(str(error.strerror)) from error
    match format_of(head):
        case "png" | "pgm" as kind:
            return Container(kind)
        case "tiff":
            return _recognise_tiff(path)
    if OTHER_RAW.match(head):
        return Container("raw")
    if head.startswith(JPEG):
        if RAW_SUFFIXES.fullmatch(path.suffix):
            raise RawError(
                f"is a JPEG, though its name ends in {path.suffix}: give the camera's raw file, or name it .jpg"
            )
        return _described("jpeg", path)
    if not head:
        raise RawError("is empty")
    # LibRaw would go by the file's size alone here, and once took a 14 bit crop for a photograph of another shape
    kinds = (name for first, name in OTHER_PICTURES.items() if re.match(first, head, re.S))
    raise RawError(
        f"is {next(kinds, 'no photograph')}: allowed are raw files, JPEG, and 8 or 16 bit TIFF, PNG and PGM"
    )


def _recognise_tiff(path: Path) -> Container:
    """Recognise a raw file in TIFF's form, or a plain TIFF."""
    try:
        with opened_photograph(path) as file, tifffile.TiffFile(file) as tiff:
            first = tiff.pages.first
            check_strips(tiff)
            plain = (
                DNG_VERSION not in first.tags and first.photometric in PLAIN_PHOTOMETRICS
            )
            made = MAKE in first.tags
            cfa = _filter_array(tiff)
    except InputError as error:
        raise RawError(str(error)) from error
    # tifffile lets through whatever a damaged tag happens to break
    except Exception as error:
        raise RawError(f"is truncated or damaged ({shown(str(error))})") from error
    named = path.suffix.lower() in (".tif", ".tiff")
    if plain and (named or not made):
        return _described("tiff", path)
    cfa_px, staggered = cfa
    return replace(_described("raw", path), cfa_px=cfa_px, staggered=staggered)


def _filter_array(tiff: tifffile.TiffFile) -> tuple[tuple[int, int] | None, bool]:
    """Return (rows, columns) of the filter array's cell by its tags, and whether the array is staggered.

    LibRaw reads the first four places of a cell of any size as two by two.
    """
    pages = [page for page in tiff.pages if isinstance(page, tifffile.TiffPage)]
    for page in pages:
        pages += [sub for sub in page.pages or () if isinstance(sub, tifffile.TiffPage)]
        if (size := page.tags.get(CFA_SIZE)) is not None:
            rows, columns = size.value
            layout = page.tags.get(CFA_LAYOUT)
            return (rows, columns), layout is not None and layout.value != 1
    return None, False


def _described(kind: Kind, path: Path) -> Container:
    """Return a container with camera and exposure as the file states them."""
    exif = read_exif(path)
    return Container(kind, exif.camera, exif.exposure_s, exif.iso)
