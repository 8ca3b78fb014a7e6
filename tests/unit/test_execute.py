"""Work here and in processes."""

import os
import signal
import tempfile
import threading
import time
from math import factorial
from multiprocessing import active_children
from pathlib import Path

import pytest

from labkit.execute import run_all


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_comes_back_with_its_index(workers: int) -> None:
    assert sorted(run_all(factorial, [5, 6, 7], workers)) == [(0, 120), (1, 720), (2, 5040)]


@pytest.mark.parametrize("workers", [1, 2])
def test_the_exception_of_a_task_is_raised(workers: int) -> None:
    with pytest.raises(ValueError, match="factorial"):
        list(run_all(factorial, [5, -1, 7], workers))


def test_one_worker_goes_in_order() -> None:
    assert [index for index, _ in run_all(factorial, [3, 1, 2], 1)] == [0, 1, 2]


def test_less_than_one_worker_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        list(run_all(factorial, [1], 0))


def test_an_exception_ends_tasks_that_would_go_on_for_an_hour() -> None:
    with pytest.raises(ValueError, match="non-negative"):
        list(run_all(time.sleep, [-1, 3600, 3600, 3600], 2))
    assert active_children() == []


@pytest.mark.parametrize("delay_s", [0.02, 1.0])
def test_an_interrupt_ends_all_workers_and_leaves_no_files(
    delay_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    # at once: while the workers are being started; later: while they work
    threading.Timer(delay_s, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        list(run_all(time.sleep, [3600] * 4, 2))
    assert active_children() == []
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_who_asks_for_no_more_ends_the_rest() -> None:
    results = run_all(time.sleep, [0, 3600, 3600], 2)
    assert next(results) == (0, None)
    results.close()  # type: ignore[attr-defined]
    assert active_children() == []


def test_large_tasks_and_results_travel() -> None:
    assert sorted(run_all(bytes.upper, [b"a" * 3_000_000, b"b" * 3_000_000], 2)) == [
        (0, b"A" * 3_000_000),
        (1, b"B" * 3_000_000),
    ]
