"""Captures killed by SIGKILL at random moments: nothing committed is ever lost, and the rest is still taken."""

from __future__ import annotations

import multiprocessing
import time
from pathlib import Path

import numpy as np
import pytest

from labkit.capture.capture import capture
from labkit.capture.sequence import missing
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.raw.decode import read_raw
from labkit.session.session import Session, begin, verify

from .conftest import ContextMaker

KILLS = 30


def run(plan_file: Path, folder: Path, context: DeviceContext) -> None:
    with begin(plan_file, folder, resume=True) as session, open_devices(session.plan, context=context) as devices:
        capture(session, devices)


def journal_bytes(folder: Path) -> int:
    try:
        return (folder / "journal.jsonl").stat().st_size
    except FileNotFoundError:
        return 0


def run_and_kill(plan_file: Path, folder: Path, context: DeviceContext, rng: np.random.Generator) -> bool:
    """Start a capture, and kill it once the journal has grown by some bytes and a little time has gone by.

    Whether it was killed before it was done. Counting the journal's bytes makes progress certain on any machine; the
    time on top of it, about that of one frame, puts the moment anywhere between two lines.
    """
    grown = journal_bytes(folder) + rng.integers(0, 1800)
    process = multiprocessing.get_context("fork").Process(target=run, args=(plan_file, folder, context))
    process.start()
    while process.is_alive() and journal_bytes(folder) < grown:
        pass
    until = time.perf_counter() + rng.uniform(0, 0.02)
    while process.is_alive() and time.perf_counter() < until:
        pass
    process.kill()
    process.join()
    return process.exitcode != 0


# from Python 3.12 on a fork beside other threads is warned of; the child here starts none of its own but scipy's
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_thirty_kills_lose_no_committed_frame_and_resume_finishes(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    text = plan_file.read_text().replace("darks = 3", "darks = 30")
    for key in ("frames_per_range", "flats_per_range"):
        text = text.replace(f"{key} = 2", f"{key} = 60")
    plan_file.write_text(text)
    folder, rng, committed = tmp_path / "s", np.random.default_rng(1), dict[str, bytes]()
    killed = 0
    while killed < KILLS:
        killed += run_and_kill(plan_file, folder, make_context(plan_file), rng)
        if not folder.exists():
            continue
        session = Session.open(folder)
        assert missing(session), f"the capture was complete after {killed} kills: it is too fast for this test"
        now = {frame.file: frame.path.read_bytes() for frame in session.frames}
        assert committed.items() <= now.items()
        committed = now
        with Session.append(folder) as mended:
            assert verify(mended) == []
    run(plan_file, folder, make_context(plan_file))
    session = Session.open(folder)
    assert missing(session) == ()
    assert verify(session) == []
    assert {path.name for path in folder.iterdir()} == {"frames", "journal.jsonl", "plan.toml"}
    assert committed.items() <= {frame.file: frame.path.read_bytes() for frame in session.frames}.items()


def test_a_killed_and_resumed_capture_ends_as_an_undisturbed_one(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    rng = np.random.default_rng(2)
    for _ in range(4):
        run_and_kill(plan_file, tmp_path / "killed", make_context(plan_file), rng)
    for name in ("killed", "whole"):
        run(plan_file, tmp_path / name, make_context(plan_file))
    for frame in Session.open(tmp_path / "whole").frames:
        pair = [tmp_path / name / "frames" / frame.file for name in ("killed", "whole")]
        one, other = (read_raw(path, Session.open(tmp_path / "whole").plan.sensor).counts for path in pair)
        np.testing.assert_array_equal(one, other)
