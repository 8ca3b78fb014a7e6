"""Run tasks in this process, in processes of this machine, or by any executor; the callers do not know which."""

from __future__ import annotations

import ctypes
import io
import os
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any, Protocol, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from labkit.errors import FitError, LostTasksError, WorkersError, out_of_memory
from labkit.jobs.processes import KILLED, Processes, saying
from labkit.jobs.sharing import kept, pack, unpacked
from labkit.numerics import refuse_other_versions, versions

Task = TypeVar("Task")
Result = TypeVar("Result")

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt, malloc.h."""

KEPT_BYTES = 1 << 30
"""Arrays up to this size are kept; larger ones go back to the system."""

NO_MEMORY = "there is not enough memory; close other programs and fit again"

LOOK_EVERY_S = 0.5
"""How often workers are looked after while tasks are under way."""

CHUNKS_EACH, MOST_IN_CHUNK = 16, 8
"""Chunks for each worker, if there are so many tasks; tasks in a chunk at most."""


class Run(Protocol):
    """Maps a function over tasks, as `Workers` and `Executed` do."""

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Yield (index, result) as tasks finish.

        The first exception of a task, an interrupt included, ends all other tasks at once
        and is raised, with three exceptions. A task that raises FitError is lost. A task
        that lacks memory, or whose process is killed, runs again alone after the others,
        and is lost if it fails again. Raises LostTasksError at the end if tasks were lost.
        """
        ...


@dataclass(frozen=True)
class Lost:
    """A task without a result. again: whether it may succeed alone."""

    why: str
    again: bool


def default_workers() -> int:
    """Return the number of processors that this process may use."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


def run_all(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[int, Result]]:
    """Map a function over tasks; yields (index, result) as they finish. As `Workers`, for once."""
    with Workers(workers if len(tasks) > 1 else min(workers, 1)) as run:
        yield from run(function, tasks)


def in_order(results: Iterable[tuple[int, Result]]) -> Iterator[tuple[int, Result]]:
    """Yield (index, result) by rising index from 0; results that come early wait."""
    early = dict[int, Result]()
    index = 0
    for at, result in results:
        early[at] = result
        while index in early:
            yield index, early.pop(index)
            index += 1


def map_in_order(
    run: Run, function: Callable[[Task], Result], tasks: Sequence[Task]
) -> Iterator[Result]:
    """Yield results in the order of the tasks, as `map` does."""
    return (result for _, result in in_order(run(function, tasks)))


class Workers:
    """A `Run` over processes of this machine, for one list of tasks after another; a single worker is this process itself.

    heard: called with each text that a task passes to `say`. Raises ValueError for less
    than one worker.
    """

    def __init__(self, count: int, heard: Callable[[str], None] | None = None) -> None:
        if count < 1:
            raise ValueError(f"workers must be at least 1, not {count}")
        self._count = count
        self._heard = heard
        self._processes = Processes(count) if count > 1 else None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._processes is not None:
            self._processes.shutdown(cancel_futures=True)

    def warm_up(self, module: str) -> None:
        """Start the processes and import a module in each, which takes a second, while no task waits."""
        if self._processes is not None:
            for _ in range(self._count):
                self._processes.submit(import_for_tasks, module)

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Map tasks, see `Run`."""
        if self._processes is None:
            return _here(function, tasks, self._heard)
        return Executed(self._processes, self._count, self._listen)(function, tasks)

    def _listen(self) -> None:
        """Pass on messages of tasks."""
        if self._processes is not None and self._heard is not None:
            for step in self._processes.said():
                self._heard(step)


class Executed:
    """A `Run` over an executor of `concurrent.futures`.

    Tasks travel by pickle in chunks, each beside the values that its tasks share; a worker
    keeps those values, so that caches serve later tasks too. Workers must have the same
    versions of labkit and its libraries as this process.

    Parameters
    ----------
    executor : runs the chunks; it stays open
    at_once : number of tasks that the executor runs at once, or a function that returns it
    watch : called twice a second while tasks are under way; it raises WorkersError if no task can end any more
    killed : exceptions that mean that the worker was killed

    >>> with ProcessPoolExecutor() as executor:
    ...     results = labkit.fit("night-3", run=labkit.Executed(executor))
    """

    def __init__(
        self,
        executor: Executor,
        at_once: int | Callable[[], int] | None = None,
        watch: Callable[[], None] | None = None,
        killed: tuple[type[Exception], ...] = (BrokenExecutor,),
    ) -> None:
        self._executor = executor
        self._at_once = at_once or default_workers()
        self._watch = watch
        self._killed = killed

    @property
    def at_once(self) -> int:
        """Number of tasks that run at once, now."""
        now = self._at_once
        return max(now() if callable(now) else now, 1)

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Map tasks, see `Run`."""
        lost: dict[int, str] = {}
        again = list[int]()
        size = min(max(len(tasks) // (CHUNKS_EACH * self.at_once), 1), MOST_IN_CHUNK)
        every = [range(len(tasks))[k : k + size] for k in range(0, len(tasks), size)]
        for index, outcome in self._outcomes(function, tasks, every):
            if not isinstance(outcome, Lost):
                yield index, outcome
            elif outcome.again:
                again.append(index)
            else:
                lost[index] = outcome.why
        for suspect in again:
            for index, outcome in self._outcomes(function, tasks, [[suspect]]):
                if isinstance(outcome, Lost):
                    lost[index] = outcome.why
                else:
                    yield index, outcome
        _raise_lost(tasks, lost)

    def _outcomes(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        chunks: Sequence[Sequence[int]],
    ) -> Iterator[tuple[int, Result | Lost]]:
        """Yield the outcome of each task, by index, as chunks end; a few chunks are with the executor at a time."""
        left = deque(chunks)
        under_way: dict[Future[list[Result | Lost]], Sequence[int]] = {}
        try:
            while left or under_way:
                while left and len(under_way) <= 2 * self.at_once:
                    chunk = left.popleft()
                    under_way[self._submitted(function, [tasks[k] for k in chunk])] = chunk
                done, _ = wait(under_way, LOOK_EVERY_S, FIRST_COMPLETED)
                if self._watch is not None:
                    self._watch()
                for future in done:
                    chunk = under_way.pop(future)
                    yield from zip(chunk, self._ended(future, len(chunk)), strict=True)
        finally:
            for future in under_way:
                future.cancel()

    def _submitted(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Future[list[Result | Lost]]:
        # versions can be read by a worker that can read nothing else
        parcel = pickle.dumps(versions()) + pickle.dumps(pack((function, tasks)))
        try:
            return self._executor.submit(_run_parcel, parcel)
        except self._killed as error:
            raise WorkersError(f"the executor takes no more tasks: {error}") from error
        except Exception:
            if self._watch is not None:
                self._watch()  # what is lost says so better than the executor does
            raise

    def _ended(
        self, future: Future[list[Result | Lost]], count: int
    ) -> list[Result | Lost]:
        """Return the outcomes of a chunk of so many tasks."""
        try:
            return future.result()
        except self._killed:
            return [Lost(KILLED, again=True)] * count
        except ImportError as error:
            raise WorkersError(
                f"a worker cannot read its task: {error}; install the same versions there as here"
            ) from error
        except CancelledError as error:
            raise WorkersError(
                "the executor dropped its tasks; fit again: that goes on where this one ended"
            ) from error


def _here(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    heard: Callable[[str], None] | None,
) -> Iterator[tuple[int, Result]]:
    """Map tasks in this process, one after the other, see `Run`."""
    lost: dict[int, str] = {}
    for index, task in enumerate(tasks):
        with saying(heard):
            outcome = _outcome(function, task)
        if isinstance(outcome, Lost):
            lost[index] = outcome.why
        else:
            yield index, outcome
    _raise_lost(tasks, lost)


def _outcome(function: Callable[[Task], Result], task: Task) -> Result | Lost:
    """Run a task."""
    try:
        return function(task)
    except FitError as error:
        return Lost(str(error), again=False)
    except Exception as error:
        if out_of_memory(error):
            return Lost(NO_MEMORY, again=True)
        raise


def _raise_lost(tasks: Sequence[Any], lost: Mapping[int, str]) -> None:
    """Raise LostTasksError for tasks that were lost, by index."""
    if lost:
        raise LostTasksError([(tasks[index], why) for index, why in sorted(lost.items())])


def _run_parcel(parcel: bytes) -> list[Any]:
    """Run a chunk of tasks in a worker, and return their outcomes."""
    file = io.BytesIO(parcel)
    refuse_other_versions(pickle.load(file))
    content, shared = pickle.load(file)
    function, tasks = unpacked(content, kept(shared))
    _pin_once(getattr(function, "__module__", "builtins"))
    return [_outcome(function, task) for task in tasks]


def import_for_tasks(module: str) -> None:
    """Import a module in a worker, and pin its threads."""
    import_module(module)
    _pin_once(module)


@lru_cache
def _pin_once(module: str) -> None:
    """Pin threads after the import of a module: its libraries have threads of their own."""
    pin_threads()


def pin_threads() -> None:
    """Limit linear algebra and OpenCV to one thread: processes share the work instead."""
    threadpool_limits(1)
    cv2.setNumThreads(1)
    _keep_freed_memory()


def _keep_freed_memory() -> None:
    """Make glibc keep freed arrays for reuse; do nothing with another C library.

    A model makes and frees arrays by the hundred; returning each to the system costs a fit
    15 % of its time.
    """
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
