"""What goes wrong after the photographs were taken: one line that says so, status 2, and nothing is lost."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from labkit.acquisition.capture import run_plan
from labkit.analysis.observe import observe
from labkit.cli import run
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.errors import RawError
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.target.target import open_target

from .conftest import ADDRESS, PLAN, ContextMaker, small_bench


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A captured session."""
    folder = tmp_path_factory.mktemp("captured")
    (folder / "plan.toml").write_text(PLAN)
    with (
        begin(folder / "plan.toml", folder / "session", resume=False) as session,
        open_devices(session.plan, context=small_bench(folder / "plan.toml")) as devices,
    ):
        run_plan(session, devices, check=False)
    return folder / "session"


@pytest.fixture
def folder(whole: Path, plan_file: Path, tmp_path: Path) -> Path:
    """A copy of the captured session beside its plan, to be spoilt."""
    return shutil.copytree(whole, tmp_path / "session")


def refusal(args: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """The one line that a command prints which fails for its input."""
    assert run(args) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert re.fullmatch(r"labkit: [^\x00-\x1f]+\n", err)
    return err


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def lose(path: Path) -> None:
    path.unlink()


def cut(path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def swap(path: Path) -> None:
    other = "dark_1.dng" if path.name == "dark_0.dng" else "dark_0.dng"
    shutil.copy(path.with_name(other), path)


@pytest.mark.parametrize("command", ["fit", "verify"])
@pytest.mark.parametrize("name", ["dark_0.dng", "flat_2000_0.dng", "target_2050.5_1.dng"])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lose, "missing"),
        (cut, "does not fit its checksum"),
        (empty, "does not fit"),
        (swap, "does not fit"),
    ],
    ids=["missing", "truncated", "empty", "another"],
)
def test_photographs_that_are_not_as_they_were_taken_are_named(
    spoil: Callable[[Path], None],
    words: str,
    name: str,
    command: str,
    folder: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    spoil(folder / "frames" / name)
    before = contents(folder)
    if command == "fit":
        line = refusal(["fit", str(folder)], capfd)
    else:
        assert run(["verify", str(folder)]) == 1
        line = capfd.readouterr().err
    assert f"{name}: {words}" in line
    assert contents(folder) == before


@pytest.mark.parametrize("command", ["fit", "verify", "resume"])
def test_a_journal_that_is_damaged_in_its_middle_is_refused_and_left_alone(
    command: str, folder: Path, plan_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    journal = folder / "journal.jsonl"
    lines = journal.read_bytes().split(b"\n")
    lines[3] = lines[3].replace(b'"event"', b'"evend"')
    journal.write_bytes(b"\n".join(lines))
    before = contents(folder)
    args = (
        ["capture", str(plan_file), str(folder), "--resume"]
        if command == "resume"
        else [command, str(folder)]
    )
    assert "line 4 does not fit its checksum" in refusal(args, capfd)
    assert contents(folder) == before


@pytest.mark.parametrize("command", ["fit", "report", "resume"])
def test_a_plan_that_was_edited_in_its_session_is_named_before_anything_is_done(
    command: str, folder: Path, plan_file: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stored = folder / "plan.toml"
    stored.write_text(stored.read_text().replace("f_number = 8.0", "f_number = 8.1"))
    before = contents(folder)
    args = (
        ["capture", str(plan_file), str(folder), "--resume"]
        if command == "resume"
        else [command, str(folder)]
    )
    assert f"{stored}: does not fit its checksum" in refusal(args, capfd)
    assert contents(folder) == before


def retaken(
    folder: Path, new: Path, swapped: dict[str, str], kept: Sequence[str] = ()
) -> Path:
    """The same session, some photographs with others in their place, rightly in its journal. kept: of all, if only some are."""
    old = Session.open(folder)
    with Session.create(new, (folder / "plan.toml").read_text(), folder) as session:
        for frame in (frame for frame in old.frames if not kept or frame.file in kept):
            source = folder / "frames" / swapped.get(frame.file, frame.file)
            session.add_frame(
                source, frame.file, frame.kind, frame.range_mm, exposure_s=frame.exposure_s
            )
    return new


@pytest.mark.parametrize(
    "instead", ["flat_2050.5_0.dng", "dark_0.dng"], ids=["a white panel", "nothing"]
)
def test_a_photograph_without_the_target_is_named(
    instead: str, folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    alone = [frame.file for frame in Session.open(folder).frames if frame.file != instead]
    other = retaken(folder, tmp_path / "retaken", {"target_2050.5_1.dng": instead}, alone)
    assert "target_2050.5_1.dng: " in refusal(["fit", str(other)], capfd)
    assert not list((other / "results").rglob("*.json"))


def test_a_range_or_channel_that_is_not_there_says_which_are(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert "the session has 2000, 2050.5" in refusal(
        ["fit", str(folder), "--range", "2500"], capfd
    )
    assert "allowed are G" in refusal(["fit", str(folder), "--channel", "R"], capfd)


def test_a_plan_whose_ranges_are_shorter_than_the_focal_length_begins_nothing(
    plan_file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    plan_file.write_text(plan_file.read_text().replace("[2000, 2050.5]", "[2000, 40]"))
    line = refusal(["capture", str(plan_file), str(tmp_path / "new")], capfd)
    assert "rail.ranges_mm has 40 mm: allowed is more than the focal length, 50 mm" in line
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "G"', 'name = "green"', "did you mean G?"),
        ('name = "G"', '"\\u001b[2J" = "G"', r"\x1b[2J is no known key"),
        ("f_number = 8.0", "f_number = f/8", "; write 8"),
    ],
)
def test_a_plan_that_is_wrong_begins_nothing_and_prints_nothing_but_letters(
    old: str,
    new: str,
    words: str,
    plan_file: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    plan_file.write_text(plan_file.read_text().replace(old, new))
    for command in (
        ["capture", str(plan_file), str(tmp_path / "new")],
        ["advise", str(plan_file)],
    ):
        assert words in refusal(command, capfd)
    assert not (tmp_path / "new").exists()


def test_another_camera_in_mid_session_is_refused_and_its_photograph_put_aside(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    folder = tmp_path / "session"

    def stop(done: int, total: int, step: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with (
        begin(plan_file, folder, resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
        pytest.raises(KeyboardInterrupt),
    ):
        run_plan(session, devices, progress=stop, check=False)
    settings = settings_for(Plan.load(plan_file), 7)
    larger = Bench(
        replace(settings, sensor=replace(settings.sensor, rows=settings.sensor.rows + 32)),
        [],
    )
    before = contents(folder / "frames")
    with (
        begin(plan_file, folder, resume=True) as session,
        open_devices(
            session.plan, context=DeviceContext(shared=SharedParts({ADDRESS: larger}))
        ) as devices,
        pytest.raises(
            RawError,
            match=r"dark_2, just taken, is \d+ × \d+ RGGB of .*; the session's frames are \d+ × ",
        ),
    ):
        run_plan(session, devices, check=False)
    assert contents(folder / "frames") == before
    assert [path.name for path in (folder / "rejected").iterdir()] == ["dark_2.dng"]


def test_too_few_ranges_for_a_focus_are_said_after_all_that_could_be_fitted(
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
    capfd: pytest.CaptureFixture[str],
) -> None:
    text = plan_file.read_text().replace("[2000, 2050.5]", "[2060]")
    plan_file.write_text(f"{text}\n[fit]\nzernike_noll = [4, 6]\n")
    with (
        begin(plan_file, tmp_path / "session", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, devices, check=False)
    assert run(["fit", str(tmp_path / "session"), "--workers", "1"]) == 2
    out, err = capfd.readouterr()
    results = tmp_path / "session" / "results" / "latest" / "results.json"
    assert re.search(r"^2060 +G +±\d.* sign open", out, re.MULTILINE)
    assert str(results) in out
    warnings, last = err.splitlines()[:-1], err.splitlines()[-1]
    assert all(line.startswith("labkit: warning: ") for line in warnings)
    assert not any("no best focus" in line for line in warnings)
    assert re.fullmatch(
        r"labkit: no best focus of G, which needs at least 2 ranges: .*", last
    )
    assert json.loads(results.read_text())["focus"] is None


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        (0, "has schema 0; this version reads schemas 1 to 3"),
        (4, "has schema 4, of a newer labkit"),
    ],
)
def test_results_of_another_schema_are_not_reported_on(
    schema: int, words: str, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / "results" / "latest").mkdir(parents=True)
    (folder / "results" / "latest" / "results.json").write_text(f'{{"schema": {schema}}}')
    before = contents(folder)
    assert words in refusal(["report", str(folder)], capfd)
    assert contents(folder) == before


def test_a_fit_that_is_interrupted_says_so_and_leaves_earlier_results_whole(
    folder: Path,
) -> None:
    results = folder / "results" / "latest"
    results.mkdir(parents=True)
    for name in ("results.json", "psf.npz"):
        (results / name).write_text("of an earlier fit")
    before = contents(folder)
    command = [
        sys.executable,
        "-c",
        "from labkit.cli import main; main()",
        "fit",
        str(folder),
        "--workers",
        "2",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        # the workers are the only processes that a fit begins
        while not workers_of(process.pid):
            assert process.poll() is None
        os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it: to all of them
        out, err = process.communicate(timeout=60)
    going_on = b"; fits that are done are kept, and the same command goes on from there"
    assert (process.returncode, out, err) == (
        130,
        b"",
        b"labkit: interrupted" + going_on + b"\n",
    )
    assert contents(folder) == before


def workers_of(pid: int) -> list[str]:
    """Processes begun by another, from its main thread."""
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def test_a_plan_that_the_targets_size_contradicts_is_told_before_any_search(
    folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # threefold is the scale of the smaller carpets within a carpet
    for right, wrong in (
        ("size_mm = 9.0", "size_mm = 3.0"),
        ("size_mm = 9.0", "size_mm = 90"),
        ("um = 6.0", "um = 2.0"),
    ):
        text = (folder / "plan.toml").read_text()
        assert right in text
        other = tmp_path / "other.toml"
        other.write_text(text.replace(right, wrong))
        line = refusal(["fit", str(folder), "--plan", str(other), "--name", "other"], capfd)
        assert "pixels; it spans 38, as it would at" in line
        assert not (folder / "results").exists()


def test_a_surround_that_the_photographs_contradict_is_named(
    folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    plan = Plan.load(folder / "plan.toml").replace(target={"surround": "white"})
    (tmp_path / "other.toml").write_text(plan.to_toml())
    line = refusal(["fit", str(folder), "--plan", str(tmp_path / "other.toml")], capfd)
    assert "the target's surround is black in it" in line
    assert 'the plan has target.surround = "white": write "black"' in line
    # where the corners are given it need not be found
    session, corners = Session.open(folder), [[40, 40], [40, 80], [80, 80], [80, 40]]
    for surround, named in (("black", 0), ("white", 1)):
        given = plan.replace(target={"surround": surround, "corners_px": corners})
        _, findings = observe(session, given, open_target(given.target))
        codes = [finding.code for finding in findings]
        assert codes.count("surround-contradicted") == named
