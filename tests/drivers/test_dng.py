"""Raw files as rawpy and tifffile read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile

from labkit.drivers.simulated import lossless_jpeg
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.drivers.simulated.lossless_jpeg import code_lengths, compress_counts
from labkit.types import Counts


def some_counts(
    full_scale: int = 16383,
) -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    return np.random.default_rng(5).integers(0, full_scale + 1, (50, 70)).astype(np.uint16)


@pytest.mark.parametrize("pattern", ["RGGB", "GRBG", "GBRG", "BGGR"])
@pytest.mark.parametrize("white", [4095, 16383, 65535])
def test_rawpy_reads_back_the_samples_and_the_phase_of_the_mosaic(
    tmp_path: Path, pattern: str, white: int
) -> None:
    counts = some_counts(white)
    write_raw(
        tmp_path / "a.dng", counts, RawTags(pattern, black_level=60, white_level=white)
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, counts)
        assert raw.raw_pattern is not None
        seen = "".join(chr(raw.color_desc[i]) for i in raw.raw_pattern.ravel())
        assert (seen, raw.white_level, raw.black_level_per_channel) == (
            pattern,
            white,
            [60] * 4,
        )


def test_each_place_of_the_cell_may_have_its_own_black_level(tmp_path: Path) -> None:
    write_raw(
        tmp_path / "a.dng",
        some_counts(),
        RawTags("GBRG", black_level=(10, 20, 30, 40), white_level=16383),
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        assert raw.raw_pattern is not None
        place = dict(zip(raw.raw_pattern.ravel().tolist(), (10, 20, 30, 40), strict=True))
        assert raw.black_level_per_channel == [place[i] for i in range(4)]


def test_an_orientation_flag_leaves_the_samples_alone(tmp_path: Path) -> None:
    write_raw(tmp_path / "a.dng", some_counts(), RawTags(white_level=16383, orientation=6))
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, some_counts())
        assert raw.sizes.flip == 6


def test_shutter_time_and_iso_are_told(tmp_path: Path) -> None:
    write_raw(
        tmp_path / "a.dng",
        some_counts(),
        RawTags(white_level=16383, exposure_s=0.02, iso=400),
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        assert raw.other.shutter_speed == pytest.approx(0.02)
        assert raw.other.iso_speed == 400


def test_a_sensor_without_colours_gets_a_plain_tiff(tmp_path: Path) -> None:
    write_raw(
        tmp_path / "a.tif",
        some_counts(),
        RawTags("mono", white_level=16383, exposure_s=0.5),
    )
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), some_counts())


@pytest.mark.parametrize(
    "tags", [{"pattern": "RGB"}, {"pattern": "CYGM"}, {"orientation": 9}]
)
def test_tags_that_no_raw_has_are_refused(tags: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"(pattern|orientation) is"):
        RawTags(**tags)  # type: ignore[arg-type]


def drawn(kind: str, shape: tuple[int, int], full_scale: int) -> Counts:
    """Counts that a predictor finds hard or easy."""
    rng = np.random.default_rng(3)
    places = np.add.outer(7 * np.arange(shape[0]), np.arange(shape[1]))
    pictures = {
        "noise": rng.integers(0, full_scale + 1, shape),
        "few": rng.poisson(3, shape),
        "even": np.full(shape, full_scale // 3),
        "ramp": places % (full_scale + 1),
        "extremes": full_scale * (places // 2 % 2),
        # steps of half of 2^16 and next to it, up and down
        "half": np.array([0, 32768, 0, 32767, 65535])[places % 5] % (full_scale + 1),
    }
    return np.asarray(pictures[kind], dtype=np.uint16)


@pytest.mark.parametrize("shape", [(48, 64), (31, 40), (30, 41), (1, 2), (2, 1), (1, 1)])
@pytest.mark.parametrize("kind", ["noise", "few", "even", "ramp", "extremes", "half"])
@pytest.mark.parametrize("bits", [12, 14, 16])
def test_libraw_decompresses_the_identical_counts(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    shape: tuple[int, int],
    kind: str,
    bits: int,
) -> None:
    # several strips, whose codes are joined within bytes
    monkeypatch.setattr(lossless_jpeg, "COUNTS_AT_ONCE", 500)
    # LibRaw takes a raw of fewer than 22 pixels a side for a thumbnail
    counts = np.tile(drawn(kind, shape, (1 << bits) - 1), (1 + 24 // shape[0], 1))
    counts = np.tile(counts, (1, 1 + 24 // shape[1]))
    write_raw(tmp_path / "a.dng", counts, RawTags(white_level=(1 << bits) - 1))
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        assert tiff.pages.first.compression == 7
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, counts)


def test_even_counts_take_little_room_and_noise_as_much_as_its_bits() -> None:
    even = compress_counts(np.full((400, 400), 900, np.uint16), 14)
    # a bit for each count, and the tables
    assert len(even) < 400 * 400 / 8 + 100
    rng = np.random.default_rng(1)
    noisy = (4000 + 40 * rng.standard_normal((400, 400))).astype(np.uint16)
    # differences of a Gaussian of sigma 40 have an entropy of log2(40 sqrt(4 pi e)) = 7.87 bits
    assert 7.87 < 8 * len(compress_counts(noisy, 14)) / noisy.size < 1.03 * 7.87


@pytest.mark.parametrize("growth", [1, 2, 1.62, 10])
def test_codes_have_sixteen_bits_at_most_and_leave_one_code_over(growth: float) -> None:
    """Kraft's inequality; weights that grow like Fibonacci's have the longest codes."""
    occurrences = np.array([growth**n for n in range(17)]).astype(np.int64)
    lengths = code_lengths(occurrences)
    assert 1 <= lengths.min() <= lengths.max() <= 16
    assert np.sum(0.5**lengths) < 1
    assert np.all(np.diff(lengths) <= 0) or growth == 1


def test_counts_beyond_the_stated_bits_are_refused() -> None:
    with pytest.raises(ValueError, match="counts up to 16384 in 14 bits"):
        compress_counts(np.full((4, 4), 16384, np.uint16), 14)
    with pytest.raises(ValueError, match="4 × 5 counts with 2 colours in a row"):
        compress_counts(np.zeros((4, 5), np.uint16), 14, 2)
