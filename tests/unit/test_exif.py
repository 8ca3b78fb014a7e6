"""What files say of lens and exposure, as Pillow and tifffile wrote it, and where it contradicts the plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import IFD, Base

from labkit.cli import run
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.photographs.exif import Exif, read_exif
from labkit.plan import Plan
from labkit.session.stated import contradictions, stops_between
from tests.dng import write_dng
from tests.plans import PORTRAIT, plan_text

PLAN = Plan.parse(plan_text(PORTRAIT))  # 70 mm, f/2.8


def photograph(path: Path, camera: str = "D7000", **stated: Any) -> Path:
    """A small grey picture with EXIF by Pillow; stated: names of tags and their values."""
    exif = Image.Exif()
    exif[Base.Make], exif[Base.Model] = "NIKON CORPORATION", f"NIKON {camera}"
    exif.get_ifd(IFD.Exif).update({Base[name]: value for name, value in stated.items()})
    Image.fromarray(np.full((32, 48), 128, np.uint8)).save(path, exif=exif)
    return path


def told(*paths: Path, kind: Any = "target") -> list[str]:
    return [
        finding.text
        for finding in contradictions([(path.name, kind, path) for path in paths], PLAN)
    ]


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_what_pillow_wrote_is_read(tmp_path: Path, suffix: str) -> None:
    path = photograph(
        tmp_path / f"a{suffix}",
        FocalLength=70.0,
        FNumber=2.8,
        ExposureTime=0.02,
        ISOSpeedRatings=200,
        FocalLengthIn35mmFilm=105,
        LensModel="AF-S 18-105mm",
        LensSerialNumber="L7",
        BodySerialNumber="B8",
        DateTimeOriginal="2026:11:22 09:08:07",
        FocalPlaneXResolution=5000.0,
        FocalPlaneResolutionUnit=2,
        ExifImageWidth=48,
        ExifImageHeight=32,
    )
    found = read_exif(path)
    numbers = (
        found.focal_length_mm,
        found.focal_length_35mm,
        found.f_number,
        found.exposure_s,
        found.pixel_pitch_um,
    )
    assert numbers == pytest.approx(
        (70, 105, 2.8, 0.02, 5.08)
    )  # 5.08 um: an inch over 5000
    assert (found.iso, found.size_px, found.taken) == (200, (32, 48), "2026:11:22 09:08:07")
    words = (found.camera, found.camera_serial, found.lens, found.lens_serial)
    assert words == ("NIKON D7000", "B8", "AF-S 18-105mm", "L7")


def test_a_raw_files_tags_are_read(tmp_path: Path) -> None:
    more = [(37386, "2I", 1, (70, 1), True), (33437, "2I", 1, (28, 10), True)]
    found = read_exif(
        write_dng(tmp_path / "a.dng", np.full((60, 90), 900, np.uint16), more=more)
    )
    assert (
        found.camera,
        found.focal_length_mm,
        found.f_number,
        found.exposure_s,
        found.iso,
    ) == (
        "Acme D1",
        70.0,
        2.8,
        0.02,
        200,
    )


@pytest.mark.parametrize(("suffix", "pattern"), [(".dng", "RGGB"), (".tif", "mono")])
def test_an_exif_directory_in_a_tiff_is_read(
    tmp_path: Path, suffix: str, pattern: str
) -> None:
    tags = RawTags(pattern=pattern, exposure_s=0.25, iso=800, make="Acme", model="Acme D1")
    write_raw(tmp_path / f"a{suffix}", np.full((60, 90), 900, np.uint16), tags)
    found = read_exif(tmp_path / f"a{suffix}")
    assert (found.camera, found.exposure_s, found.iso) == ("Acme D1", 0.25, 800)


@pytest.mark.parametrize("kept", [20, 60, 150])
def test_damaged_or_absent_exif_states_nothing(tmp_path: Path, kept: int) -> None:
    path = photograph(tmp_path / "a.jpg", FocalLength=70.0)
    path.write_bytes(path.read_bytes()[:kept])
    assert read_exif(path) == Exif()
    (tmp_path / "b.pgm").write_bytes(b"P5 1 1 255 a")
    assert read_exif(tmp_path / "b.pgm") == Exif()


@pytest.mark.parametrize(
    ("mm", "contradicts"),
    [(70, False), (72, False), (68, False), (72.2, True), (105, True)],
)
def test_a_focal_length_other_than_the_plans_by_more_than_3_percent_is_told(
    tmp_path: Path, mm: float, contradicts: bool
) -> None:
    lines = told(photograph(tmp_path / "a.jpg", FocalLength=float(mm)))
    assert bool(lines) == contradicts
    if contradicts:
        assert (
            f"a.jpg was taken at {mm:g} mm by its EXIF, but the plan has lens.focal_length_mm = 70"
            in lines[0]
        )


@pytest.mark.parametrize(
    ("f_number", "contradicts"),
    [(2.8, False), (3.1, False), (3.2, True), (2.5, False), (5.6, True)],
)
def test_an_f_number_more_than_a_third_of_a_stop_from_the_plans_is_told(
    tmp_path: Path, f_number: float, contradicts: bool
) -> None:
    lines = told(photograph(tmp_path / "a.jpg", FNumber=f_number))
    assert bool(lines) == contradicts
    if contradicts:
        assert (
            f"at f/{f_number:g} by its EXIF, but the plan has lens.f_number = 2.8"
            in lines[0]
        )


def test_two_stops_are_a_factor_of_two() -> None:
    assert stops_between(2.8, 5.6) == pytest.approx(2.0)


def test_photographs_of_two_settings_in_a_session_are_told(tmp_path: Path) -> None:
    one = photograph(tmp_path / "a.jpg", FocalLength=70.0, FNumber=2.8, LensModel="Z 70")
    other = photograph(tmp_path / "b.jpg", FocalLength=71.0, FNumber=3.0, LensModel="Z 71")
    lines = told(one, other)
    assert [line.split(":")[0] for line in lines] == [
        "the photographs differ in focal length",
        "the photographs differ in f-number",
        "the photographs differ in lens",
    ]
    assert (
        "a.jpg has 70 mm, b.jpg 71 mm by their EXIF; a session has one lens at one setting"
        in lines[0]
    )
    assert told(one, one) == []
    assert told(one, other, kind="dark") == []


def test_import_tells_on_the_terminal_what_contradicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    path = photograph(tmp_path / "a.jpg", FocalLength=105.0)
    with Image.open(path) as old:
        picture = np.full((64, 96), 30) + rng.integers(0, 4, (64, 96))
        picture[16:48, 16:48] += 150
        Image.fromarray(picture.astype(np.uint8)).save(path, exif=old.getexif(), quality=95)
    (tmp_path / "plan.toml").write_text(plan_text(PORTRAIT))
    (tmp_path / "frames.csv").write_text("file,kind,range_mm\na.jpg,target,\n")
    assert (
        run(
            [
                "import",
                *(str(tmp_path / name) for name in ("frames.csv", "plan.toml", "session")),
            ]
        )
        == 0
    )
    shown = capsys.readouterr().err.splitlines()
    assert any("105 mm by its EXIF" in line for line in shown)
    assert any(
        "processed pictures (JPEG, 8 bit), tone curve undone by sRGB" in line
        for line in shown
    )
