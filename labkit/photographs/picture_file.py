"""Pictures in PNG, PGM, TIFF and JPEG files: the numbers as they are stored, and the segments of a JPEG.

The format is recognised by the first bytes, whatever the name. Declared sizes are checked before anything is decoded, and
all is read in the process with limits of memory and time of `labkit.storage.apart`: a damaged file ends in a message, quickly.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from math import prod
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import tifffile
from numpy.typing import NDArray

from labkit.errors import InputError, shown
from labkit.storage.apart import DAMAGED, run_apart
from labkit.storage.reading import opened_photograph

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


Numbers = NDArray[np.unsignedinteger]
"""Of 8 or 16 bit."""

Format = Literal["png", "pgm", "tiff"]

MOST_PICTURE_PIXELS = 2**28
"""Of any picture: the largest sensors have 150 million."""

MOST_PER_SIDE = 2**16

PNG = b"\x89PNG\r\n\x1a\n"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
SPACE = rb"(?:\s|#[^\n]*\n)+"
PGM = re.compile(
    rb"P([25])" + SPACE + rb"(\d{1,9})" + SPACE + rb"(\d{1,9})" + SPACE + rb"(\d{1,9})\s"
)

PNG_NEEDED = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
"""Chunks decoded: texts and profiles may swell to any size and are left out."""

ADAM7 = (
    (0, 0, 8, 8),
    (0, 4, 8, 8),
    (4, 0, 8, 4),
    (0, 2, 4, 4),
    (2, 0, 4, 2),
    (0, 1, 2, 2),
    (1, 0, 2, 1),
)
"""Passes of an interlaced PNG: first row, first column, steps down and right."""

GREY, TRUE_COLOUR, PALETTE = 0, 2, 3
GREY_ALPHA, COLOUR_ALPHA = 4, 6
TRANSPARENT = "has transparency: save it without, as grey or RGB"

WHITE_IS_ZERO = 0
UNCOMPRESSED = 1
DEFLATED = (8, 32946)
PLANES_APART = 2
BLENDED, UNBLENDED = 1, 2
"""Kinds of a TIFF's extra samples that are transparency, as premultiplied and as plain alpha."""

OTHER_COLOURS = {
    3: "a palette",
    4: "a mask",
    5: "the inks of CMYK",
    6: "YCbCr",
    8: "CIE L*a*b*",
    9: "ICC L*a*b*",
    10: "ITU L*a*b*",
}
"""Colours of a TIFF that are not used, by PhotometricInterpretation."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture's numbers.

    Attributes
    ----------
    numbers : (rows, cols), or (rows, cols, 3) in colours
    bits : of each number, as stored
    white : number of full scale
    coarse_colours : whether colours have a lower resolution than brightness
    """

    numbers: Numbers
    bits: int
    white: int
    coarse_colours: bool = False

    def __post_init__(self) -> None:
        shape = self.numbers.shape
        if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)):
            raise ValueError(f"a picture of shape {shape}: rows, columns and three colours")
        if not (1 <= self.bits <= 16 and 1 <= self.white < 2**16):
            raise ValueError(f"numbers of {self.bits} bits up to {self.white}")


def format_of(head: bytes) -> Format | None:
    """Return the format of a file that begins with these bytes, four or more; None for any other."""
    if head.startswith(PNG[:4]):
        return "png"
    if head.startswith((b"P2", b"P5")):
        return "pgm"
    return "tiff" if head.startswith(TIFF) else None


def read_picture(
    path: Path, most_pixels: int = MOST_PICTURE_PIXELS, *, processed: bool = False
) -> Picture:
    """Read the picture in a PNG, PGM or TIFF file, in the file's orientation.

    Parameters
    ----------
    path : the file
    most_pixels : largest size allowed
    processed : allow JPEG and colours of 16 bit too

    Raises
    ------
    OSError : the file cannot be read
    InputError : it is damaged, too large or of another kind; the message leaves out the file's name
    """
    picture = run_apart(_read_picture, path, most_pixels, processed=processed)
    _check_size(picture.numbers.shape, most_pixels)
    return picture


def _read_picture(path: Path, most_pixels: int, *, processed: bool) -> Picture:
    with opened_photograph(path) as file:
        head = file.read(len(PNG))
        file.seek(0)
        if format_of(head) == "tiff":
            return _read_tiff(file, most_pixels, processed)
        content = file.read()
    match format_of(head):
        case "png":
            return _read_png(content, most_pixels, processed)
        case "pgm":
            return _read_pgm(content, most_pixels)
    if processed and head.startswith(JPEG):
        header = read_header(content)
        _check_size(header.shape, most_pixels)
        numbers = _decoded("JPEG", content, header.shape, 8)
        return Picture(numbers, 8, 255, header.coarse_colours)
    raise InputError("is no PNG, PGM or TIFF" if head else "is empty")


def check_strips(tiff: tifffile.TiffFile) -> None:
    """Raise InputError if a page's data would lie beyond the end of the file."""
    size = tiff.filehandle.size
    pages = [page for page in tiff.pages if isinstance(page, tifffile.TiffPage)]
    for page in pages:
        pages += [sub for sub in page.pages or () if isinstance(sub, tifffile.TiffPage)]
        end = max(
            (
                at + count
                for at, count in zip(page.dataoffsets, page.databytecounts, strict=False)
            ),
            default=0,
        )
        if end > size:
            raise InputError(
                f"is truncated: {size} bytes, but its tags state at least {end}"
            )


def _check_size(shape: tuple[int, ...], most_pixels: int) -> None:
    """Raise InputError for a declared size, (rows, columns) or more, that is not allowed."""
    words = " × ".join(map(str, shape))
    if not all(1 <= side <= MOST_PER_SIDE for side in shape[:2]):
        raise InputError(
            f"declares {words} pixels: allowed are 1 to {MOST_PER_SIDE} a side"
        )
    if prod(shape[:2]) > most_pixels:
        raise InputError(
            f"declares {words} pixels: allowed are {most_pixels / 1e6:.0f} million in all"
        )


def _read_png(content: bytes, most_pixels: int, processed: bool) -> Picture:
    chunks = png_chunks(content)
    header = chunks[0][1]
    cols, rows, bits, colours = (
        int.from_bytes(header[:4]),
        int.from_bytes(header[4:8]),
        header[8],
        header[9],
    )
    _check_size((rows, cols), most_pixels)
    if colours in (GREY_ALPHA, COLOUR_ALPHA) or any(
        name == b"tRNS" for name, _, _ in chunks
    ):
        raise InputError(TRANSPARENT)
    if colours not in (GREY, TRUE_COLOUR, PALETTE):
        raise InputError(f"{DAMAGED}: its header states colours of type {colours}")
    if colours == TRUE_COLOUR and bits == 16 and not processed:
        raise InputError(f"has colours of {bits} bit: allowed is grey")
    _check_pixels(header, b"".join(data for name, data, _ in chunks if name == b"IDAT"))
    needed = b"".join(whole for name, _, whole in chunks if name in PNG_NEEDED)
    shape = (rows, cols) if colours == GREY else (rows, cols, 3)
    numbers = _decoded("PNG", PNG + needed, shape, max(bits, 8))
    return Picture(numbers, bits, int(np.iinfo(numbers.dtype).max))


def png_chunks(content: bytes) -> list[tuple[bytes, bytes, bytes]]:
    """Return (name, data, whole) of each chunk of a PNG. Raises InputError for missing chunks and wrong checksums."""
    at, name = len(PNG), b""
    chunks: list[tuple[bytes, bytes, bytes]] = []
    while name != b"IEND":
        length, name = int.from_bytes(content[at : at + 4]), content[at + 4 : at + 8]
        end = at + 8 + length
        if len(content) < end + 4 or zlib.crc32(content[at + 4 : end]) != int.from_bytes(
            content[end : end + 4]
        ):
            raise InputError(DAMAGED)
        chunks.append((name, content[at + 8 : end], content[at : end + 4]))
        at = end + 4
    if chunks[0][0] != b"IHDR" or len(chunks[0][1]) != 13 or not content.startswith(PNG):
        raise InputError(DAMAGED)
    return chunks


def _check_pixels(header: bytes, compressed: bytes) -> None:
    """Raise InputError where a PNG holds fewer pixels than its header declares: Pillow would make the rest black."""
    cols, rows, bits = (
        int.from_bytes(header[:4]),
        int.from_bytes(header[4:8]),
        header[8] * (1, 0, 3, 1)[header[9]],
    )
    passes = ADAM7 if header[12] else ((0, 0, 1, 1),)
    sizes = [
        (-(-(rows - top) // down), -(-(cols - left) // right))
        for top, left, down, right in passes
    ]
    needed = sum(
        high * (1 + -(-wide * bits // 8)) for high, wide in sizes if high > 0 and wide > 0
    )
    stream, there = zlib.decompressobj(), 0
    try:
        while there < needed and (part := stream.decompress(compressed, 1 << 20)):
            there, compressed = there + len(part), stream.unconsumed_tail
    except zlib.error as error:
        raise InputError(f"{DAMAGED} ({error})") from error
    if there < needed:
        raise InputError(f"is truncated: {there} of {needed} bytes are there")


def _read_pgm(content: bytes, most_pixels: int) -> Picture:
    header = PGM.match(content)
    if not header:
        raise InputError("is a damaged PGM: its header cannot be read")
    cols, rows, most = (int(number) for number in header.groups()[1:])
    _check_size((rows, cols), most_pixels)
    if not 1 <= most <= 65535:
        raise InputError(f"has a largest number of {most}: allowed is 1 to 65535")
    dtype = np.dtype(np.uint8 if most < 256 else np.uint16)
    if header[1] == b"5":
        there, needed = len(content) - header.end(), rows * cols * dtype.itemsize
        if there < needed:
            raise InputError(f"is truncated: {there} of {needed} bytes are there")
        numbers = np.frombuffer(content, dtype.newbyteorder(">"), rows * cols, header.end())
    else:
        numbers = _plain_numbers(content[header.end() :], rows * cols)
    if numbers.max() > most:
        raise InputError(
            f"{DAMAGED}: it holds {numbers.max():g}, its header states {most} at most"
        )
    return Picture(numbers.astype(dtype).reshape(rows, cols), 8 * dtype.itemsize, most)


def _plain_numbers(text: bytes, needed: int) -> NDArray[np.float64]:
    """Return the first numbers of a PGM written in digits."""
    if wrong := re.search(rb"[^\d\s]|\d{6}", text):
        raise InputError(f"{DAMAGED}: {shown(wrong[0])} stands among its numbers")
    numbers = np.fromstring(text, np.float64, sep=" ") if text.strip() else np.zeros(0)
    if numbers.size < needed:
        raise InputError(f"is truncated: {numbers.size} of {needed} numbers are there")
    return numbers[:needed]


def _read_tiff(file: BinaryIO, most_pixels: int, processed: bool) -> Picture:
    try:
        with tifffile.TiffFile(file) as tiff:
            page = tiff.pages.first
            _check_tiff(tiff, page, most_pixels, processed)
            bits = int(page.bitspersample)
            # OpenCV, which decodes 16 bit, takes planes apart for colours of one pixel
            apart = _interleaved(page) != page.shape and bits == 16
            if apart and page.compression not in (UNCOMPRESSED, *DEFLATED):
                raise InputError(
                    "holds compressed colours of 16 bit in planes apart: save it without compression"
                )
            if page.compression != UNCOMPRESSED and not apart:
                file.seek(0)
                numbers = _decoded("TIFF", file.read(), _interleaved(page), bits)
                return Picture(numbers, bits, 2**bits - 1)
            check_strips(tiff)
            if page.compression == UNCOMPRESSED and sum(page.databytecounts) < page.nbytes:
                raise InputError(
                    f"{DAMAGED}: {sum(page.databytecounts)} of {page.nbytes} bytes are there"
                )
            numbers = page.asarray()
            if _interleaved(page) != page.shape:
                numbers = np.moveaxis(numbers, 0, -1)
            return Picture(numbers, bits, 2**bits - 1)
    except (InputError, OSError):
        raise
    except (
        Exception
    ) as error:  # tifffile lets through whatever a damaged tag happens to break
        raise InputError(f"{DAMAGED} ({shown(str(error))})") from error


def _check_tiff(
    tiff: tifffile.TiffFile, page: tifffile.TiffPage, most_pixels: int, processed: bool
) -> None:
    """Raise InputError for a TIFF that declares unsupported properties."""
    if len(page.shape) < 2:
        raise InputError(DAMAGED)
    shape = _interleaved(page)
    _check_size(shape, most_pixels)
    if page.photometric in OTHER_COLOURS:
        raise InputError(
            f"holds colours as {OTHER_COLOURS[page.photometric]}: save it as grey or RGB"
        )
    if page.photometric == WHITE_IS_ZERO:
        raise InputError(
            "counts darkness (MinIsWhite): allowed are numbers that grow with light"
        )
    if len(tiff.pages) > 1:
        raise InputError(f"holds {len(tiff.pages)} pictures: allowed is one")
    if page.dtype not in (np.uint8, np.uint16) or page.bitspersample not in (8, 16):
        what = (
            f"{page.bitspersample} bit"
            if page.dtype in (np.bool_, np.uint8, np.uint16)
            else str(page.dtype)
        )
        raise InputError(
            f"holds {what} numbers: allowed are 8 and 16 bit integers without sign"
        )
    if {*page.extrasamples} & {BLENDED, UNBLENDED}:
        raise InputError(TRANSPARENT)
    if shape[2:] not in ((), (3,)):
        raise InputError(
            f"has {' × '.join(map(str, shape))} numbers: allowed are one a pixel (grey) and three (RGB)"
        )
    if len(shape) == 3 and page.bitspersample != 8 and not processed:
        raise InputError(f"has colours of {page.bitspersample} bit: allowed is grey")


def _interleaved(page: tifffile.TiffPage) -> tuple[int, ...]:
    """Return the shape of a page's numbers, colours last: (rows, columns) or (rows, columns, colours)."""
    if page.planarconfig == PLANES_APART and page.samplesperpixel > 1 and page.ndim == 3:
        return (*page.shape[1:], page.shape[0])
    return tuple(page.shape)


def _decoded(name: str, content: bytes, shape: tuple[int, ...], bits: int) -> Numbers:
    """Decompress a picture of a format by its name in Pillow. Raises InputError where its numbers are of another shape."""
    numbers: NDArray[np.generic] | None
    if len(shape) == 3 and bits == 16:  # Pillow cuts these to 8 bit
        import cv2

        numbers = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        numbers = None if numbers is None else numbers[..., ::-1]
    else:
        from PIL import Image

        Image.MAX_IMAGE_PIXELS = None  # the declared size has been checked
        try:
            with Image.open(BytesIO(content), formats=[name]) as picture:
                wider = {"1": "L", "P": "RGB"}.get(picture.mode, picture.mode)
                numbers = np.asarray(picture.convert(wider))
        except OSError as error:
            raise InputError(f"{DAMAGED} ({shown(str(error))})") from error
    if numbers is None or numbers.shape != shape or numbers.dtype.itemsize * 8 != bits:
        raise InputError(f"{DAMAGED}: its pixels are other than its header states")
    return numbers.astype(np.uint8 if bits == 8 else np.uint16)
