"""Values that many tasks share: each travels once, and is known by its content."""

from __future__ import annotations

import os
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.analysis.kept_fits import KeptFits
from labkit.errors import InputError
from labkit.execute import Workers
from labkit.sharing import Carried, Shared, Stored, digest_of, looked_up_by, packed, share
from labkit.types import Floats

LARGE = np.arange(300_000.0)


@dataclass(frozen=True)
class Task:
    """Scale a shared array."""

    scale: float
    array: Shared[Floats]


def summed(task: Task) -> float:
    return task.scale * float(task.array.value.sum())


def where_it_is_in_memory(task: Task) -> tuple[int, int]:
    """Process, and address of the value there."""
    return os.getpid(), id(task.array.value)


def plain(
    function: Callable[[Any], Any], tasks: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    """A caller's own run, that shares nothing."""
    yield from ((index, function(task)) for index, task in enumerate(tasks))


@pytest.mark.parametrize("workers", [1, 2])
def test_tasks_get_what_was_shared(workers: int) -> None:
    with Workers(workers) as run:
        of = [run.share(LARGE), run.share(LARGE + 1)]
        tasks = [Task(scale, array) for scale in (1.0, 2.0) for array in of]
        results = dict(run(summed, tasks))
    assert [results[k] for k in range(4)] == [
        scale * (LARGE + one).sum() for scale in (1.0, 2.0) for one in (0, 1)
    ]


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_shared_after_tasks_were_done_is_known_too(workers: int) -> None:
    with Workers(workers) as run:
        assert dict(run(summed, [Task(1.0, run.share(np.ones(2)))] * 2)) == {0: 2.0, 1: 2.0}
        assert dict(run(summed, [Task(1.0, run.share(np.ones(3)))] * 2)) == {0: 3.0, 1: 3.0}


def test_a_process_reads_a_shared_value_once() -> None:
    with Workers(2) as run:
        array = run.share(LARGE)
        places = [place for _, place in run(where_it_is_in_memory, [Task(1.0, array)] * 8)]
    assert len(set(places)) == len({process for process, _ in places})


def test_a_task_that_shares_is_small() -> None:
    with Workers(2) as run:
        task = Task(1.0, run.share(LARGE))
        assert len(pickle.dumps(task)) < 1000 < LARGE.nbytes
        # equal values are one
        assert run.share(LARGE.copy()) == task.array
        assert run.share(LARGE + 1) != task.array


def test_shared_files_end_with_the_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Workers(2) as run:
        run.share(LARGE)
        assert len(list(tmp_path.rglob("shared-*"))) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_full_folder_for_temporary_files_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(path: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Workers(2) as run:
        monkeypatch.setattr(Path, "write_bytes", full)
        with pytest.raises(InputError, match="No space left on device"):
            run.share(LARGE)


def test_for_a_run_that_does_not_share_each_task_carries_the_value() -> None:
    handle = share(plain, LARGE)
    assert handle == Carried(LARGE)
    assert dict(plain(summed, [Task(2.0, handle)])) == {0: 2 * LARGE.sum()}


@pytest.mark.parametrize("workers", [1, 2])
def test_kept_fits_share_as_the_run_that_makes_them(workers: int, tmp_path: Path) -> None:
    with Workers(workers) as run:
        assert isinstance(KeptFits(run, tmp_path).share(LARGE), Stored)
        assert KeptFits(run, tmp_path).share(LARGE) == run.share(LARGE)
    assert isinstance(KeptFits(plain, tmp_path).share(LARGE), Carried)


def test_outside_of_a_task_nothing_is_looked_up() -> None:
    handle = Stored[Floats](digest_of(LARGE))
    with pytest.raises(
        LookupError,
        match=f"shared value {handle.digest[:8]} was asked for outside of a task",
    ):
        _ = handle.value
    with looked_up_by({handle.digest: LARGE}.__getitem__):
        assert handle.value is LARGE
    with pytest.raises(LookupError):
        _ = handle.value


def test_equal_values_are_packed_alike_whatever_they_have_in_common() -> None:
    row = np.arange(3.0)
    assert packed((row, row)) == packed((row, row.copy()))
    assert packed(np.arange(6.0)[::2]) == packed(np.array([0.0, 2.0, 4.0]))
    assert packed((row, row)) != packed((row, row + 1))
    (one, other) = pickle.loads(packed((row, row)))
    np.testing.assert_array_equal(one, other)
