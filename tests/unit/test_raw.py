"""Photographs to mosaics: what the file states is what comes out, and what cannot be used is named in one line."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from labkit.errors import RawError
from labkit.photographs.decoding import read_photograph
from labkit.plan import Sensor

WriteDng = Callable[..., Path]

SHARED = Path(__file__).parents[3] / "shared"
SILENT = Sensor(pixel_pitch_um=5.0)
BAYER = Sensor(pixel_pitch_um=5.0, cfa_pattern="RGGB", black_level=0, white_level=65535)
BYTES = Sensor(pixel_pitch_um=5.0, cfa_pattern="mono", black_level=10, white_level=255)


@pytest.fixture
def counts() -> NDArray[np.uint16]:
    # LibRaw knows some cameras by their frame's size alone: 62 x 94 is none of them
    return np.random.default_rng(7).integers(500, 4000, (62, 94), dtype=np.uint16)


def refusal(path: Path, sensor: Sensor, capfd: pytest.CaptureFixture[str]) -> str:
    """The message for a file that cannot be used: one line that names it, and nothing else on the terminal."""
    with pytest.raises(RawError) as caught:
        read_photograph(path, sensor)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert capfd.readouterr() == ("", "")
    return message


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_the_filter_phase_is_the_files_and_the_picture_is_never_turned(
    tmp_path: Path,
    write_dng: WriteDng,
    counts: NDArray[np.uint16],
    cfa: str,
    orientation: int,
) -> None:
    mosaic = read_photograph(
        write_dng(tmp_path / "a.dng", counts, cfa=cfa, orientation=orientation), SILENT
    )
    assert mosaic.pattern == (cfa[:2], cfa[2:])
    np.testing.assert_array_equal(mosaic.counts, counts)
    for colour in "RGB":
        mask = mosaic.channel_mask(colour)
        cell = [[colour == cfa[0], colour == cfa[1]], [colour == cfa[2], colour == cfa[3]]]
        np.testing.assert_array_equal(mask, np.tile(cell, (31, 47)))


@pytest.mark.parametrize(
    ("black", "white"), [(0, 4095), (256, 4095), (600, 15520), (1024, 65535)]
)
def test_black_and_white_levels_are_the_files(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16], black: int, white: int
) -> None:
    mosaic = read_photograph(
        write_dng(tmp_path / "a.dng", counts, black=black, white=white), SILENT
    )
    assert mosaic.white == white
    np.testing.assert_array_equal(mosaic.black, np.full((2, 2), black))


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_each_place_of_the_cell_has_its_own_black_level(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16], cfa: str
) -> None:
    mosaic = read_photograph(
        write_dng(tmp_path / "a.dng", counts, cfa=cfa, black=(600, 601, 602, 603)), SILENT
    )
    np.testing.assert_array_equal(mosaic.black, [[600, 601], [602, 603]])
    np.testing.assert_array_equal(mosaic.black_map[60:, 92:], [[600, 601], [602, 603]])


def test_a_raw_without_filters_is_mono(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16]
) -> None:
    mosaic = read_photograph(write_dng(tmp_path / "a.dng", counts, cfa="mono"), SILENT)
    assert (mosaic.pattern, mosaic.cfa) == (("M",), "mono")
    assert mosaic.channel_mask("L").all()
    np.testing.assert_array_equal(mosaic.counts, counts)


def test_camera_and_exposure_come_from_the_tags(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16]
) -> None:
    mosaic = read_photograph(
        write_dng(tmp_path / "a.dng", counts, model="Acme D2", exposure=(1, 125)), SILENT
    )
    assert (mosaic.camera, mosaic.iso) == ("Acme D2", 200)
    assert mosaic.exposure_s == pytest.approx(0.008, rel=1e-6)


def test_the_type_is_recognised_by_the_content(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16]
) -> None:
    path = write_dng(tmp_path / "DSC_0001.JPG", counts)
    np.testing.assert_array_equal(read_photograph(path, SILENT).counts, counts)


@pytest.mark.parametrize("suffix", [".tif", ".png", ".pgm"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bare_numbers_come_as_they_are(
    tmp_path: Path,
    counts: NDArray[np.uint16],
    suffix: str,
    dtype: type[np.uint8] | type[np.uint16],
) -> None:
    path = tmp_path / f"a{suffix}"
    numbers = (counts % 256).astype(dtype) if dtype is np.uint8 else counts
    assert cv2.imwrite(str(path), numbers)
    sensor = BYTES if dtype is np.uint8 else BAYER
    mosaic = read_photograph(path, sensor)
    np.testing.assert_array_equal(mosaic.counts, numbers)
    assert (mosaic.black[0, 0], mosaic.white, mosaic.cfa) == (
        sensor.black_level,
        sensor.white_level,
        sensor.cfa_pattern,
    )


def test_a_pgm_of_14_bits_is_not_stretched(
    tmp_path: Path, counts: NDArray[np.uint16]
) -> None:
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5\n# a comment\n94 62\n16383\n" + counts.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_photograph(path, BAYER).counts, counts)


@pytest.mark.parametrize("compression", ["zlib", "lzw"])
def test_a_compressed_tiff_is_read(
    tmp_path: Path, counts: NDArray[np.uint16], compression: str
) -> None:
    path = tmp_path / "a.tif"
    tag = {
        "zlib": cv2.IMWRITE_TIFF_COMPRESSION_ADOBE_DEFLATE,
        "lzw": cv2.IMWRITE_TIFF_COMPRESSION_LZW,
    }[compression]
    assert cv2.imwrite(str(path), counts, [cv2.IMWRITE_TIFF_COMPRESSION, tag])
    np.testing.assert_array_equal(read_photograph(path, BAYER).counts, counts)


def test_bare_numbers_without_levels_in_the_plan_name_what_is_missing(
    tmp_path: Path, counts: NDArray[np.uint16], capfd: pytest.CaptureFixture[str]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", counts)
    message = refusal(
        tmp_path / "a.tif", Sensor(pixel_pitch_um=5.0, cfa_pattern="RGGB"), capfd
    )
    assert "black_level" in message
    assert "white_level" in message
    assert "cfa_pattern" not in message


@pytest.mark.parametrize("key", ["cfa_pattern", "black_level", "white_level"])
def test_a_plan_that_contradicts_the_file_is_refused(
    tmp_path: Path,
    write_dng: WriteDng,
    counts: NDArray[np.uint16],
    key: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = write_dng(tmp_path / "a.dng", counts)
    wrong = {"cfa_pattern": "BGGR", "black_level": 0.0, "white_level": 15520.0}
    right = {"cfa_pattern": "RGGB", "black_level": 600.0, "white_level": 16383.0}
    sensor = Sensor(pixel_pitch_um=5.0).model_validate(
        {"pixel_pitch_um": 5.0, **right, key: wrong[key]}
    )
    assert f"sensor.{key} = {wrong[key]} but the file has {right[key]}" in refusal(
        path, sensor, capfd
    )
    np.testing.assert_array_equal(
        read_photograph(
            path, Sensor.model_validate({"pixel_pitch_um": 5.0, **right})
        ).counts,
        counts,
    )


def test_a_colour_that_the_filter_lacks_is_refused(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16]
) -> None:
    with pytest.raises(RawError, match=r"no channel E .* RGGB"):
        read_photograph(write_dng(tmp_path / "a.dng", counts), SILENT).channel_mask("E")


@pytest.mark.parametrize("suffix", [".dng", ".tif", ".png", ".pgm"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(
    tmp_path: Path,
    write_dng: WriteDng,
    counts: NDArray[np.uint16],
    suffix: str,
    kept: float,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".dng":
        write_dng(path, counts)
    elif suffix == ".tif":
        tifffile.imwrite(path, counts)  # cv2 puts the tags last
    else:
        assert cv2.imwrite(str(path), counts)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept)])
    refusal(path, SILENT if suffix == ".dng" else BAYER, capfd)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a letter, not a photograph", "no photograph"),
        (b"\xff\xd8\xff\xe0 JFIF", "JPEG"),
        (bytes(786432), "no photograph"),
        (b"II*\0garbage", "damaged"),
        (b"P5 here", "header"),
    ],
)
def test_a_file_that_is_no_photograph_says_so(
    tmp_path: Path, content: bytes, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.dng").write_bytes(content)
    assert words in refusal(tmp_path / "a.dng", BAYER, capfd)


def test_a_missing_file_says_so(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "No such file" in refusal(tmp_path / "absent.dng", SILENT, capfd)


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_a_picture_in_colours_is_refused(
    tmp_path: Path,
    counts: NDArray[np.uint16],
    suffix: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / f"a{suffix}"
    assert cv2.imwrite(str(path), np.dstack([counts] * 3))
    assert "colours" in refusal(path, BAYER, capfd)


def test_a_white_level_beyond_the_file_is_refused(
    tmp_path: Path, counts: NDArray[np.uint16], capfd: pytest.CaptureFixture[str]
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", (counts % 256).astype(np.uint8))
    assert "up to 255" in refusal(tmp_path / "a.tif", BAYER, capfd)


@pytest.mark.skipif(
    not SHARED.is_dir(), reason="the reference sessions are not beside this checkout"
)
def test_an_independent_simulators_raw_is_read() -> None:
    mosaic = read_photograph(SHARED / "golden" / "bench-open" / "target_2000_0.dng", SILENT)
    assert (mosaic.counts.shape, mosaic.cfa, mosaic.white) == ((240, 240), "RGGB", 16383)
    np.testing.assert_array_equal(mosaic.black, np.full((2, 2), 600))


def test_a_headerless_file_is_read_as_the_plan_says_and_refused_where_it_cannot_be(
    tmp_path: Path,
) -> None:
    path = tmp_path / "numbers.raw"
    path.write_bytes(bytes([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]))
    keys: dict[str, object] = {
        "pixel_pitch_um": 5.0,
        "cfa_pattern": "mono",
        "black_level": 0,
        "white_level": 4095,
    }
    mosaic = read_photograph(path, Sensor.from_tables({**keys, "headerless_px": [2, 3]}))
    np.testing.assert_array_equal(
        mosaic.counts, [[0x0201, 0x0403, 0x0605], [0x0807, 0x0A09, 0x0C0B]]
    )
    with pytest.raises(
        RawError, match=r"3 × 3 numbers of 16 bit .* are 18 bytes: it has 12"
    ):
        read_photograph(path, Sensor.from_tables({**keys, "headerless_px": [3, 3]}))
    with pytest.raises(RawError, match="No such file"):
        read_photograph(
            tmp_path / "none.raw", Sensor.from_tables({**keys, "headerless_px": [2, 3]})
        )
    with pytest.raises(
        RawError, match=r"does not state these; add to \[sensor\]: black_level"
    ):
        read_photograph(
            path, Sensor.from_tables({**keys, "black_level": None, "headerless_px": [2, 3]})
        )


@pytest.mark.skipif(
    not SHARED.is_dir(), reason="the reference photographs are not beside this checkout"
)
def test_a_crop_of_a_real_nikon_frame_is_read(tmp_path: Path) -> None:
    path = SHARED / "real" / "DSC_1339_768x512_rggb.raw"
    crop = np.fromfile(path, dtype="<u2").reshape(512, 768)
    tifffile.imwrite(tmp_path / "crop.tif", crop)
    sensor = Sensor(
        pixel_pitch_um=4.9, cfa_pattern="RGGB", black_level=600, white_level=15520
    )
    mosaic = read_photograph(path, sensor.model_copy(update={"headerless_px": (512, 768)}))
    np.testing.assert_array_equal(mosaic.counts, crop)
    np.testing.assert_array_equal(
        read_photograph(tmp_path / "crop.tif", sensor).counts, crop
    )
    # two greens half a cell apart see nearly the same, and neither what red or blue see
    light = mosaic.light
    r, g1, g2, b = (light[row::2, col::2] for row in range(2) for col in range(2))
    assert mosaic.pixels("G").places == ((0, 1), (1, 0))
    assert np.abs(g1 - g2).mean() < 0.5 * min(np.abs(g1 - r).mean(), np.abs(g1 - b).mean())


@pytest.mark.skipif(
    "LABKIT_SONY_RAW" not in os.environ,
    reason="18 MB: `make sony-raw` fetches it and runs this test",
)
def test_a_whole_raw_of_a_mirrorless_camera_is_read() -> None:
    mosaic = read_photograph(Path(os.environ["LABKIT_SONY_RAW"]), SILENT)
    assert mosaic.camera == "SONY ILCE-7RM3"
    assert mosaic.cfa == "RGGB"
    assert mosaic.counts.shape == (3464, 5184)
    assert mosaic.black.min() == mosaic.black.max() == 512
    assert 16000 < mosaic.white < 16384
    assert mosaic.exposure_s == pytest.approx(1 / 640, rel=1e-6)
    assert mosaic.iso == 3200


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        (
            [
                (33421, "H", 2, (4, 4), True),
                (33422, "B", 16, bytes([0, 0, 1, 1] * 4), True),
            ],
            "repeats every 4x4 pixels",
        ),
        ([(50711, "H", 1, 2, True)], "staggered"),
    ],
)
def test_a_filter_array_that_is_not_two_by_two_is_refused(
    tmp_path: Path,
    write_dng: WriteDng,
    counts: NDArray[np.uint16],
    tags: list[tuple[Any, ...]],
    words: str,
) -> None:
    path = write_dng(tmp_path / "a.dng", counts, more=tags)
    with pytest.raises(RawError, match=words):
        read_photograph(path, SILENT)


def test_a_camera_without_its_filters_is_mono_if_the_plan_says_so(
    tmp_path: Path, write_dng: WriteDng, counts: NDArray[np.uint16]
) -> None:
    path = write_dng(tmp_path / "a.dng", counts, black=(1, 2, 3, 4))
    mono = Sensor(pixel_pitch_um=5.0, cfa_pattern="mono")
    with pytest.raises(RawError, match="or add filters_removed = true if the filters were"):
        read_photograph(path, mono)
    bare = Sensor(pixel_pitch_um=5.0, cfa_pattern="mono", filters_removed=True)
    photograph = read_photograph(path, bare)
    assert photograph.cfa == "mono"
    np.testing.assert_array_equal(photograph.counts, counts)
    np.testing.assert_array_equal(photograph.black, [[1, 2], [3, 4]])
