"""Values that many tasks share: each travels once, and is known by its content."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from labkit.jobs.execute import Workers
from labkit.jobs.sharing import Shared, pack, packed, share
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


@pytest.mark.parametrize("workers", [1, 2])
def test_tasks_get_what_was_shared(workers: int) -> None:
    with Workers(workers) as run:
        of = [share(LARGE), share(LARGE + 1)]
        tasks = [Task(scale, array) for scale in (1.0, 2.0) for array in of]
        results = dict(run(summed, tasks))
    assert [results[k] for k in range(4)] == [
        scale * (LARGE + one).sum() for scale in (1.0, 2.0) for one in (0, 1)
    ]


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_shared_after_tasks_were_done_is_known_too(workers: int) -> None:
    with Workers(workers) as run:
        assert dict(run(summed, [Task(1.0, share(np.ones(2)))] * 2)) == {0: 2.0, 1: 2.0}
        assert dict(run(summed, [Task(1.0, share(np.ones(3)))] * 2)) == {0: 3.0, 1: 3.0}


def test_a_process_reads_a_shared_value_once() -> None:
    with Workers(2) as run:
        array = share(LARGE)
        places = [place for _, place in run(where_it_is_in_memory, [Task(1.0, array)] * 8)]
    assert len(set(places)) == len({process for process, _ in places})


def test_tasks_that_share_are_small_and_their_value_travels_once() -> None:
    tasks = [Task(scale, share(LARGE)) for scale in (1.0, 2.0)]
    content, shared = pack(tasks)
    assert len(content) < 1000 < LARGE.nbytes
    assert [*shared] == [share(LARGE.copy()).digest]
    # equal values are one
    assert share(LARGE.copy()) == share(LARGE) != share(LARGE + 1)


def test_a_run_that_knows_nothing_of_sharing_carries_the_value() -> None:
    task = pickle.loads(pickle.dumps(Task(2.0, share(LARGE))))
    assert summed(task) == 2 * LARGE.sum()


def test_equal_values_are_packed_alike_whatever_they_have_in_common() -> None:
    row = np.arange(3.0)
    assert packed((row, row)) == packed((row, row.copy()))
    assert packed(np.arange(6.0)[::2]) == packed(np.array([0.0, 2.0, 4.0]))
    assert packed((row, row)) != packed((row, row + 1))
    (one, other) = pickle.loads(packed((row, row)))
    np.testing.assert_array_equal(one, other)
