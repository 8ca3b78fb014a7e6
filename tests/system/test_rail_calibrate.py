"""`labkit rail calibrate`: the rail moves, a person measures."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from labkit.cli import run
from tests.plans import SMALL, plan_text


def calibrate(
    address: str,
    answers: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *options: str,
) -> int:
    plan = tmp_path / "plan.toml"
    rail = {
        "address": address,
        "ranges_mm": [2000, 2050],
        "range_at_zero_mm": 1950.0,
        "microstep_um": 0.5,
    }
    plan.write_text(plan_text(SMALL, {"rail": rail}))
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(["", *answers, ""])))
    return run(["rail", "calibrate", str(plan), *options])


@pytest.mark.parametrize("address", ["grbl:simulated", "zaber:simulated"])
def test_the_lines_for_the_plan_come_out(
    address: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    answers = ["3110.2", "3089.9"]
    assert (
        calibrate(address, answers, tmp_path, monkeypatch, "--at", "30", "--at", "50") == 0
    )
    told = capsys.readouterr()
    assert (
        "range_at_zero_mm = 3140.0" in told.out or "range_at_zero_mm = 3140.1" in told.out
    )
    assert "direction = -1" in told.out
    assert "home and then move to 30, 50 mm" in told.err


def test_json_tells_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    at = ["--at", "20", "--at", "40", "--at", "60"]
    assert (
        calibrate(
            "grbl:simulated", ["2020", "2040", "2060"], tmp_path, monkeypatch, *at, "--json"
        )
        == 0
    )
    answer = json.loads(capsys.readouterr().out)
    assert (answer["direction"], answer["range_at_zero_mm"]) == (1, pytest.approx(2000.0))


@pytest.mark.parametrize(
    ("answers", "options", "words"),
    [
        (
            ["3000", "3200"],
            ["--at", "30", "--at", "50"],
            "10.000 mm for each mm of the rail",
        ),
        ([], ["--at", "-5000", "--at", "50"], "--at -5000: the rail goes from"),
        (["1.75", "3000"], ["--at", "30", "--at", "50"], "if metres were meant, type 1750"),
        (
            ["3000"],
            ["--at", "30", "--at", "50"],
            "the input ended at the question: The rail stands at 50",
        ),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_2(
    answers: list[str],
    options: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert calibrate("grbl:simulated", answers, tmp_path, monkeypatch, *options) == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.slow
def test_what_is_typed_during_a_move_is_no_answer(tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    rail = {
        "address": "grbl:simulated",
        "ranges_mm": [2000, 2050],
        "range_at_zero_mm": 1950.0,
    }
    plan.write_text(plan_text(SMALL, {"rail": rail}))
    near, far = os.openpty()
    options = ["--at", "20", "--at", "40", "--at", "60"]
    command = [
        sys.executable,
        "-c",
        "from labkit.cli import main; main()",
        "rail",
        "calibrate",
        str(plan),
        *options,
    ]
    with subprocess.Popen(
        command, stdin=far, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    ) as running:
        try:
            assert running.stderr is not None
            seen = b""
            for asked, typed in (
                (b"press Enter: ", b"\n2019\n"),  # the second line while it homes
                (b"at 20.000 mm. Range from the target to the lens, in mm: ", b"2020\n"),
                (b"at 40.000 mm. Range from the target to the lens, in mm: ", b"1.94\n"),
                (b"if metres were meant, type 1940\nThe rail stands at 40.000 mm. ", b""),
                (b"Range from the target to the lens, in mm: ", b"2940\n"),
                (b"at 60.000 mm. Range from the target to the lens, in mm: ", b"2060\n"),
                (b"2940 mm at 40 mm: this does not fit the others; once more", b""),
                (b"at 40.000 mm. Range from the target to the lens, in mm: ", b"2040\n"),
            ):
                while asked not in seen:
                    more = os.read(running.stderr.fileno(), 4096)
                    assert more, seen
                    seen += more
                seen = seen.partition(asked)[2]
                os.write(near, typed)
            assert running.stdout is not None
            assert b"range_at_zero_mm = 2000.0" in running.stdout.read()
            assert running.wait(timeout=100) == 0
        finally:
            running.kill()
            os.close(near)
            os.close(far)
