"""Read lens, body and exposure from a photograph's EXIF tags, whatever the file's type."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from PIL import Image
from PIL.ExifTags import IFD, Base

from labkit.errors import InputError
from labkit.photographs.metadata import LONGEST_STATEMENT, refuse_impossible
from labkit.photographs.picture_file import JPEG, PNG, TIFF, png_chunks, read_header
from labkit.storage.apart import run_apart
from labkit.storage.reading import opened_photograph

UNIT_UM = {2: 25_400.0, 3: 10_000.0, 4: 1000.0, 5: 1.0}
"""Of FocalPlaneResolutionUnit."""

DIAGONAL_35MM_MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True, slots=True)
class Exif:
    """Statements of a file; empty or None where the file states nothing.

    focal_length_35mm: of the same angle of view on 24 × 36 mm; pixel_pitch_um: as the focal
    plane's resolution has it;
    size_px: (rows, cols) that the camera wrote; taken: as "2026:11:22 09:08:07".
    """

    camera: str = ""
    camera_serial: str = ""
    lens: str = ""
    lens_serial: str = ""
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None
    f_number: float | None = None
    exposure_s: float | None = None
    iso: int | None = None
    pixel_pitch_um: float | None = None
    size_px: tuple[int, int] | None = None
    taken: str = ""

    def __post_init__(self) -> None:
        words = (self.camera, self.camera_serial, self.lens, self.lens_serial, self.taken)
        lengths = (self.focal_length_mm, self.focal_length_35mm, self.pixel_pitch_um)
        refuse_impossible(
            words,
            (*lengths, self.f_number, self.exposure_s, self.iso, *(self.size_px or ())),
        )


def read_exif(path: Path) -> Exif:
    """Read the EXIF of a JPEG, TIFF, PNG or raw file; damaged tags count as not stated.

    Raises OSError for a file that cannot be read.
    """
    try:
        return run_apart(_read_exif, path)
    except InputError:
        return Exif()


def _read_exif(path: Path) -> Exif:
    with opened_photograph(path) as file:
        head = file.read(len(PNG))
        file.seek(0)
        try:
            if head.startswith(JPEG):
                return of_tags(_tags(BytesIO(read_header(file.read()).exif)))
            if head.startswith(PNG):
                chunks = {name: data for name, data, _ in png_chunks(file.read())}
                return of_tags(_tags(BytesIO(chunks.get(b"eXIf", b""))))
            return of_tags(_tags(file)) if head.startswith(TIFF) else _of_raw(path)
        except InputError:
            return Exif()


def of_tags(tags: Mapping[int, Any]) -> Exif:
    """Return the statements of EXIF tags, by number."""
    unit = UNIT_UM.get(whole_number(tags.get(Base.FocalPlaneResolutionUnit)) or 2)
    resolution = positive_number(tags.get(Base.FocalPlaneXResolution))
    rows, cols = (
        whole_number(tags.get(Base.ExifImageHeight)),
        whole_number(tags.get(Base.ExifImageWidth)),
    )
    return Exif(
        camera=_joined(tags, Base.Make, Base.Model)
        or _text(tags.get(Base.UniqueCameraModel)),
        camera_serial=_text(tags.get(Base.BodySerialNumber)),
        lens=_joined(tags, Base.LensMake, Base.LensModel),
        lens_serial=_text(tags.get(Base.LensSerialNumber)),
        focal_length_mm=positive_number(tags.get(Base.FocalLength)),
        focal_length_35mm=positive_number(tags.get(Base.FocalLengthIn35mmFilm)),
        f_number=positive_number(tags.get(Base.FNumber)),
        exposure_s=positive_number(tags.get(Base.ExposureTime)),
        iso=whole_number(tags.get(Base.ISOSpeedRatings)),
        pixel_pitch_um=unit / resolution if unit and resolution else None,
        size_px=(rows, cols) if rows and cols else None,
        taken=_text(tags.get(Base.DateTimeOriginal) or tags.get(Base.DateTime)),
    )


def _tags(file: BinaryIO) -> dict[int, Any]:
    """Return the first directory of a TIFF structure with its Exif directory; nothing of a damaged one."""
    exif = Image.Exif()
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # Pillow warns of each tag that it cannot read: it is not stated then
        try:
            exif.load_from_fp(file)
            return {**exif, **exif.get_ifd(IFD.Exif)}
        except Exception:  # of whatever a damaged tag breaks
            return {}


def _of_raw(path: Path) -> Exif:
    """Return the statements of a raw file that is no TIFF, by LibRaw."""
    import rawpy

    from labkit.photographs.libraw import captured_stderr, opened_raw

    with captured_stderr():
        try:
            with opened_raw(path) as raw:
                other, lens = raw.other, raw.lens
        except rawpy.LibRawError:
            return Exif()
    return Exif(
        lens=_text(lens.model),
        focal_length_mm=positive_number(other.focal_length),
        f_number=positive_number(other.aperture),
        exposure_s=positive_number(other.shutter_speed),
        iso=whole_number(other.iso_speed),
    )


def positive_number(value: Any) -> float | None:
    """Return the number in a tag; None for anything but a finite number above 0."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def whole_number(value: Any) -> int | None:
    """Return the number in a tag, or the first of several, rounded; None as of `positive_number`, and for 0."""
    number = positive_number(value[0] if isinstance(value, tuple) and value else value)
    return None if number is None else round(number) or None


def _text(value: Any) -> str:
    text = (
        value.decode("ascii", "replace")
        if isinstance(value, bytes)
        else value
        if isinstance(value, str)
        else ""
    )
    words = "".join(letter if letter.isprintable() else " " for letter in text).split()
    return " ".join(words)[:LONGEST_STATEMENT]


def _joined(tags: Mapping[int, Any], maker: int, model: int) -> str:
    """Return a maker before a model, unless the model's name begins with the maker's."""
    made, name = _text(tags.get(maker)), _text(tags.get(model))
    known = made and name.lower().startswith(made.split()[0].lower())
    return name if known else f"{made} {name}".strip()[:LONGEST_STATEMENT]
