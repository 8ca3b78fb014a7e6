"""A plan made from a photograph holds what EXIF states, and loads once the rest is filled in."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from labkit.cli import run
from labkit.errors import PlanError, RawError
from labkit.plan import Plan
from labkit.session.draft_plan import draft_plan
from tests.dng import write_dng
from tests.unit.test_exif import photograph


def filled(text: str) -> str:
    """With every example taken as the true value."""
    return re.sub(r"(?m)^# (\w+ = .*# fill in: )", r"\1", text)


def test_what_exif_states_is_in_the_plan_and_the_rest_is_to_be_filled_in(
    tmp_path: Path,
) -> None:
    stated: dict[str, Any] = {
        "FocalLength": 105.0,
        "FNumber": 4.0,
        "FocalPlaneXResolution": 209.2,
        "FocalPlaneResolutionUnit": 4,
    }
    draft = draft_plan(photograph(tmp_path / "a.jpg", **stated))
    assert draft.fill_in == (
        "channel.wavelength_nm",
        "target.order",
        "target.size_mm",
    )  # a grey picture
    with pytest.raises(PlanError, match="size_mm is missing"):
        Plan.parse(draft.text)
    plan = Plan.parse(filled(draft.text))
    assert (plan.lens.focal_length_mm, plan.lens.f_number) == (105.0, 4.0)
    assert plan.sensor.pixel_pitch_um == pytest.approx(1000 / 209.2, abs=1e-3)


def test_the_pixel_pitch_follows_from_the_focal_length_on_35_mm_film(
    tmp_path: Path,
) -> None:
    # 70 mm that see as 105 mm on 36 × 24 mm: a sensor of 24 × 16 mm, here of 2400 × 1600 pixels
    path = tmp_path / "a.jpg"
    stated: dict[str, Any] = {"FocalLength": 70.0, "FocalLengthIn35mmFilm": 105}
    with Image.open(photograph(path, **stated)) as picture:
        exif = picture.getexif()
    Image.fromarray(np.full((1600, 2400, 3), 99, np.uint8)).save(path, exif=exif)
    plan = Plan.parse(filled(draft_plan(path).text))
    assert plan.sensor.pixel_pitch_um == pytest.approx(10.0, rel=1e-3)
    assert ([channel.name for channel in plan.channel], plan.sensor.cfa_pattern) == (
        ["R", "G", "B"],
        "RGB",
    )


def test_a_picture_made_smaller_has_larger_pixels_than_its_camera(tmp_path: Path) -> None:
    stated: dict[str, Any] = {
        "FocalPlaneXResolution": 200.0,
        "FocalPlaneResolutionUnit": 4,
        "ExifImageWidth": 96,
        "ExifImageHeight": 64,
    }
    plan = Plan.parse(filled(draft_plan(photograph(tmp_path / "a.jpg", **stated)).text))
    assert plan.sensor.pixel_pitch_um == pytest.approx(10.0)


def test_a_raw_files_plan_leaves_levels_and_pattern_to_the_file(tmp_path: Path) -> None:
    draft = draft_plan(write_dng(tmp_path / "a.dng", np.full((60, 90), 900, np.uint16)))
    plan = Plan.parse(filled(draft.text))
    assert (plan.sensor.cfa_pattern, plan.sensor.black_level) == (None, None)
    assert [channel.name for channel in plan.channel] == ["R", "G", "B"]
    assert "lens.focal_length_mm" in draft.fill_in
    assert "Acme D1, 0.02 s, ISO 200" in draft.text


def test_bare_numbers_are_to_be_explained(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((40, 40), np.uint8)).save(tmp_path / "a.png")
    draft = draft_plan(tmp_path / "a.png")
    assert {"sensor.cfa_pattern", "sensor.black_level", "sensor.white_level"} <= set(
        draft.fill_in
    )
    assert Plan.parse(filled(draft.text)).sensor.white_level == 255


def test_hostile_tags_stay_in_their_comment(tmp_path: Path) -> None:
    draft = draft_plan(photograph(tmp_path / "a.jpg", camera='X\n[lens]\nf_number = 1 # "'))
    assert Plan.parse(filled(draft.text)).lens.f_number == 2.8  # the example's


def test_the_command_writes_once_and_never_over_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image, out = photograph(tmp_path / "a.jpg", FocalLength=70.0), tmp_path / "plan.toml"
    command = ["plan", str(image), "--out", str(out), "--json"]
    assert run(command) == 0
    assert "target.size_mm" in json.loads(capsys.readouterr().out)["fill_in"]
    out.write_text(filled(out.read_text()))
    assert Plan.load(out).lens.focal_length_mm == 70.0
    kept = out.read_text()
    assert run(command) == 2
    assert (
        f"{out} is there already: give another name with --out" in capsys.readouterr().err
    )
    assert out.read_text() == kept


def test_no_photograph_gives_no_plan(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_text("a letter")
    with pytest.raises(RawError, match=r"a\.jpg: is no photograph"):
        draft_plan(tmp_path / "a.jpg")
