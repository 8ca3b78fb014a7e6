"""`labkit plan --interactive`: a plan by questions, each answer checked as the plan is; piped in, or at a terminal."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from labkit.cli import run
from labkit.plan import Plan
from tests.unit.test_exif import photograph


def asked(
    answers: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *options: str
) -> int:
    monkeypatch.setattr(
        "sys.stdin", io.StringIO("".join(f"{answer}\n" for answer in answers))
    )
    return run(["plan", "--interactive", "--out", str(tmp_path / "plan.toml"), *options])


BEFORE_TARGET = ["yes", "70", "f/2,8", "4.78", "unknown", "650", "550", "450"]


TARGET = ["", "5", "46.8"]


def test_what_is_known_only_of_a_lens_a_sensor_and_a_target_has_no_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = ["", "70", "2.8", "4.78", *[""] * 5, "5", "46.8", "", "", ""]
    assert asked(answers, tmp_path, monkeypatch) == 0
    plan = Plan.load(tmp_path / "plan.toml")
    assert (plan.lens.focal_length_mm, plan.target.order, plan.camera) == (70.0, 5, None)
    assert [channel.name for channel in plan.channel] == ["R", "G", "B"]
    lines = (tmp_path / "plan.toml").read_text().splitlines()
    assert "order = 5  # of the carpet" in lines


@pytest.mark.parametrize(
    ("place", "key"),
    [
        (1, "lens.focal_length_mm"),
        (2, "lens.f_number"),
        (3, "sensor.pixel_pitch_um"),
        (9, "target.order"),
        (10, "target.size_mm"),
    ],
)
def test_nothing_is_invented_for_an_empty_answer(
    place: int,
    key: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    answers = ["", "70", "2.8", "4.78", *[""] * 5, "5", "46.8"]
    answers[place] = ""
    assert asked(answers, tmp_path, monkeypatch) == 2
    question, said = capsys.readouterr().err.splitlines()[-2:]
    assert f"({key}), such as " in question
    assert said.startswith(f"labkit: {key} has no default: give it, such as ")


@pytest.mark.parametrize(
    ("focal", "stop", "pitch"),
    [
        ("50 mm", "f/2.8", "6um"),
        ("50mm", "2.8", "6 µm"),
        ("50,0 mm", "F2.8", "6 μm"),
        ("50", "f/2,8", "6.0"),
    ],
)
def test_units_may_be_typed(
    focal: str, stop: str, pitch: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = ["", focal, stop, pitch, "", "605 nm", "", "", *TARGET, "", ""]
    assert asked(answers, tmp_path, monkeypatch) == 0
    plan = Plan.load(tmp_path / "plan.toml")
    stated = plan.lens.focal_length_mm, plan.lens.f_number, plan.sensor.pixel_pitch_um
    assert stated == (50.0, 2.8, 6.0)
    assert plan.channel[0].wavelength_nm == 605.0


def test_answers_are_read_as_people_write_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail = ["grbl:/dev/ttyUSB0", "3000, 3200 3300", "2950", "-1"]
    camera = ["gphoto2:usb:001,004", "1/50", "", "2", "4", "0"]
    answers = [
        *BEFORE_TARGET,
        "",
        "4",
        "15.6",
        "white",
        "yes",
        *camera,
        *rail,
        "manual:",
    ]
    assert asked(answers, tmp_path, monkeypatch) == 0
    plan = Plan.load(tmp_path / "plan.toml")
    assert (plan.lens.f_number, plan.target.size_mm, plan.target.surround) == (
        2.8,
        15.6,
        "white",
    )
    assert plan.camera is not None
    assert plan.rail is not None
    assert plan.display is not None
    assert (plan.camera.exposure_s, plan.camera.darks) == (0.02, 0)
    assert (plan.rail.ranges_mm, plan.rail.direction) == ((3000.0, 3200.0, 3300.0), -1)
    assert plan.display.by_hand


def test_a_light_by_its_name_takes_the_place_of_wavelengths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [*BEFORE_TARGET[:4], "daylight", *TARGET, "", ""]
    assert asked(answers, tmp_path, monkeypatch) == 0
    assert "wavelength_nm" not in (tmp_path / "plan.toml").read_text()
    plan = Plan.load(tmp_path / "plan.toml")
    assert [channel.light for channel in plan.channel] == ["daylight"] * 3


def test_what_a_target_needs_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (
        asked(
            ["no", "50", "2", "6", "550", "disks", "3, 4", "1.5", "80", "", ""],
            tmp_path,
            monkeypatch,
        )
        == 0
    )
    plan = Plan.load(tmp_path / "plan.toml")
    assert (plan.target.grid, plan.target.diameter_mm) == ((3, 4), 1.5)
    assert [channel.name for channel in plan.channel] == ["M"]


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        (["perhaps"], "'perhaps': allowed is yes or no"),
        (
            ["yes", "long"],
            "lens.focal_length_mm = 'long': allowed is a number, 0.1 to 10000",
        ),
        (
            [*BEFORE_TARGET[:4], "candle"],
            "channel.light = 'candle': allowed is one of led, led-panel, rgb-led, ccfl-panel, fluorescent, halogen, "
            "daylight, or unknown",
        ),
        ([*BEFORE_TARGET, "carpet"], "target.kind = 'carpet': allowed is checkerboard"),
        ([*BEFORE_TARGET, "image", "no.pgm"], "no.pgm"),
        ([*BEFORE_TARGET, "", "9"], "target.order = 9: allowed is a whole number, 1 to 8"),
        (
            [*BEFORE_TARGET, *TARGET, "", "yes", "usb:1"],
            "camera.address = 'usb:1': allowed is one of gphoto2:",
        ),
        (
            [*BEFORE_TARGET, *TARGET, "", "yes", *[""] * 7, "40"],
            "rail.ranges_mm has 40 mm: allowed is more than the focal",
        ),
        (
            [*BEFORE_TARGET, *TARGET, "", "yes", *[""] * 8, "2950", "", "", "iphone"],
            'display.panel = "iphone": known are',
        ),
        (["yes", "70"], "the input ended at the question: f-number"),
    ],
)
def test_an_answer_that_no_plan_takes_is_refused_and_nothing_is_written(
    answers: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert asked(answers, tmp_path, monkeypatch) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert words in last
    assert last.endswith("; nothing was written")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_is_said_before_anything_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text("mine")
    assert asked([], tmp_path, monkeypatch) == 2
    assert "is there already: give another name with --out" in capsys.readouterr().err
    assert (tmp_path / "plan.toml").read_text() == "mine"


def test_a_photograph_gives_the_defaults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated: dict[str, Any] = {"FocalLength": 105.0, "FNumber": 4.0}
    image = photograph(tmp_path / "a.jpg", **stated)
    answers = ["", "", "6", "550", *TARGET, "", "", ""]
    assert asked(answers, tmp_path, monkeypatch, str(image)) == 0
    plan = Plan.load(tmp_path / "plan.toml")
    assert (plan.lens.focal_length_mm, plan.lens.f_number) == (105.0, 4.0)
    assert "# by EXIF" in (tmp_path / "plan.toml").read_text()


def test_neither_photograph_nor_questions_is_said(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["plan"]) == 2
    assert (
        "give a photograph to make the plan from, or --interactive"
        in capsys.readouterr().err
    )


def test_at_a_terminal_a_wrong_answer_is_asked_for_again_and_ctrl_c_writes_nothing(
    tmp_path: Path,
) -> None:
    near, far = os.openpty()
    command = [
        sys.executable,
        "-c",
        "from labkit.cli import main; main()",
        "plan",
        "--interactive",
    ]
    with subprocess.Popen(
        command, stdin=far, stderr=subprocess.PIPE, cwd=tmp_path
    ) as running:
        try:
            assert running.stderr is not None
            seen = b""
            for question, typed in (
                (b"yes or no [yes]: ", b"y\n"),
                (b"such as 50: ", b"\n"),
                (b"such as 50: ", b"0\n"),
                (b"such as 50: ", b"85 mm\n"),
                (b"such as 2.8: ", b""),
            ):
                while question not in seen:
                    more = os.read(running.stderr.fileno(), 4096)
                    assert more, seen
                    seen += more
                seen = seen.partition(question)[2]
                os.write(near, typed)
            running.send_signal(signal.SIGINT)
            assert b"labkit: interrupted; nothing was written" in running.stderr.read()
            assert running.wait(timeout=100) == 130
        finally:
            running.kill()
            os.close(near)
            os.close(far)
    assert list(tmp_path.iterdir()) == []
