"""Functions that read foreign files: whatever a file does to their process, this one goes on and says so in one line."""

from __future__ import annotations

import os
import select
import signal
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from labkit import apart
from labkit.apart import run_apart
from labkit.errors import InputError, RawError
from labkit.photographs.decoding import read_photograph
from labkit.plan import Sensor
from labkit.types import Floats

FILE = Path(__file__)


@dataclass(frozen=True)
class Made:
    process: int
    numbers: Floats
    empty: Floats


def made(path: Path, count: int = 3) -> Made:
    print("libraries print")
    os.write(1, b"what they like")
    return Made(os.getpid(), np.arange(float(count)).reshape(-1, 1), np.empty((0, 2)))


def spinning(path: Path) -> int:
    while True:
        pass


def eating(path: Path) -> int:
    return len(bytearray(1 << 36))


def crashing(path: Path) -> int:
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def refusing(path: Path) -> int:
    raise RawError("is no photograph")


def missing(path: Path) -> int:
    return len(Path("/nowhere").read_bytes())


def breaking(path: Path) -> int:
    raise NotImplementedError("filters: 148")


def lying(path: Path) -> int:
    return "text"  # type: ignore[return-value]


def test_what_a_function_makes_comes_back_from_one_other_process() -> None:
    first, second = run_apart(made, FILE), run_apart(made, FILE, count=10**6)
    assert first.process == second.process != os.getpid()
    np.testing.assert_array_equal(first.numbers, [[0.0], [1.0], [2.0]])
    assert first.empty.shape == (0, 2)
    assert second.numbers.shape == (10**6, 1)
    assert second.numbers[-1, 0] == 10**6 - 1


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (spinning, "is truncated or damaged: it takes too long to decode"),
        pytest.param(
            eating,
            "is truncated or damaged: it takes too much memory",
            marks=pytest.mark.skipif(
                sys.platform != "linux", reason="others do not limit memory"
            ),
        ),
        (crashing, "is truncated or damaged: its decoder ended with status -11"),
        (refusing, "is no photograph"),
        (breaking, "is truncated or damaged ('filters: 148')"),
        (lying, "is truncated or damaged"),
    ],
)
def test_a_fault_is_one_line_and_the_next_file_is_read(
    function: Callable[[Path], int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "SECONDS", 0)
    with pytest.raises(InputError) as caught:
        run_apart(function, FILE)
    assert str(caught.value).startswith(words)
    assert run_apart(made, FILE).numbers.size == 3


def test_a_process_without_files_ends_and_another_serves_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(apart, "IDLE_S", 0.05)
    first = run_apart(made, FILE).process
    for _ in range(200):
        if apart._process is None:
            break
        time.sleep(0.05)
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)
    assert run_apart(made, FILE).process != first


def test_errors_keep_their_kind() -> None:
    with pytest.raises(RawError):
        run_apart(refusing, FILE)
    with pytest.raises(OSError, match="No such file") as caught:
        run_apart(missing, FILE)
    assert caught.value.errno == 2


def test_an_interrupt_ends_the_process_whose_answer_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = run_apart(made, FILE).process

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(select, "select", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_apart(made, FILE)
    assert run_apart(made, FILE, count=5).numbers.size == 5
    with pytest.raises(ProcessLookupError):
        os.kill(before, 0)


def test_a_tiff_of_thousands_of_overlapping_directories_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "SECONDS", 1)
    entries, step, count = 1000, 14, 2800
    content = bytearray(12 * entries + step * (count + 2))
    content[:8] = struct.pack("<2sHI", b"II", 42, 8)
    for number in range(count):  # each directory's entries are the next ones' too
        at = 8 + step * number
        struct.pack_into("<H", content, at, entries)
        struct.pack_into("<I", content, at + 2 + 12 * entries, at + step)
    (tmp_path / "a.tif").write_bytes(content)
    with pytest.raises(RawError, match=r"a\.tif: .* takes too long to decode"):
        read_photograph(tmp_path / "a.tif", Sensor(pixel_pitch_um=5.0))


def size_of(path: Path) -> int:
    return path.stat().st_size


def test_relative_paths_start_from_the_folder_that_one_is_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process is older than a change of folder, as a notebook makes it."""
    for size in (1, 2):
        folder = tmp_path / str(size)
        folder.mkdir()
        (folder / "file").write_bytes(b"x" * size)
        monkeypatch.chdir(folder)
        assert run_apart(size_of, Path("file")) == size
