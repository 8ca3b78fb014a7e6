"""Fits on a full disk and in folders that cannot be written to: one line, whole files, and a job that goes on."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labkit.cli import run
from labkit.results import Results

pytestmark = pytest.mark.slow

DISK_KB = 8192

PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1
"""Of prctl(2) and capabilities(7): without it root is refused what the mode of a file refuses."""


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 8 MiB of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_KB}k", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
    )
    if mounted.returncode:
        pytest.skip(f"this machine lets no test mount a disk: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True, timeout=60)


@pytest.fixture
def session(captured: Path, tmp_path: Path) -> Path:
    """A copy, without results."""
    shutil.copytree(captured, tmp_path / "night-1")
    return tmp_path / "night-1"


def filled(disk: Path, free_kb: int) -> Path:
    """Fill a disk but for some kilobytes; return the file that does so."""
    path = disk / "filler"
    path.write_bytes(bytes(shutil.disk_usage(disk).free - 1024 * free_kb))
    return path


@pytest.mark.parametrize("free_kb", [0, 40])
def test_a_full_disk_gives_one_line_and_with_room_the_job_goes_on(
    small_disk: Path, captured: Path, capsys: pytest.CaptureFixture[str], free_kb: int
) -> None:
    session = small_disk / "night-1"
    shutil.copytree(captured, session)
    filler = filled(small_disk, free_kb)
    assert run(["reprocess", str(session), "--workers", "1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"labkit: cannot write {session}")
    assert "No space left on device" in line
    assert run(["verify", str(session)]) == 0
    assert not (session / "results/latest/results.json").exists()
    assert not list(session.rglob("*.part"))

    filler.unlink()
    assert run(["reprocess", str(session), "--workers", "1"]) == 0
    assert len(Results.load(session)) == 2
    assert not (session / "results/latest/.fits").exists()


def test_a_full_disk_leaves_earlier_results_whole(
    small_disk: Path, captured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = small_disk / "night-1"
    shutil.copytree(captured, session)
    assert run(["fit", str(session), "--workers", "1"]) == 0
    before = Results.load(session).as_json()
    filled(small_disk, 40)
    capsys.readouterr()
    assert run(["fit", str(session), "--workers", "1"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert Results.load(session).as_json() == before


def bound_by_modes() -> None:
    """Let root be refused too what the mode of a file refuses."""
    if os.geteuid() == 0:
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, 0, 0, 0)


def labkit(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command as a user without special rights."""
    words = [sys.executable, "-c", "from labkit.cli import main; main()", *arguments]
    return subprocess.run(
        words, capture_output=True, text=True, timeout=120, preexec_fn=bound_by_modes
    )


@pytest.fixture
def closed(session: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """A session with a folder that cannot be written to."""
    folder = session / request.param
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o555)
    yield session
    folder.chmod(0o755)


@pytest.mark.parametrize("closed", [".", "results", "results/latest"], indirect=True)
def test_a_folder_without_permission_to_write_gives_one_line(closed: Path) -> None:
    answer = labkit("fit", str(closed), "--workers", "1")
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"labkit: cannot write {closed}")
    assert "Permission denied; work in a folder that you may write to" in line
    assert answer.returncode == 2
    assert not (closed / "results/latest/results.json").exists()


@pytest.mark.parametrize("closed", ["results/latest"], indirect=True)
def test_a_session_without_permission_is_a_row_of_the_job(closed: Path) -> None:
    answer = labkit("reprocess", str(closed), "--workers", "1")
    assert "failed" in answer.stdout
    assert "Permission denied" in answer.stdout
    (line,) = answer.stderr.splitlines()
    assert "1 of 1 sessions are not done" in line


def test_a_catalogue_without_permission_is_done_without(session: Path) -> None:
    session.parent.chmod(0o555)
    answer = labkit("list", str(session.parent))
    session.parent.chmod(0o755)
    assert answer.returncode == 0
    assert "night-1" in answer.stdout
    assert answer.stderr == ""
