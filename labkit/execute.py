"""Where work runs: here, or in processes of this machine. Nothing else in labkit knows which."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

Task = TypeVar("Task")
Result = TypeVar("Result")


def default_workers() -> int:
    """As many as this process may use processors."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pin_threads() -> None:
    """One thread for linear algebra and OpenCV: the work is spread over processes instead."""
    threadpool_limits(1)
    cv2.setNumThreads(1)


def run_all(function: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> Iterator[tuple[int, Result]]:
    """Map a function over tasks; yields (index, result) as they finish. As `Workers`, for once."""
    with Workers(workers if len(tasks) > 1 else min(workers, 1)) as run:
        yield from run(function, tasks)


class Workers:
    """Processes that work through one list of tasks after another, or this process itself where one is asked for.

    As a context it is a function: of a function and tasks, which travel by pickle where there are several workers. It yields
    (index, result) as they finish. The first exception, an interrupt too, ends the rest at once and is raised. Raises
    ValueError for less than one worker.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise ValueError(f"workers must be at least 1, not {count}")
        self._count = count
        self._others = set(multiprocessing.active_children())
        self._open = ExitStack()
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None:
            self._end()
        self._open.close()

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
        if self._count == 1:
            for index, task in enumerate(tasks):
                yield index, function(task)
            return
        try:
            futures = self._submitted(function, tasks)
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            self._end()
            raise

    def _submitted(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> dict[Future[Result], int]:
        with _interrupt_held():
            if self._pool is None:
                # forked processes inherit the locks of OpenMP and cv2 in whatever state they are; fresh ones do not
                context = multiprocessing.get_context("spawn")
                pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=pin_threads)
                self._folder = self._open.enter_context(TemporaryDirectory(prefix="labkit-"))
                self._pool = self._open.enter_context(pool)
            futures = {}
            for index, task in enumerate(tasks):
                stored = Path(self._folder) / str(index)
                stored.write_bytes(pickle.dumps(task))
                futures[self._pool.submit(_run_stored, function, stored)] = index
            return futures

    def _end(self) -> None:
        for worker in set(multiprocessing.active_children()) - self._others:
            worker.terminate()


def _run_stored(function: Callable[[Task], Result], stored: Path) -> Result:
    """Tasks go by way of files: until 3.11.5 Python hung where workers ended while a long message was on its way."""
    return function(pickle.loads(stored.read_bytes()))


@contextmanager
def _interrupt_held() -> Iterator[None]:
    """Hold Ctrl-C until the end. Processes that are begun meanwhile never see one: whoever began them ends them."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # processes inherit it
    in_main = threading.current_thread() is threading.main_thread()
    held: list[object] = []  # by way of another thread, whose mask is its own
    handler = signal.signal(signal.SIGINT, lambda *caught: held.append(caught)) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if held:
            signal.raise_signal(signal.SIGINT)
