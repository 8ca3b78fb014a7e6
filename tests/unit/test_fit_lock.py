"""Two fits of one name at once: the second is refused, and is told by whom."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from labkit.errors import InputError, SessionError
from labkit.session.fit_lock import fitted_alone
from labkit.storage.files import replacing


def hold(folder: Path, held: Connection) -> None:
    """In a process of its own: fit until killed."""
    with fitted_alone(folder):
        held.send(os.getpid())
        signal.pause()


@pytest.fixture
def other(tmp_path: Path) -> multiprocessing.process.BaseProcess:
    """Another process that fits into `latest`."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(
        target=hold, args=(tmp_path / "results" / "latest", there), daemon=True
    )
    process.start()
    assert here.poll(100)
    return process


def test_the_second_is_told_the_process_and_since_when(
    tmp_path: Path, other: multiprocessing.process.BaseProcess
) -> None:
    words = (
        rf"latest is being fitted by process {other.pid} since \d\d:\d\d:\d\d \S+: "
        "wait for it, or give another name"
    )
    with (
        pytest.raises(SessionError, match=words),
        fitted_alone(tmp_path / "results/latest"),
    ):
        pass
    with fitted_alone(tmp_path / "results" / "other"):
        pass
    other.kill()
    other.join(100)
    with fitted_alone(tmp_path / "results" / "latest"):  # the lock went with the process
        pass


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        (errno.EACCES, "Permission denied; work in a folder that you may write to"),
        (errno.EROFS, "Read-only file system; that is a read-only disk"),
    ],
)
def test_a_disk_that_cannot_be_written_to_is_named_with_what_to_do(
    reason: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr("labkit.session.fit_lock.os.open", refuse)
    with (
        pytest.raises(
            InputError, match=f"cannot write {tmp_path / '.latest.fitting'}: {words}"
        ),
        fitted_alone(tmp_path / "latest"),
    ):
        pass


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    with fitted_alone(tmp_path / "results" / "latest"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / ".latest.fitting").symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match="cannot write"), fitted_alone(tmp_path / "latest"):
        pass
    assert (tmp_path / "mine").read_text() == "mine"


def write_until_killed(path: Path, begun: Connection) -> None:
    with replacing(path) as file:
        file.write(b"half")
        begun.send(None)
        signal.pause()


def test_what_a_killed_fit_left_half_written_goes_at_the_next_and_nothing_else(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "results" / "latest"
    (folder / "kept").mkdir(parents=True)
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    for name in ("results.json", "kept/0123abcd"):
        process = context.Process(target=write_until_killed, args=(folder / name, there))
        process.start()
        assert here.poll(100)
        here.recv()
        process.kill()
        process.join(100)
    (folder / f".live.{os.getppid()}.part").write_bytes(b"another process writes it")
    (folder / ".my notes.part").write_bytes(b"a user's")
    (folder / ".a.4294967.part").mkdir()
    (folder / ".b.4294967.part").symlink_to(folder / ".my notes.part")
    left = {
        path.name
        for path in folder.rglob("*")
        if "results" in path.name or "0123" in path.name
    }
    assert len(left) == 2
    with fitted_alone(tmp_path / "results" / "other"):
        names = {path.name for path in folder.rglob("*")}
    assert names == {
        "kept",
        f".live.{os.getppid()}.part",
        ".my notes.part",
        ".a.4294967.part",
        ".b.4294967.part",
    }
