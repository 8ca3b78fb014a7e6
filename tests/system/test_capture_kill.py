"""Captures killed by SIGKILL at random moments: nothing committed is ever lost, and the rest is still taken."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import missing
from labkit.devices.registry import open_devices
from labkit.photographs.decoding import read_photograph
from labkit.session.session import Session, begin
from labkit.session.verify import remarks, verify

from .conftest import small_bench

KILLS = 30

CLEAN = multiprocessing.get_context("forkserver")
"""Children of a server that has no threads, LibRaw's least of all: what a fork of this process had would hang or warn."""

CLEAN.set_forkserver_preload([__name__])


def run(plan_file: Path, folder: Path, check: bool = True) -> None:
    context = small_bench(plan_file)
    with (
        begin(plan_file, folder, resume=True) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        run_plan(session, devices, check=check)


def journal_bytes(folder: Path) -> int:
    try:
        return (folder / "journal.jsonl").stat().st_size
    except FileNotFoundError:
        return 0


def run_and_kill(
    plan_file: Path, folder: Path, rng: np.random.Generator, preflights: float = 0.2
) -> bool:
    """Start a capture, and kill it once the journal has grown by some bytes and a little time has gone by.

    preflights: the share of captures that begin with one; it takes longer than many frames.

    Whether it was killed before it was done. Counting the journal's bytes makes progress certain on any machine; the
    time on top of it, about that of one frame, puts the moment anywhere between two lines.
    """
    grown = journal_bytes(folder) + rng.integers(0, 1800)
    check = bool(rng.random() < preflights)
    process = CLEAN.Process(target=run, args=(plan_file, folder, check))
    process.start()
    while process.is_alive() and journal_bytes(folder) < grown:
        time.sleep(0.0005)
    process.join(rng.uniform(0, 0.02))
    process.kill()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL)
    return process.exitcode != 0


@pytest.mark.timeout(900)  # thirty processes, on a machine that may be busy
def test_thirty_kills_lose_no_committed_frame_and_resume_finishes(
    plan_file: Path, tmp_path: Path
) -> None:
    text = plan_file.read_text().replace("darks = 3", "darks = 30")
    for key in ("frames_per_range", "flats_per_range"):
        text = text.replace(f"{key} = 2", f"{key} = 30")
    plan_file.write_text(text)
    folder, rng, committed = tmp_path / "s", np.random.default_rng(1), dict[str, bytes]()
    killed = 0
    while killed < KILLS:
        killed += run_and_kill(plan_file, folder, rng)
        if not folder.exists():
            continue
        session = Session.open(folder)
        assert missing(session), (
            f"the capture was complete after {killed} kills: it is too fast for this test"
        )
        now = {frame.file: frame.path.read_bytes() for frame in session.frames}
        assert committed.items() <= now.items()
        committed = now
        with Session.append(folder) as mended:
            assert verify(mended) == []
    run(plan_file, folder)
    session = Session.open(folder)
    assert missing(session) == ()
    assert verify(session) == []
    assert {path.name for path in folder.iterdir()} == {
        "frames",
        "journal.jsonl",
        "plan.toml",
        "preflight",
    }
    assert (
        committed.items()
        <= {frame.file: frame.path.read_bytes() for frame in session.frames}.items()
    )


def test_a_killed_and_resumed_capture_ends_as_an_undisturbed_one(
    plan_file: Path, tmp_path: Path
) -> None:
    """Without preflights: those visit stops, and the bench's rail scatters anew at every visit, as any rail does."""
    rng = np.random.default_rng(2)
    for _ in range(4):
        run_and_kill(plan_file, tmp_path / "killed", rng, preflights=0)
    for name in ("killed", "whole"):
        run(plan_file, tmp_path / name, check=False)
    for frame in Session.open(tmp_path / "whole").frames:
        pair = [tmp_path / name / "frames" / frame.file for name in ("killed", "whole")]
        one, other = (
            read_photograph(path, Session.open(tmp_path / "whole").plan.sensor).counts
            for path in pair
        )
        np.testing.assert_array_equal(one, other)


def run_until_folder_is_removed(plan_file: Path, folder: Path, frames: int) -> None:
    """Capture, and die with that many photographs committed, as the folder that the camera wrote to is removed."""

    def remove(path: Path, ignore_errors: bool) -> None:
        if len(Session.open(folder).frames) == frames:
            for left in path.iterdir():
                left.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        shutil_rmtree(path, ignore_errors=ignore_errors)

    shutil_rmtree, shutil.rmtree = shutil.rmtree, remove  # type: ignore[assignment]
    run(plan_file, folder)


@pytest.mark.parametrize(
    "frames", [4, 11], ids=["between two photographs", "after the last"]
)
def test_a_kill_as_the_cameras_folder_is_removed_leaves_nothing_for_good(
    frames: int, plan_file: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    args = (plan_file, folder, frames)
    process = CLEAN.Process(target=run_until_folder_is_removed, args=args)
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert (folder / ".exposing").is_dir()
    assert [
        ".exposing: left by a capture" in remark for remark in remarks(Session.open(folder))
    ] == [True]
    with Session.append(folder) as session:
        assert len(session.frames) == frames
    assert {path.name for path in folder.iterdir()} == {
        "frames",
        "journal.jsonl",
        "plan.toml",
        "preflight",
    }
