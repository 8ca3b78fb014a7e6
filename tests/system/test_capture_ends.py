"""How a capture that cannot go on ends: what it says is true, and names what was asked."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from labkit.cli import run
from labkit.drivers.simulated import setup as bench_setup
from labkit.drivers.simulated.camera import SimulatedCamera
from labkit.drivers.simulated.world import BenchSettings
from labkit.errors import CameraError
from labkit.session.session import Session
from tests.plans import SMALL, plan_text, simulated

FEW = {
    "camera": {"frames_per_range": 2, "flats_per_range": 2, "darks": 2},
    "rail": {"settle_s": 0},
}
LAST = "target_2050_1"


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(bench_setup, "BenchSettings", partial(BenchSettings, halo_um=100.0))
    path = tmp_path / "plan.toml"
    path.write_text(plan_text(SMALL, simulated([2000, 2050], 1950.0), FEW))
    return path


def unplug_at_last(monkeypatch: pytest.MonkeyPatch, also: object = lambda: None) -> None:
    """The camera is gone when the last photograph is due, and something else happens."""
    expose = SimulatedCamera.expose

    def exposed(camera: SimulatedCamera, path: Path) -> object:
        if path.stem == LAST:
            also()  # type: ignore[operator]
            raise CameraError("it is gone")
        return expose(camera, path)

    monkeypatch.setattr(SimulatedCamera, "expose", exposed)


def test_how_to_go_on_keeps_the_options_that_were_given(
    plan: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = tmp_path / "s"
    unplug_at_last(monkeypatch)
    assert (
        run(["capture", str(plan), str(session), "--no-preflight", "--quiet", "--simulate"])
        == 1
    )
    assert capfd.readouterr().err == (
        f"labkit: it is gone; every photograph so far is safe, go on with: "
        f"labkit capture {plan} {session} --resume --no-preflight --simulate --quiet\n"
    )


@pytest.mark.parametrize("lost", ["frames/flat_2000_1.dng", "journal.jsonl"])
def test_photographs_are_called_safe_only_where_they_are(
    lost: str,
    plan: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unplug_at_last(monkeypatch, (tmp_path / "s" / lost).unlink)
    assert run(["capture", str(plan), str(tmp_path / "s"), "--no-preflight"]) in (1, 2)
    said = capfd.readouterr().err
    assert (
        "photographs are missing or the journal is damaged: labkit verify names them; mend that, then go on"
        in said
    )
    assert "safe" not in said


def test_resuming_what_is_complete_names_a_damaged_photograph(
    plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["capture", str(plan), str(tmp_path / "s"), "--no-preflight"]) == 0
    (tmp_path / "s" / "frames" / "dark_0.dng").write_bytes(b"0")
    assert run(["capture", str(plan), str(tmp_path / "s"), "--resume"]) == 1
    assert "has all that the plan asks for, but " in (said := capfd.readouterr().err)
    assert "dark_0.dng: does not fit its checksum" in said


def test_faults_ordered_in_a_plan_come_to_pass(plan: Path, tmp_path: Path) -> None:
    plan.write_text(
        plan.read_text().replace(
            '"simulated:"', '"simulated:camera.unplug=3,rail.stall=1x2"'
        )
    )
    assert run(["capture", str(plan), str(tmp_path / "s"), "--no-preflight"]) == 0
    session = Session.open(tmp_path / "s")
    trouble = [
        (event["device"], event["attempt"])
        for event in session.events
        if event["event"] == "trouble"
    ]
    assert trouble == [("rail", 1), ("rail", 2), ("camera", 1)]
    assert len(session.frames) == 10


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "command", [["capture", "pipe", "s"], ["import", "pipe", "plan.toml", "s"]]
)
def test_a_pipe_in_the_place_of_a_file_is_refused_at_once(
    command: list[str],
    plan: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    assert run(command) == 2
    assert "pipe: a pipe or a device; a file is needed" in capfd.readouterr().err


@pytest.mark.parametrize(
    "locale",
    [{}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
    ids=["any bytes", "ASCII locale"],
)
def test_a_session_may_lie_under_names_of_any_bytes(
    locale: dict[str, str], plan: Path, tmp_path: Path
) -> None:
    folder = (
        os.fsencode(tmp_path)
        + ("/nuit d'été" if locale else "/nuit ").encode()
        + (b"" if locale else b"\xff")
    )
    os.mkdir(folder)
    command = [sys.executable, "-c", "from labkit.cli import main; main()"]
    for args in (
        [b"capture", os.fsencode(plan), folder + b"/s", b"--no-preflight"],
        [b"verify", folder + b"/s"],
    ):
        done = subprocess.run(
            [*command, *args],
            env={**os.environ, **locale},
            capture_output=True,
            timeout=100,
        )
        said = [
            line for line in done.stderr.splitlines() if b" so far" not in line
        ]  # of progress, where it takes long
        assert (done.returncode, said) == (0, [])
    assert len(Session.open(Path(os.fsdecode(folder)) / "s").frames) == 10


def test_too_little_memory_is_no_fault_of_labkit(
    plan: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def much(*args: object, **options: object) -> None:
        raise MemoryError("Unable to allocate 954. MiB for an array")

    monkeypatch.setattr("labkit.advice.advise.advise", much)
    assert run(["advise", str(plan)]) == 1
    said = "labkit: there is not enough memory: Unable to allocate 954. MiB for an array; close other programs\n"
    assert capfd.readouterr().err == said
