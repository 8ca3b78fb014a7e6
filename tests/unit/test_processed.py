"""JPEG and other pictures in colours: what Pillow, OpenCV and littleCMS make of them is what comes out."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageCms

from labkit.calibration.calibrate import Calibration, channel_data
from labkit.errors import DataError, InputError, RawError
from labkit.estimation.likelihood import Detector, FrameData, predict
from labkit.photographs.decoding import read_photograph
from labkit.photographs.encoding import Encoding, profile_curves, srgb
from labkit.photographs.exposure import exposure_problem
from labkit.photographs.photograph import Photograph
from labkit.photographs.picture_file import read_header
from labkit.photographs.tone_curve import stated_curve
from labkit.plan import Sensor
from labkit.session.frame import Frame
from labkit.session.import_frames import import_frames
from tests.plans import PORTRAIT, plan_text

SILENT = Sensor(pixel_pitch_um=5.0)
RAMP = np.arange(256, dtype=np.uint8)
EXIF = b"Exif\0\0II*\0\x08\0\0\0\1\0\x0f\1\2\0\4\0\0\0Abc\0\0\0\0\0"
NOTHING = Calibration(None, {}, None, None, None, {}, ())


@pytest.fixture
def colours() -> NDArray[np.uint8]:
    """(48, 64, 3), smooth, another gradient in each colour."""
    y, x = np.mgrid[:48, :64]
    return np.dstack([4 * x, 5 * y, 255 - 2 * x - 2 * y]).clip(0, 255).astype(np.uint8)


def saved(path: Path, picture: NDArray[np.uint8], **how: Any) -> Path:
    Image.fromarray(picture).save(path, **how)
    return path


def frame(path: Path) -> Frame:
    return Frame(path.name, "target", None, "", None, "", path)


def in_colours(mosaic: Photograph) -> NDArray[np.uint16]:
    """(rows, cols, 3)"""
    return np.dstack(
        [mosaic.part(name, (slice(0, None), slice(0, None))).counts for name in "RGB"]
    )


def profile_of(power: float | None) -> bytes:
    """littleCMS's own sRGB, or one of its with another power, made by changing the curve that it wrote."""
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    if power is None:
        return icc
    at = icc.index(b"para\0\0\0\0")
    curve = b"curv\0\0\0\0\0\0\0\1" + round(256 * power).to_bytes(2)
    return icc[:at] + curve + icc[at + len(curve) :]


def by_little_cms(icc: bytes) -> NDArray[np.float64]:
    """(256,) light of each number of grey, as littleCMS has it: linear in the XYZ that a profile leads to."""
    linear = BytesIO(profile_of(1.0))
    steps = Image.fromarray(np.dstack([RAMP] * 3)[None][0].reshape(1, 256, 3))
    transform = ImageCms.buildTransform(
        BytesIO(icc), linear, "RGB", "RGB", flags=ImageCms.Flags.NOOPTIMIZE
    )
    done = ImageCms.applyTransform(steps, transform)
    assert done is not None
    return np.asarray(done)[0, :, 1] / 255.0


@pytest.mark.parametrize("power", [None, 1.8, 2.2])
def test_a_profiles_tone_curve_is_littlecms_own(power: float | None) -> None:
    curves = profile_curves(profile_of(power))
    for curve in curves:
        # littleCMS rounds to 8 bit at the end
        np.testing.assert_allclose(
            curve(RAMP / 255), by_little_cms(profile_of(power)), atol=0.5 / 255 + 1e-3
        )


def test_a_table_in_a_profile_is_gone_through_linearly() -> None:
    icc = profile_of(None)
    at = icc.index(b"para\0\0\0\0")
    table = b"curv\0\0\0\0\0\0\0\3" + b"".join(
        value.to_bytes(2) for value in (0, 13107, 65535)
    )
    (curve, *_) = profile_curves(icc[:at] + table + icc[at + len(table) :])
    np.testing.assert_allclose(
        curve(np.array([0, 0.25, 0.5, 0.75, 1])), [0, 0.1, 0.2, 0.6, 1], atol=1e-5
    )


def test_damaged_profiles_give_a_rising_curve_or_are_refused() -> None:
    rng, icc = np.random.default_rng(3), profile_of(None)
    refused = 0
    for _ in range(500):
        damaged = np.frombuffer(icc, np.uint8).copy()
        damaged[rng.integers(120, len(icc), 5)] = rng.integers(0, 256, 5)
        try:
            levels = stated_curve(Encoding(icc=damaged.tobytes()), 255).levels
        except InputError:
            refused += 1
        else:
            assert np.all(np.diff(levels) >= 0)
            assert levels.max() <= 65535
    assert 0 < refused < 500


def test_srgbs_curve_is_the_one_of_the_standards_examples() -> None:
    # IEC 61966-2-1: the linear part's slope is 1/12.92; half of full light is stored as 187.5 of 255
    np.testing.assert_allclose(
        srgb(np.array([0, 0.04, 187.516 / 255, 1.0])), [0, 0.04 / 12.92, 0.5, 1], atol=1e-5
    )


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_a_picture_in_colours_is_three_whole_planes_of_light(
    tmp_path: Path, colours: NDArray[np.uint8], suffix: str
) -> None:
    path = saved(
        tmp_path / f"a{suffix}",
        colours,
        **({"quality": 100, "subsampling": 0} if suffix == ".jpg" else {}),
    )
    mosaic = read_photograph(path, SILENT)
    assert (mosaic.shape, mosaic.cfa, mosaic.white) == ((48, 64), "RGB", 65535)
    stored = np.asarray(Image.open(path), dtype=np.float64) / 255
    light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(in_colours(mosaic), 65535 * light, atol=0.51)
    assert "PSF" in mosaic.notes[0].text
    assert "sRGB" in mosaic.notes[0].text


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_an_embedded_profile_is_taken(
    tmp_path: Path, colours: NDArray[np.uint8], suffix: str
) -> None:
    path = saved(tmp_path / f"a{suffix}", colours, icc_profile=profile_of(2.0))
    stored = np.asarray(Image.open(path), dtype=np.float64) / 255
    mosaic = read_photograph(path, SILENT)
    np.testing.assert_allclose(
        in_colours(mosaic)[..., 1:], 65535 * stored[..., 1:] ** 2, atol=0.51
    )
    assert "ICC profile" in mosaic.notes[0].text


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_colours_of_16_bit_are_linear_or_not_as_the_plan_says(
    tmp_path: Path, suffix: str
) -> None:
    deep = np.random.default_rng(1).integers(0, 65536, (20, 30, 3)).astype(np.uint16)
    path = tmp_path / f"a{suffix}"
    assert cv2.imwrite(str(path), deep[..., ::-1])
    with pytest.raises(
        RawError,
        match=r'does not say how its numbers stand to light: .* tone_curve = "linear" or "sRGB"',
    ):
        read_photograph(path, SILENT)
    mosaic = read_photograph(path, Sensor(pixel_pitch_um=5.0, tone_curve="linear"))
    np.testing.assert_array_equal(in_colours(mosaic), deep)
    assert mosaic.tone is None
    bent = read_photograph(path, Sensor(pixel_pitch_um=5.0, tone_curve="sRGB"))
    np.testing.assert_allclose(in_colours(bent), 65535 * srgb(deep / 65535), atol=0.51)


def test_a_grey_jpeg_is_mono_and_a_grey_png_stays_linear_unless_the_plan_says_so(
    tmp_path: Path,
) -> None:
    grey = np.tile(RAMP, (20, 1))
    jpeg = read_photograph(saved(tmp_path / "a.jpg", grey, quality=100), SILENT)
    assert jpeg.cfa == "mono"
    stored = np.asarray(Image.open(tmp_path / "a.jpg")) / 255.0
    np.testing.assert_allclose(jpeg.counts, 65535 * srgb(stored), atol=0.51)
    path = saved(tmp_path / "a.png", grey)
    as_before = read_photograph(
        path, Sensor(pixel_pitch_um=5.0, cfa_pattern="mono", black_level=0, white_level=255)
    )
    np.testing.assert_array_equal(as_before.counts, grey)
    assert as_before.notes == ()
    undone = read_photograph(path, Sensor(pixel_pitch_um=5.0, tone_curve="sRGB"))
    np.testing.assert_allclose(undone.counts, 65535 * srgb(grey / 255), atol=0.51)


def test_full_scale_is_the_files_own(tmp_path: Path) -> None:
    numbers = np.array([[0, 1000, 4095]], dtype=">u2")
    (tmp_path / "a.pgm").write_bytes(b"P5 3 1 4095\n" + numbers.tobytes())
    Image.fromarray(np.array([[0, 1], [1, 0]], dtype=bool)).save(
        tmp_path / "b.png"
    )  # of one bit
    undone = Sensor(pixel_pitch_um=5.0, tone_curve="sRGB")
    np.testing.assert_allclose(
        read_photograph(tmp_path / "a.pgm", undone).counts,
        65535 * srgb(numbers / 4095),
        atol=0.51,
    )
    np.testing.assert_array_equal(
        read_photograph(tmp_path / "b.png", undone).counts, [[0, 65535], [65535, 0]]
    )


def test_the_rounding_of_8_bit_is_in_the_noise_through_the_curves_slope(
    tmp_path: Path,
) -> None:
    # light that is even within each step of 8 bit: what rounding loses is known by simulation, without any formula
    rng, stored = (
        np.random.default_rng(5),
        np.repeat([[30, 100, 200]], 40, axis=0).astype(np.uint8),
    )
    path = saved(tmp_path / "a.png", np.dstack([np.repeat(stored, 20, axis=1)] * 3))
    data = channel_data(NOTHING, frame(path), read_photograph(path, SILENT), "G")
    for column, code in ((5, 30), (25, 100), (45, 200)):
        light = 65535 * srgb((code + rng.uniform(-0.5, 0.5, 200_000)) / 255)
        # a variance of 200,000 uniform numbers is known to 0.2 %; the curve bends by more within a step
        assert data.rounding[0, column] == pytest.approx(np.var(light), rel=0.01)
    one = np.ones(data.counts.shape)
    detector = Detector(scale=1.0, ambient=0.0, gain=0.5, read_variance=4.0)
    used = FrameData(data.counts, one > 0, one, 0 * one, rounding=data.rounding)
    _, variance = predict(np.full(one.size, 100.0), used, detector)
    np.testing.assert_allclose(variance, 54.0 + data.rounding.ravel())


def test_colours_of_a_jpeg_that_are_coarser_are_told(
    tmp_path: Path, colours: NDArray[np.uint8]
) -> None:
    halved, whole = (
        saved(tmp_path / f"{s}.jpg", colours, quality=95, subsampling=s) for s in (2, 0)
    )
    assert "half resolution" in " ".join(map(str, read_photograph(halved, SILENT).notes))
    assert "half resolution" not in " ".join(map(str, read_photograph(whole, SILENT).notes))


@pytest.mark.parametrize(
    "how", [{}, {"progressive": True}, {"optimize": True}, {"exif": EXIF}]
)
def test_a_jpegs_header_is_read_as_pillow_reads_it(
    tmp_path: Path, colours: NDArray[np.uint8], how: dict[str, Any]
) -> None:
    icc = profile_of(None) + bytes(150_000)  # more than one segment holds
    path = saved(tmp_path / "a.jpg", colours, icc_profile=icc, **how)
    header = read_header(path.read_bytes())
    with Image.open(path) as pillow:
        assert header.shape == (*pillow.size[::-1], 3)
        assert header.icc == pillow.info["icc_profile"]
        assert header.exif == pillow.info.get("exif", b"")[6:]


def cut_short(content: bytes) -> bytes:
    return content[: len(content) // 2]


def without_header(content: bytes) -> bytes:
    return content[:30]


@pytest.mark.parametrize("spoil", [cut_short, without_header])
def test_a_damaged_jpeg_is_refused_in_one_line(
    tmp_path: Path, colours: NDArray[np.uint8], spoil: Callable[[bytes], bytes]
) -> None:
    path = saved(tmp_path / "a.jpg", colours, quality=95)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(RawError, match=r"^\S+a\.jpg: is truncated or damaged[^\n]*$"):
        read_photograph(path, SILENT)


def test_a_jpeg_declared_raw_says_what_to_do(
    tmp_path: Path, colours: NDArray[np.uint8]
) -> None:
    with pytest.raises(
        RawError,
        match=r"is a JPEG, though its name ends in \.NEF: give the camera's raw file",
    ):
        read_photograph(saved(tmp_path / "DSC_1.NEF", colours, format="JPEG"), SILENT)
    bayer = Sensor(pixel_pitch_um=5.0, cfa_pattern="RGGB", black_level=0, white_level=255)
    with pytest.raises(
        RawError,
        match=r'is a JPEG, but the plan\'s sensor.cfa_pattern = "RGGB" declares raw numbers',
    ):
        read_photograph(saved(tmp_path / "a.jpg", colours), bayer)


def test_what_is_wrong_with_many_files_alike_is_said_once(
    tmp_path: Path, colours: NDArray[np.uint8]
) -> None:
    names = [
        saved(tmp_path / f"DSC_{k}.NEF", colours, format="JPEG").name for k in range(9)
    ]
    (tmp_path / "frames.csv").write_text(
        "\n".join(["file,kind,range_mm", *(f"{name},target," for name in names)])
    )
    (tmp_path / "plan.toml").write_text(plan_text(PORTRAIT))
    with pytest.raises(
        DataError, match=r"DSC_0\.NEF: is a JPEG, [^\n;]*\(and 8 more files like it\)$"
    ):
        import_frames(tmp_path / "frames.csv", tmp_path / "plan.toml", tmp_path / "session")


def test_overexposed_colours_are_named(tmp_path: Path, colours: NDArray[np.uint8]) -> None:
    assert (
        exposure_problem(
            read_photograph(saved(tmp_path / "a.png", colours), SILENT), "target", "RGB"
        )
        is None
    )
    colours[10:40, 10:40, 2] = 255
    mosaic = read_photograph(saved(tmp_path / "b.png", colours), SILENT)
    problem = exposure_problem(mosaic, "target", "RGB")
    assert problem is not None
    assert "overexposed" in problem
    assert problem.endswith("channel B")
