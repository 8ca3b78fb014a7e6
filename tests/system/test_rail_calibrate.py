"""`labkit rail calibrate`: the rail moves, a person measures."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from labkit.cli import run
from tests.plans import SMALL, plan_text


def calibrate(address: str, answers: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> int:
    plan = tmp_path / "plan.toml"
    rail = {"address": address, "ranges_mm": [2000, 2050], "range_at_zero_mm": 1950.0, "microstep_um": 0.5}
    plan.write_text(plan_text(SMALL, {"rail": rail}))
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(["", *answers, ""])))
    return run(["rail", "calibrate", str(plan), *options])


@pytest.mark.parametrize("address", ["grbl:simulated", "zaber:simulated"])
def test_the_lines_for_the_plan_come_out(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = ["3110.2", "3089.9"]
    assert calibrate(address, answers, tmp_path, monkeypatch, "--at", "30", "--at", "50") == 0
    told = capsys.readouterr()
    assert "range_at_zero_mm = 3140.0" in told.out or "range_at_zero_mm = 3140.1" in told.out
    assert "direction = -1" in told.out
    assert "home and then move to 30, 50 mm" in told.err


def test_json_tells_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    at = ["--at", "20", "--at", "40", "--at", "60"]
    assert calibrate("grbl:simulated", ["2020", "2040", "2060"], tmp_path, monkeypatch, *at, "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["direction"], answer["range_at_zero_mm"]) == (1, pytest.approx(2000.0))


@pytest.mark.parametrize(
    ("answers", "options", "words"),
    [
        (["3000", "3200"], ["--at", "30", "--at", "50"], "10.000 mm for each mm of the rail"),
        ([], ["--at", "-5000", "--at", "50"], "--at -5000: the rail goes from"),
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
