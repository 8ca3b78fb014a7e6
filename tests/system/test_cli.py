"""The command line as a user meets it: exit statuses, one-line errors, JSON, completion, Ctrl-C."""

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from labkit.cli import run
from labkit.drivers.simulated import setup as bench_setup
from labkit.drivers.simulated.camera import SimulatedCamera
from labkit.drivers.simulated.world import BenchSettings
from labkit.errors import CameraError
from labkit.session.session import Session
from labkit.version import __version__
from tests.plans import IPAD, PORTRAIT, SMALL, plan_text, simulated

WriteDng = Callable[..., Path]

PLAN = plan_text(
    PORTRAIT,
    {"target": {"order": 3, "size_mm": 20.78}},
    simulated([3000, 3100], 2950.0),
    {
        "camera": {"frames_per_range": 2, "flats_per_range": 2, "darks": 2},
        "rail": {"settle_s": 0},
        "display": IPAD,
    },
)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def quick_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One whose capture takes a moment in this process, and seconds in one of its own."""
    monkeypatch.setattr(bench_setup, "BenchSettings", partial(BenchSettings, halo_um=100.0))
    path = tmp_path / "quick.toml"
    few = {
        "camera": {"frames_per_range": 2, "flats_per_range": 2, "darks": 2},
        "rail": {"settle_s": 0},
    }
    path.write_text(plan_text(SMALL, simulated([2000, 2050], 1950.0), few))
    return path


@pytest.fixture
def frames(tmp_path: Path, write_dng: WriteDng) -> Path:
    light = np.zeros((62, 94))
    light[20:40, 30:60] = 5000
    noise = np.random.default_rng(1).normal(600, 3, light.shape)
    write_dng(tmp_path / "target.dng", np.rint(light + noise).astype(np.uint16))
    path = tmp_path / "frames.csv"
    path.write_text("file,kind,range_mm\ntarget.dng,target,3000\n")
    return path


def one_line(text: str) -> str:
    """The text, if it is one line of plain characters."""
    assert text.endswith("\n")
    assert re.fullmatch(r"labkit: [^\x00-\x1f]+", text[:-1])
    return text


def labkit(*args: object) -> list[str]:
    return [sys.executable, "-c", "from labkit.cli import main; main()", *map(str, args)]


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"labkit {__version__}\n"


@pytest.mark.parametrize(
    "args", [["--help"], ["capture", "--help"], ["target", "render", "--help"]]
)
def test_help_has_no_control_characters_off_a_terminal(
    args: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(args) == 0
    assert re.search(r"[\x00-\x09\x0b-\x1f]", capfd.readouterr().out) is None


@pytest.mark.parametrize(
    "args",
    [
        ["nonsense"],
        ["fit"],
        ["verify", "a", "b"],
        ["fit", "x", "--workers", "0"],
        ["fit", "x", "--range", "far"],
        ["demo", "--sed"],
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    args: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(args) == 2
    assert re.search(
        r"[^.]\. See labkit( \w+)? --help\.$", one_line(capfd.readouterr().err)
    )


@pytest.mark.parametrize(
    ("args", "kind", "words"),
    [
        (
            ["verify", "no-session"],
            "SessionError",
            "no-session is no session: it is not there; give the folder that",
        ),
        (["verify", "a", "b"], "UsageError", "unexpected extra argument"),
        (["fit", "no-session"], "SessionError", "no-session is no session"),
    ],
)
def test_with_json_an_error_is_json_too(
    args: list[str], kind: str, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run([*args, "--json"]) == 2
    out, err = capfd.readouterr()
    error = json.loads(out)["error"]
    assert error["kind"] == kind
    assert words in error["message"]
    assert words in one_line(err)


def test_with_json_there_is_one_object_even_where_the_answer_holds_what_is_wrong(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session), "--quiet"]) == 0
    (session / "frames" / "target.dng").write_bytes(b"")
    assert run(["verify", str(session), "--json"]) == 1
    assert "does not fit its checksum" in json.loads(capfd.readouterr().out)["problems"][0]


def test_bad_input_is_one_line_and_status_2(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["verify", str(tmp_path)]) == 2
    out, err = capfd.readouterr()
    assert "is no session" in one_line(err)
    assert out == ""


@pytest.mark.parametrize("where", [0, 2])
def test_debug_shows_the_traceback_wherever_it_stands(
    where: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    args = ["verify", str(tmp_path)]
    args.insert(where, "--debug")
    assert run(args) == 2
    assert "Traceback" in capfd.readouterr().err


def test_import_and_verify_answer_in_json(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["kinds"] == {
        "target": 1,
        "flat": 0,
        "dark": 0,
        "bias": 0,
    }
    assert run(["--json", "verify", str(session)]) == 0
    assert json.loads(capfd.readouterr().out) == {
        "session": str(session),
        "frames": 1,
        "problems": [],
        "remarks": [],
    }


def test_quiet_prints_nothing_when_all_is_well(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert (
        run(["import", "--quiet", str(frames), str(plan), str(tmp_path / "session")]) == 0
    )
    assert capfd.readouterr() == ("", "")


def test_verify_fails_with_status_1_and_names_the_file(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session)]) == 0
    (session / "frames" / "target.dng").write_bytes(b"altered")
    capfd.readouterr()
    assert run(["verify", str(session)]) == 1
    said = one_line(capfd.readouterr().err)
    assert "target.dng: does not fit its checksum" in said
    assert (
        "; put back a copy of each, from a backup or the camera's card; without one" in said
    )


def test_a_torn_journal_is_told_as_a_warning(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session)]) == 0
    journal = session / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-9])
    capfd.readouterr()
    assert run(["verify", str(session)]) == 0
    torn, adding = capfd.readouterr().err.splitlines(keepends=True)
    assert "torn last line" in one_line(torn)
    assert "target.dng was being added" in one_line(adding)


def test_reporting_before_fitting_says_what_to_do(
    frames: Path, plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session), "--quiet"]) == 0
    assert run(["report", str(session)]) == 2
    assert "fit" in one_line(capfd.readouterr().err)


def test_devices_lists_the_simulated_drivers(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["devices", "--json"]) == 0
    drivers = json.loads(capfd.readouterr().out)["drivers"]
    assert all("simulated" in drivers[device] for device in ("camera", "rail", "display"))


def test_a_target_is_rendered(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "carpet.png"
    assert (
        run(["target", "render", "sierpinski:order=3,size_mm=20", str(file), "--json"]) == 0
    )
    assert json.loads(capfd.readouterr().out)["path"] == str(file)
    assert file.read_bytes().startswith(b"\x89PNG")


def test_a_plan_for_capture_needs_camera_and_rail(
    plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    plan.write_text(PLAN.partition("[rail]")[0])
    assert run(["capture", str(plan), str(tmp_path / "session")]) == 2
    assert "the plan has no [rail]: to capture" in one_line(capfd.readouterr().err)
    assert not (tmp_path / "session").exists()


def test_a_plan_that_the_devices_cannot_run_begins_no_session(
    plan: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    plan.write_text(PLAN.replace("20.78", "20"))
    assert run(["capture", str(plan), str(tmp_path / "session")]) == 2
    assert "target.size_mm" in one_line(capfd.readouterr().err)
    assert not (tmp_path / "session").exists()


def test_tab_completes_commands() -> None:
    environment = {
        **os.environ,
        "_LABKIT_COMPLETE": "complete_bash",
        "COMP_WORDS": "labkit cap",
        "COMP_CWORD": "1",
    }
    done = subprocess.run(
        labkit(), env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.split() == ["capture"]


def test_progress_shows_the_time_left_on_a_terminal(
    frames: Path, plan: Path, tmp_path: Path
) -> None:
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    command = labkit("import", frames, plan, tmp_path / "session")
    with subprocess.Popen(
        command, stderr=theirs, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        out, _ = process.communicate(timeout=60)
    os.close(theirs)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert "importing" in shown
    assert "left" in shown
    assert "\x1b" not in out


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_capture_that_is_interrupted_says_how_to_go_on_and_does(
    number: signal.Signals, quick_plan: Path, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    command = labkit("capture", quick_plan, session)
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        # before the first photograph; the capture takes seconds after that
        while not (
            (session / "journal.jsonl").exists()
            and '"began"' in (session / "journal.jsonl").read_text()
        ):
            assert process.poll() is None
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    err = err.splitlines(keepends=True)[-1]  # after lines of progress, on a loaded machine
    assert f"labkit capture {quick_plan} {session} --resume" in one_line(err)
    assert out == ""
    by = "Ctrl-C" if number == signal.SIGINT else number.name
    assert err.startswith(
        "labkit: interrupted"
        if number == signal.SIGINT
        else f"labkit: interrupted by {by}; "
    )
    assert Session.open(session).events[-1]["event"] == "interrupted"
    assert Session.open(session).events[-1]["by"] == by
    assert run(["verify", str(session)]) == 0
    assert run(["capture", str(quick_plan), str(session), "--resume"]) == 0
    assert len(Session.open(session).frames) == 10
    assert run(["verify", str(session)]) == 0


def test_resuming_what_is_complete_needs_no_devices(
    quick_plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["capture", str(quick_plan), str(session)]) == 0
    with quick_plan.open("a") as file:
        file.write("# a comment\n")
    assert (
        run(
            ["capture", str(quick_plan), str(session), "--resume", "--listen", "no address"]
        )
        == 0
    )
    last = f": 10 frames, all that the plan asks for; next: labkit fit {session}\n"
    assert capsys.readouterr().out.endswith(last)


def test_a_capture_that_its_camera_ends_says_how_to_go_on(
    quick_plan: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unplugged(camera: SimulatedCamera, path: Path) -> None:
        raise CameraError("it is gone")

    monkeypatch.setattr(SimulatedCamera, "expose", unplugged)
    session = tmp_path / "a session"
    assert run(["capture", str(quick_plan), str(session), "--no-preflight"]) == 1
    resume = f"labkit capture {quick_plan} '{session}' --resume --no-preflight"
    assert one_line(capfd.readouterr().err) == f"labkit: it is gone; go on with: {resume}\n"


def test_resuming_with_another_plan_is_refused(
    plan: Path, frames: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    assert run(["import", str(frames), str(plan), str(session), "--quiet"]) == 0
    plan.write_text(PLAN.replace("3100", "3150").replace("550.0", "540.0"))
    assert run(["capture", str(plan), str(session), "--resume"]) == 2
    assert "differs in [channel], [rail]" in one_line(capfd.readouterr().err)


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_do_no_harm(
    closed: str, frames: Path, plan: Path, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    command = " ".join(map(shlex.quote, labkit("import", frames, plan, session)))
    done = subprocess.run(
        f"{command} {closed}", shell=True, timeout=60, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert run(["verify", str(session)]) == 0
