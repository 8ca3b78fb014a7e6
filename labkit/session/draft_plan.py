"""Draft a plan from a photograph: values its file states, and lines marked "fill in" for all others."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from labkit.errors import RawError, printable
from labkit.photographs.container import Container, recognise
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import DIAGONAL_35MM_MM, Exif, read_exif
from labkit.photographs.processed_picture import is_processed, read_file
from labkit.plan import Sensor
from labkit.storage.files import write_new

ANY = Sensor(pixel_pitch_um=1.0)
PITCHES_UM = (0.5, 50.0)
"""Plausible values of any camera; EXIF outside these limits is wrong."""

USUAL_NM = {"R": 605.0, "G": 535.0, "B": 465.0}
"""Where colour filters of cameras let through most, about, in daylight."""

USUAL_STD_NM = 10.0
USUAL_LIGHT = "led-panel"
FILL_IN = "# fill in: "
HOW_TO_FILL_IN = (
    '# Lines marked "fill in" hold what no photograph says, with an example: '
    "put the true value, take the first # away."
)

Row = tuple[str, str, str]
"""Key, value as TOML, and why."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A plan's text, and the keys to fill in before the plan loads."""

    text: str
    fill_in: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Photograph:
    """kind: of file; shape: (rows, cols) of pixels; colours: its channels, empty where the file does not say; unclear: whether
    only the plan can say how its numbers stand to light; white: its largest number."""

    kind: str
    shape: tuple[int, int]
    colours: tuple[str, ...]
    unclear: bool = False
    white: int = 65535


def draft_plan(image: Path | str) -> Draft:
    """Draft a plan for photographs like one.

    Parameters
    ----------
    image : raw file, JPEG, TIFF, PNG or PGM

    Returns
    -------
    the plan's text, and the keys that it leaves to fill in

    Raises
    ------
    RawError
        the file is no readable photograph

    >>> labkit.draft_plan("IMG_0001.NEF").fill_in
    """
    image = Path(image)
    photograph, exif = _looked_at(image)
    blocks = [[*_heading(image, exif, photograph), HOW_TO_FILL_IN]]
    fill_in = []
    for name, rows in _tables(exif, photograph):
        blocks.append([name, *(_line(*row) for row in rows)])
        fill_in += [
            f"{name.strip('[]')}.{key}" for key, _, why in rows if why.startswith(FILL_IN)
        ]
    return Draft(
        "\n\n".join("\n".join(block) for block in blocks) + "\n",
        tuple(dict.fromkeys(fill_in)),
    )


def draft_tables(
    image: Path | None, mono: bool = False
) -> tuple[list[str], list[tuple[str, list[Row]]]]:
    """Return lines of a heading, and a draft's tables: (name with its brackets, rows).

    image: an example of the photographs; None for a raw camera of unknown properties, mono
    or with a colour filter array. A row is (key, value as TOML, reason); the reason begins
    with FILL_IN for an example value. Raises RawError as `draft_plan`.
    """
    if image is None:
        photograph = _Photograph("raw", (0, 0), ("M",) if mono else ("R", "G", "B"))
        return [], _tables(Exif(), photograph)
    photograph, exif = _looked_at(image)
    return [*_heading(image, exif, photograph)], _tables(exif, photograph)


def _tables(exif: Exif, photograph: _Photograph) -> list[tuple[str, list[Row]]]:
    return [
        ("[lens]", [*_lens(exif)]),
        ("[sensor]", [*_sensor(exif, photograph)]),
        *(("[[channel]]", [*_channel(name)]) for name in photograph.colours or ("",)),
        ("[target]", [*_target()]),
    ]


def _looked_at(image: Path) -> tuple[_Photograph, Exif]:
    try:
        return _look(image), read_exif(image)
    except OSError as error:
        raise RawError(f"{image}: {error.strerror}") from error
    except RawError as error:
        raise (
            error if str(image) in str(error) else RawError(f"{image}: {error}")
        ) from error


def write_draft(draft: Draft, path: Path) -> None:
    """Write a draft as a new file. Raises InputError if the file exists or cannot be written."""
    write_new(path, draft.text)


def _look(image: Path) -> _Photograph:
    container = recognise(image)
    if container.kind in ("raw", "jpeg"):
        mosaic = read_photograph(image, ANY)
        colours = (
            tuple(name for name in "RGB" if name in mosaic.cfa)
            if mosaic.cfa != "mono"
            else ("M",)
        )
        return _Photograph(container.kind, mosaic.shape, colours)
    return _of_numbers(image, container)


def _of_numbers(image: Path, container: Container) -> _Photograph:
    """Return the properties of a file of bare numbers."""
    picture = read_file(image)
    rows, cols = picture.numbers.shape[:2]
    if not is_processed(picture, container, ANY):
        return _Photograph(
            container.kind, (rows, cols), (), unclear=False, white=picture.white
        )
    try:
        read_photograph(image, ANY)
    except RawError:
        return _Photograph(container.kind, (rows, cols), ("R", "G", "B"), unclear=True)
    return _Photograph(container.kind, (rows, cols), ("R", "G", "B"))


def _heading(image: Path, exif: Exif, photograph: _Photograph) -> Iterator[str]:
    facts = [
        exif.camera,
        exif.lens and f"lens {exif.lens}",
        exif.taken and f"taken {exif.taken}",
    ]
    facts += [
        f"{exif.exposure_s:g} s" if exif.exposure_s else "",
        f"ISO {exif.iso}" if exif.iso else "",
    ]
    rows, cols = photograph.shape
    yield f"# Made from {printable(image.name)}, {rows} × {cols} pixels"
    yield f"# {', '.join(filter(None, facts)) or 'whose file says nothing of camera and lens'}."


def _lens(exif: Exif) -> Iterator[Row]:
    """Yield (key, value, reason) of each line."""
    focal = exif.focal_length_mm
    stop = exif.f_number
    yield (
        ("focal_length_mm", f"{focal:g}", "by EXIF")
        if focal
        else ("focal_length_mm", "50", f"{FILL_IN}as engraved")
    )
    yield (
        ("f_number", f"{stop:g}", "by EXIF")
        if stop
        else ("f_number", "2.8", f"{FILL_IN}as set on the lens")
    )


def _sensor(exif: Exif, photograph: _Photograph) -> Iterator[Row]:
    pitch_um, why = _pitch(exif, photograph)
    yield "pixel_pitch_um", f"{pitch_um:.4g}", why
    yield "fill_factor", "1.0", "active area over pitch squared; 1 with microlenses"
    if not photograph.colours:
        yield "cfa_pattern", '"mono"', f'{FILL_IN}"mono", or "RGGB" and the like'
        yield "black_level", "0", f"{FILL_IN}the count of no light"
        yield "white_level", str(photograph.white), f"{FILL_IN}the count of saturation"
    elif photograph.kind != "raw" and photograph.colours != ("M",):
        yield "cfa_pattern", '"RGB"', "demosaiced already: every pixel has all colours"
    if photograph.unclear:
        yield (
            "tone_curve",
            '"linear"',
            f'{FILL_IN}"linear" or "sRGB": how the numbers stand to light',
        )


def _pitch(exif: Exif, photograph: _Photograph) -> tuple[float, str]:
    """Return the pixel pitch in micrometres, and its source."""
    low, high = PITCHES_UM
    rows, cols = photograph.shape
    if exif.pixel_pitch_um is not None:
        # a picture made smaller by a program keeps the camera's tags
        shrunk = (
            max(exif.size_px) / max(rows, cols)
            if exif.size_px and photograph.kind != "raw"
            else 1.0
        )
        if low <= exif.pixel_pitch_um * shrunk <= high:
            return exif.pixel_pitch_um * shrunk, "by EXIF, of the focal plane's resolution"
    if exif.focal_length_35mm and exif.focal_length_mm:
        diagonal_mm = DIAGONAL_35MM_MM * exif.focal_length_mm / exif.focal_length_35mm
        pitch_um = 1000 * diagonal_mm / math.hypot(rows, cols)
        if low <= pitch_um <= high:
            return (
                pitch_um,
                "by EXIF, of the focal length on 35 mm film: good to some per cent, better is the data sheet's",
            )
    return 4.0, f"{FILL_IN}from the camera's data sheet, sensor's width over pixels"


def _channel(name: str) -> Iterator[Row]:
    if name in USUAL_NM:
        yield "name", f'"{name}"', "as the camera's filters are named"
        yield (
            "wavelength_nm",
            f"{USUAL_NM[name]:g}",
            f'usual for such a filter; or name your light in place of both lines, light = "{USUAL_LIGHT}"',
        )
        yield "wavelength_std_nm", f"{USUAL_STD_NM:g}", "its standard error"
    else:
        yield (
            "name",
            f'"{name or "M"}"',
            "" if name else 'of "mono" any name; else one table each for R, G, B',
        )
        yield "wavelength_nm", "550", f"{FILL_IN}of the light, or the filter"


def _target() -> Iterator[Row]:
    yield "kind", '"sierpinski"', "or tribar, checkerboard, slanted_edge, noise, image"
    yield "order", "5", f"{FILL_IN}of the carpet"
    yield "size_mm", "46.8", f"{FILL_IN}side of the whole target"
    yield "surround", '"black"', "what lies around it: black, white, unknown"


def _line(key: str, value: str, why: str) -> str:
    if why.startswith(FILL_IN):
        return f"# {key} = {value}  {why}"
    return f"{key} = {value}" + (f"  # {why}" if why else "")
