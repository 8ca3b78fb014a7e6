"""PNG, PGM and TIFF files, whole and damaged, against numbers that other libraries wrote."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from labkit.errors import InputError
from labkit.photographs.picture_file import PNG, read_picture

DATA = np.random.default_rng(3).integers(0, 65536, (13, 21)).astype(np.uint16)

GREY = (DATA // 256).astype(np.uint8)


def chunk(name: bytes, data: bytes) -> bytes:
    return (
        struct.pack(">I", len(data))
        + name
        + data
        + struct.pack(">I", zlib.crc32(name + data))
    )


def png(
    rows: int, cols: int, pixels: bytes, *more: bytes, bits: int = 8, colours: int = 0
) -> bytes:
    """A PNG by its specification, with whatever it declares and holds; more: chunks before its pixels."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, bits, colours, 0, 0, 0))
    return (
        PNG
        + header
        + b"".join(more)
        + chunk(b"IDAT", zlib.compress(pixels))
        + chunk(b"IEND", b"")
    )


def tiff(numbers: NDArray[Any], **tags: Any) -> bytes:
    content = BytesIO()
    tifffile.imwrite(content, numbers, **tags)
    return content.getvalue()


def tiff_of_size(rows: int, cols: int) -> bytes:
    """A TIFF of 13 × 21 numbers that declares another size."""
    content = bytearray(tiff(DATA))
    for tag, value in ((256, cols), (257, rows)):
        at = content.index(struct.pack("<HHI", tag, 4, 1))
        content[at + 8 : at + 12] = struct.pack("<I", value)
    return bytes(content)


def refusal(folder: Path, content: bytes) -> str:
    (folder / "picture").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_picture(folder / "picture")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 200
    return str(caught.value)


@pytest.mark.parametrize(
    "compression", [None, "tiff_lzw", "tiff_adobe_deflate", "packbits"]
)
def test_a_tiff_comes_out_as_another_library_put_it_in(
    tmp_path: Path, compression: str | None
) -> None:
    Image.fromarray(DATA).save(tmp_path / "a.tif", compression=compression)
    picture = read_picture(tmp_path / "a.tif")
    np.testing.assert_array_equal(picture.numbers, DATA)
    assert (picture.bits, picture.white) == (16, 65535)
    assert picture.numbers.dtype == np.uint16


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_either_order_of_bytes_is_read(
    tmp_path: Path, byteorder: str, compression: str | None
) -> None:
    (tmp_path / "a.tif").write_bytes(
        tiff(DATA, byteorder=byteorder, compression=compression)
    )
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").numbers, DATA)


@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("depth", [8, 16])
def test_colours_in_planes_apart_are_read(
    tmp_path: Path, compression: str | None, depth: int
) -> None:
    colours = np.dstack([DATA, DATA[::-1], DATA[:, ::-1]])
    if depth == 8:
        colours = (colours // 256).astype(np.uint8)
    apart = np.moveaxis(colours, -1, 0)
    tags = {"photometric": "rgb", "planarconfig": "separate", "compression": compression}
    (tmp_path / "a.tif").write_bytes(tiff(apart, **tags))
    picture = read_picture(tmp_path / "a.tif", processed=True)
    np.testing.assert_array_equal(picture.numbers, colours)


def test_a_png_of_one_bit_is_black_and_white(tmp_path: Path) -> None:
    Image.fromarray(DATA % 2 == 1).save(tmp_path / "a.png")
    picture = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(picture.numbers, 255 * (DATA % 2))
    assert (picture.bits, picture.white) == (1, 255)


def test_a_pgm_in_digits_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(
        b"P2\n#by hand\n3 2 #size\n1000\n0 500 1000\n7\n 8 9\n"
    )
    picture = read_picture(tmp_path / "a.pgm")
    np.testing.assert_array_equal(picture.numbers, [[0, 500, 1000], [7, 8, 9]])
    assert picture.white == 1000


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            png(2**31 - 1, 2**31 - 1, b""),
            "declares 2147483647 × 2147483647 pixels: allowed are 1 to 65536 a side",
        ),
        (
            png(30_000, 30_000, b""),
            "declares 30000 × 30000 pixels: allowed are 268 million in all",
        ),
        (png(0, 9, b""), "declares 0 × 9 pixels"),
        (b"P5 99999 99999 255\n", "declares 99999 × 99999 pixels"),
        (b"P2 60000 60000 255\n1 2 3", "declares 60000 × 60000 pixels"),
        (tiff_of_size(2**31, 2**31), "declares 2147483648 × 2147483648 pixels"),
        (tiff_of_size(50_000, 50_000), "declares 50000 × 50000 pixels"),
        (
            tiff_of_size(16_000, 16_000),
            "is truncated or damaged: 546 of 512000000 bytes are there",
        ),
        (b"P5 9 9 255\n" + bytes(80), "is truncated: 80 of 81 bytes are there"),
        (b"P2 2 2 255\n1 2 3", "is truncated: 3 of 4 numbers are there"),
        (b"P2 2 2 255\n1 2 3 x", "b'x' stands among its numbers"),
        (b"P2 2 2 255\n1 2 3 256", "it holds 256, its header states 255 at most"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_a_declared_size_is_looked_at_first(
    tmp_path: Path, content: bytes, words: str
) -> None:
    assert words in refusal(tmp_path, content)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (png(9, 9, bytes(80)), "is truncated: 80 of 90 bytes are there"),
        (png(2, 2, bytes(16), bits=8, colours=4), "has transparency"),
        (png(2, 2, bytes(30), bits=16, colours=2), "has colours of 16 bit"),
        (png(2, 2, bytes(6), chunk(b"tRNS", b"\0\0")), "has transparency"),
        (png(9, 9, bytes(90))[:-1], "is truncated or damaged"),
        (tiff(DATA, photometric="miniswhite"), "counts darkness"),
        (tiff(DATA.astype(np.float32)), "holds float32 numbers"),
        (tiff(np.dstack([DATA] * 3)), "has colours of 16 bit"),
        (tiff(np.dstack([DATA] * 4), extrasamples=["unassalpha"]), "has transparency"),
        (tiff(np.dstack([DATA] * 4), extrasamples=["assocalpha"]), "has transparency"),
        (tiff(np.dstack([DATA] * 4), extrasamples=[0]), "has 13 × 21 × 4 numbers"),
        (tiff(np.dstack([GREY] * 4), photometric="separated"), "as the inks of CMYK"),
        (tiff(np.dstack([GREY] * 3), photometric="cielab"), "as CIE L*a*b*"),
        (
            tiff(GREY, photometric="palette", colormap=np.zeros((3, 256), np.uint16)),
            "as a palette",
        ),
        (tiff(DATA.astype(np.int16)), "holds int16 numbers"),
        (tiff(DATA > 9, photometric="minisblack"), "holds 1 bit numbers"),
        (tiff(np.stack([DATA] * 4), photometric="minisblack"), "holds 4 pictures"),
        (tiff(DATA, compression="zlib")[:-20], "is truncated or damaged"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_what_is_no_whole_grey_picture_is_refused(
    tmp_path: Path, content: bytes, words: str
) -> None:
    assert words in refusal(tmp_path, content)


@pytest.mark.parametrize("name", ["JPEG", "BMP", "GIF", "PPM", "WEBP"])
def test_no_other_format_is_guessed(tmp_path: Path, name: str) -> None:
    content = BytesIO()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(content, format=name)
    assert refusal(tmp_path, content.getvalue()) == "is no PNG, PGM or TIFF"


def test_texts_that_swell_never_reach_the_decoder(tmp_path: Path) -> None:
    bomb = PngImagePlugin.PngInfo()
    bomb.add_text("comment", "a" * 20_000_000, zip=True)
    Image.fromarray(np.full((4, 4), 7, np.uint8)).save(tmp_path / "a.png", pnginfo=bomb)
    assert np.all(read_picture(tmp_path / "a.png").numbers == 7)


def test_an_interlaced_png_is_read(tmp_path: Path) -> None:
    # one row, two columns: passes 1 and 6 of Adam7, one pixel each
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 1, 8, 0, 0, 0, 1))
    pixels = chunk(b"IDAT", zlib.compress(b"\0\x11\0\x22"))
    (tmp_path / "a.png").write_bytes(PNG + header + pixels + chunk(b"IEND", b""))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").numbers, [[0x11, 0x22]])


def test_a_bomb_that_declares_little_takes_little_memory(tmp_path: Path) -> None:
    # 2 GB of zeros in a PNG that declares 9 × 9 pixels: pixels are counted before they are decoded
    rows = zlib.compressobj()
    packed = b"".join(rows.compress(bytes(2**24)) for _ in range(128)) + rows.flush()
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 9, 9, 8, 0, 0, 0, 0))
    (tmp_path / "a.png").write_bytes(
        PNG + header + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )
    assert np.all(read_picture(tmp_path / "a.png").numbers == 0)
