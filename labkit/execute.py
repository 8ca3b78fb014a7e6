"""Where work runs: here, or in processes of this machine. Nothing else in labkit knows which."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
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
    """Map a function over tasks; yields (index, result) as they finish.

    function and tasks travel by pickle where there are several workers. The first exception ends the rest and is raised.
    Raises ValueError for less than one worker.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    if workers == 1 or len(tasks) < 2:
        for index, task in enumerate(tasks):
            yield index, function(task)
        return
    # forked processes inherit the locks of OpenMP and cv2 in whatever state they are; fresh ones do not
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(tasks)), mp_context=context, initializer=pin_threads) as pool:
        yield from run_on(pool, function, tasks)


def run_on(pool: Executor, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
    """The same on a pool that is there already."""
    futures: dict[Future[Result], int] = {pool.submit(function, task): index for index, task in enumerate(tasks)}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()
