"""Where work runs: here, or in processes of this machine. Nothing else in labkit knows which."""

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
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
    """Map a function over tasks; yields (index, result) as they finish.

    function and tasks travel by pickle where there are several workers. The first exception, an interrupt too, ends the
    rest at once and is raised. Raises ValueError for less than one worker.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers}")
    if workers == 1 or len(tasks) < 2:
        for index, task in enumerate(tasks):
            yield index, function(task)
        return
    # forked processes inherit the locks of OpenMP and cv2 in whatever state they are; fresh ones do not
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with (
        TemporaryDirectory(prefix="labkit-") as folder,
        ProcessPoolExecutor(min(workers, len(tasks)), mp_context=context, initializer=pin_threads) as pool,
    ):
        try:
            with _interrupt_held():
                futures = {}
                for index, task in enumerate(tasks):
                    stored = Path(folder) / str(index)
                    stored.write_bytes(pickle.dumps(task))
                    futures[pool.submit(_run_stored, function, stored)] = index
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise


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
