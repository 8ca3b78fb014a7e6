"""`labkit camera settings` and `labkit camera test`, with libgphoto2's virtual camera and with none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.cli import run
from labkit.drivers.gphoto2 import camera as gphoto2_camera
from labkit.drivers.simulated.dng import RawTags, write_raw
from tests.plans import PORTRAIT, plan_text

pytest.importorskip("gphoto2")

PLAN = plan_text(
    PORTRAIT,
    {
        "target": {"order": 3, "size_mm": 20.0},
        "camera": {"address": "gphoto2:usb:001,001", "exposure_s": 0.02},
    },
)


def lay(path: Path, counts: NDArray[np.float64]) -> None:
    tags = RawTags(black_level=600, white_level=16383, exposure_s=0.02, iso=200)
    write_raw(path, np.clip(counts, 0, 16383).astype(np.uint16), tags)


def test_settings_of_the_only_camera_are_listed(
    photograph: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lay(photograph, np.full((64, 96), 700.0))
    assert run(["camera", "settings"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("Nikon DSC D750, serial 0.1, libgphoto2 2.5")
    (shutter,) = [line for line in lines if line.startswith("shutterspeed")]
    assert shutter.split()[1:4] == ["0.0100s", "1.0000s,", "0.1000s,"]
    assert run(["camera", "settings", "gphoto2:usb:001,001", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == "Nikon DSC D750"


def test_a_test_frame_tells_light_clipping_noise_and_sharpness(
    photograph: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # an edge that rises linearly over 8 pixels, noise of 40 counts, and a fifth of the frame full
    edge = np.clip((np.arange(400.0) - 196) / 8, 0, 1) * 8000 + 1600
    counts = np.tile(edge, (200, 1)) + np.random.default_rng(1).normal(0, 40, (200, 400))
    counts[:, 320:] = 16383
    lay(photograph, counts)
    assert run(["camera", "test", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["pixels"] == [200, 400]
    assert found["iso"] == 200
    for colour in found["colours"]:
        assert colour["full_percent"] == pytest.approx(20)
        assert colour["brightest"] == 16383 - 600
        # the smoothest tenth of 64 parts of 300 pixels, each good to 7 %: 9 % below the truth
        assert colour["noise"] == pytest.approx(0.91 * 40, rel=0.07)
    assert found["blur_px"] is None


def test_a_dark_frame_is_said_to_have_no_light_and_no_sharpness(
    photograph: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lay(photograph, np.random.default_rng(1).normal(600, 3, (400, 600)))
    assert run(["camera", "test"]) == 0
    told = capsys.readouterr()
    assert told.err.startswith("labkit: warning: the photograph is black: ")
    assert "is the cap on the lens" in told.err
    assert "focus" not in told.out
    assert "target: not looked for: there is no light" in told.out


def test_with_a_plan_the_camera_is_set_first_and_told_what_it_cannot(
    photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lay(photograph, np.full((64, 96), 700.0))
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.replace("exposure_s = 0.02", "exposure_s = 0.03"))
    assert run(["camera", "test", str(plan)]) == 1
    error = capsys.readouterr().err
    assert "exposure_s = 0.03: allowed are" in error
    assert "0.02, 0.05" in error
    plan.write_text(plan.read_text().replace("0.03", "0.02"))
    assert run(["camera", "test", str(plan)]) == 0
    said = capsys.readouterr()
    assert "0.02 s" in said.out
    assert "labkit: warning: check by hand: vibration reduction off" in said.err


def test_without_a_camera_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("VCAMERADIR", raising=False)
    monkeypatch.setattr(gphoto2_camera, "TRY_PAUSES_S", (0.0,))
    assert run(["camera", "settings"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "plug it in, switch it on" in error


def test_only_the_plans_channels_are_judged(
    photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    counts = np.random.default_rng(1).normal(4000, 40, (200, 400))
    counts[::2, ::2] = 16383  # all of red is full
    lay(photograph, counts)
    plan = tmp_path / "plan.toml"
    for name, said in (("R", True), ("G", False)):
        plan.write_text(PLAN.replace('name = "G"', f'name = "{name}"'))
        assert run(["camera", "test", str(plan)]) == 0
        assert ("is overexposed" in capsys.readouterr().err) == said


def test_the_plans_display_is_lit_first(
    plan_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["camera", "test", str(plan_file)]) == 0
    said = capsys.readouterr()
    assert "is black" not in said.err
    assert "focus: the sharpest edges rise over" in said.out
