"""Raw files as rawpy and tifffile read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile

from labkit.drivers.simulated.dng import RawTags, write_raw


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
