"""Functions that read foreign files: whatever a file does to their process, this one goes on and says so in one line."""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.errors import InputError, RawError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import Exif
from labkit.photographs.photograph import Photograph
from labkit.plan import Sensor
from labkit.storage import apart
from labkit.storage.apart import LENGTH, run_apart
from labkit.storage.confinement import ASK_VERSION, CREATE_RULESET, FIRST_WITH_NETWORK
from labkit.types import Floats

FILE = Path(__file__)


def landlock() -> bool:
    """Return whether the kernel has Landlock with rules for networks."""
    if not sys.platform.startswith("linux"):
        return False
    asked = ctypes.CDLL(None).syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ASK_VERSION)
    return int(asked) >= FIRST_WITH_NETWORK


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


def writing(path: Path) -> int:
    return path.with_name("written by a decoder").write_bytes(b"x")


def removing(path: Path) -> int:
    path.unlink()
    return 0


def connecting(path: Path) -> int:
    socket.create_connection(("127.0.0.1", int(path.read_text())), 1).close()
    return 0


def sending(path: Path) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
        return datagrams.sendto(b"x", ("127.0.0.1", int(path.read_text())))


def starting(path: Path) -> int:
    return subprocess.run(["/bin/true"], check=True).returncode


@pytest.mark.skipif(not landlock(), reason="the kernel has no Landlock")
@pytest.mark.parametrize(
    "function", [writing, removing, connecting, sending, starting], ids=lambda f: f.__name__
)
def test_a_decoder_that_was_taken_over_reaches_neither_files_nor_network_nor_programs(
    function: Callable[[Path], int], tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        file = tmp_path / "picture"
        file.write_text(str(server.getsockname()[1]))
        with pytest.raises(OSError, match=r"denied|unreachable"):
            run_apart(function, file)
    assert [path.name for path in tmp_path.iterdir()] == ["picture"]


@pytest.mark.parametrize(
    "answer",
    [
        {},
        {"tree": 1},
        {"tree": 1, "arrays": [["0", "<f8", [-1, 2]]]},
        {"tree": 1, "arrays": [["0", "<f8", [2**40, 2**40]]]},
        {
            "tree": 1,
            "arrays": [["0", "<f8", [2**28]], ["1", "<f8", [2**28]], ["2", "<f8", [9]]],
        },
        {"tree": 1, "arrays": [["0", "<f8", ["a"]]]},
        {"tree": 1, "arrays": [["0", "|O8", [1]]]},
        {"tree": 1, "arrays": [["0"]]},
        {"tree": 1, "arrays": 5},
        {"failed": "OSError", "arrays": []},
        {"failed": "OSError", "text": "x", "errno": "y", "arrays": []},
        {"failed": {}, "text": ["\x1b" * 10**4], "arrays": []},
        {"tree": [[1]], "arrays": []},
    ],
    ids=lambda answer: json.dumps(answer)[:40],
)
def test_an_answer_that_no_decoder_gives_is_a_damaged_file(
    answer: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    head = json.dumps(answer).encode()
    whole = LENGTH.pack(len(head)) + head
    code = f"import os; os.write(1, {whole!r}); input()"
    monkeypatch.setattr(apart, "WORKER_CODE", code.replace("{", "{{").replace("}", "}}"))
    apart._end()
    try:
        with pytest.raises(InputError) as caught:
            run_apart(made, FILE)
        assert len(str(caught.value)) < 50_000
    finally:
        apart._end()


GOOD = Photograph(
    np.zeros((4, 6), np.uint16), np.full((2, 2), 9.0), 4095.0, ("RG", "GB"), "Z 8", 0.1, 100
)


@pytest.mark.parametrize(
    "changed",
    [
        {"counts": np.zeros(24, np.uint16)},
        {"counts": np.zeros((4, 6), np.uint64)},
        {"black": np.zeros(4)},
        {"black": np.full((2, 2), np.nan)},
        {"white": np.inf},
        {"pattern": ("RG", "B")},
        {"pattern": ("R\x1b", "GB")},
        {"pattern": ()},
        {"camera": "\x1b[2J"},
        {"camera": "Z" * 201},
        {"exposure_s": -1.0},
        {"exposure_s": np.nan},
        {"iso": 0},
        {"origin_px": (2, 0)},
        {"origin_px": (-2, 0), "whole_px": (9, 9)},
        {"whole_px": (2, 2)},
    ],
    ids=str,
)
def test_a_photograph_that_cannot_be_is_none(changed: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"allowed|rows|cut|levels"):
        replace(GOOD, **changed)
    for names in ({"lens": "\u202egnp"}, {"f_number": np.inf}, {"size_px": (0, 9)}):
        with pytest.raises(ValueError, match="allowed"):
            Exif(**names)
