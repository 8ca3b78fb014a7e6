"""Run tasks here or in processes of this machine; the callers do not know which.

Each process watches its parent and ends with it, even if the parent is killed. If a process
is killed, usually for lack of memory, the tasks under way at that moment run again, one at
a time.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor
from concurrent.futures import wait as first_done
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from functools import lru_cache, partial
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import mkdtemp
from typing import Protocol, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from labkit.errors import LostTasksError
from labkit.files import writing
from labkit.sharing import Shared, Stored, Value, digest_of, looked_up_by

Task = TypeVar("Task")
Result = TypeVar("Result")

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's mallopt, malloc.h."""

KEPT_BYTES = 1 << 30
"""Arrays up to this size are kept; larger ones go back to the system."""

KILLED = "the process at work on it was killed, by the system for lack of memory as a rule"
NO_MEMORY = "there is not enough memory"

SHARED_KEPT = 8
"""Shared values that a process keeps: targets, and the photographs that it is at work on."""

HEARD_EVERY_S = 0.5
"""How often it is looked what processes say that they do."""

_say: ContextVar[Callable[[str], None] | None] = ContextVar("say", default=None)


def say(step: str) -> None:
    """Report the current step of this task to `heard` of `Workers`; elsewhere do nothing."""
    if (heard := _say.get()) is not None:
        heard(step)


INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Run(Protocol):
    """Maps a function over tasks, as `Workers` does."""

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Yield (index, result) as tasks finish.

        Raises LostTasksError at the end if some tasks never finished.
        """
        ...


def default_workers() -> int:
    """Return the number of processors that this process may use."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


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


def run_all(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[tuple[int, Result]]:
    """Map a function over tasks; yields (index, result) as they finish. As `Workers`, for once."""
    with Workers(workers if len(tasks) > 1 else min(workers, 1)) as run:
        yield from run(function, tasks)


class Workers:
    """Processes that run one list of tasks after another; a single worker is this process itself.

    As a context it is a function, `Run`, of a function and tasks. Tasks travel by pickle to
    several workers. The first exception, an interrupt included, ends all other tasks at
    once and is raised. A task whose process is killed, or that lacks memory, runs again
    alone; if it fails again, LostTasksError names it after all other tasks are done.

    heard: called with each text that a task passes to `say`. Raises ValueError for less
    than one worker.
    """

    def __init__(self, count: int, heard: Callable[[str], None] | None = None) -> None:
        if count < 1:
            raise ValueError(f"workers must be at least 1, not {count}")
        self._count = count
        self._heard = heard
        self._others = set(multiprocessing.active_children())
        self._pool: ProcessPoolExecutor | None = None
        self._folder: Path | None = None
        self._shared: dict[str, object] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None:
            self._end()
        self._close_pool()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def share(self, value: Value) -> Shared[Value]:
        """Return a handle for tasks to a value, which each process reads once."""
        digest = digest_of(value)
        if digest not in self._shared:
            self._shared[digest] = value
            if self._count > 1:
                path = _of_digest(self._tasks_folder(), digest)
                with writing(path):
                    path.write_bytes(pickle.dumps(value))
        return Stored(digest)

    def warm_up(self, module: str) -> None:
        """Start the processes and import a module in each, which takes a second, while no task waits."""
        if self._count > 1:
            with _interrupt_held(), _main_hidden():
                for _ in range(self._count):
                    self._processes().submit(_import, module)

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Run tasks as `Run` states.

        Raises InputError besides if the folder for temporary files cannot be written to.
        """
        lost: dict[int, str] = {}
        if self._count == 1:
            yield from _here(function, tasks, lost, self._heard, self._shared.__getitem__)
        else:
            try:
                yield from self._spread(function, tasks, lost)
            except BaseException:
                self._end()
                raise
        if lost:
            raise LostTasksError([(tasks[index], why) for index, why in lost.items()])

    def _spread(
        self,
        function: Callable[[Task], Result],
        tasks: Sequence[Task],
        lost: dict[int, str],
    ) -> Iterator[tuple[int, Result]]:
        """Run all tasks at once; repeat tasks lost with a process, or for lack of memory, one at a time."""
        left = self._stored(tasks)
        suspects: list[int] = []
        while left:
            now = {suspects[0]: left[suspects.pop(0)]} if suspects else dict(left)
            failed: dict[int, str] = {}
            for index, result in self._round(function, now, failed):
                del left[index]
                yield index, result
            if len(now) == 1:
                lost |= failed
                left = {index: path for index, path in left.items() if index not in failed}
            else:
                suspects += failed

    def _round(
        self,
        function: Callable[[Task], Result],
        stored: Mapping[int, Path],
        failed: dict[int, str],
    ) -> Iterator[tuple[int, Result]]:
        """Run some tasks, all at once, and add to `failed` each that lacked memory or may have killed a process."""
        futures = self._submitted(function, stored)
        for future in self._as_completed(futures, stored):
            index = futures[future]
            try:
                result = future.result()
            except MemoryError:
                failed[index] = NO_MEMORY
            except BrokenProcessPool:
                if _begun(stored[index]).exists():
                    failed[index] = KILLED
            else:
                yield index, result
        if any(isinstance(future.exception(), BrokenProcessPool) for future in futures):
            self._close_pool()
            if not failed:  # killed before it had begun anything
                failed |= dict.fromkeys(
                    (i for f, i in futures.items() if f.exception() is not None), KILLED
                )
        for index in failed:
            _begun(stored[index]).unlink(missing_ok=True)

    def _as_completed(
        self, futures: Mapping[Future[Result], int], stored: Mapping[int, Path]
    ) -> Iterator[Future[Result]]:
        """Yield futures as they end; pass on meanwhile what their processes say."""
        left = set(futures)
        said = dict[int, str]()
        heard = self._heard
        while left:
            done, left = first_done(
                left, None if heard is None else HEARD_EVERY_S, FIRST_COMPLETED
            )
            yield from done
            if heard is None:
                continue
            for index in (futures[future] for future in left):
                with suppress(FileNotFoundError):
                    step = _said(stored[index]).read_text(encoding="utf-8")
                    if step and step != said.get(index):
                        said[index] = step
                        heard(step)

    def _stored(self, tasks: Sequence[Task]) -> dict[int, Path]:
        """Write each task to a file and return the paths.

        Python before 3.11.5 hung when workers ended while a long message was on its way.
        """
        stored = {index: self._tasks_folder() / str(index) for index in range(len(tasks))}
        for path, task in zip(stored.values(), tasks, strict=True):
            with writing(path):
                path.write_bytes(pickle.dumps(task))
            _begun(path).unlink(missing_ok=True)
            _said(path).unlink(missing_ok=True)
        return stored

    def _submitted(
        self, function: Callable[[Task], Result], stored: Mapping[int, Path]
    ) -> dict[Future[Result], int]:
        of_main = getattr(function, "__module__", None) == "__main__"
        with _interrupt_held(), nullcontext() if of_main else _main_hidden():
            try:
                return {
                    self._processes().submit(_run_stored, function, path): index
                    for index, path in stored.items()
                }
            except BrokenProcessPool:  # killed before there was anything to do
                self._close_pool()
                return {
                    self._processes().submit(_run_stored, function, path): index
                    for index, path in stored.items()
                }

    def _processes(self) -> ProcessPoolExecutor:
        """Return the processes, started if necessary."""
        if self._pool is None:
            # forked processes inherit the locks of OpenMP and cv2 in whatever state they are; fresh ones do not
            context = multiprocessing.get_context("spawn")
            _begin_tracker()
            self._pool = ProcessPoolExecutor(
                self._count,
                mp_context=context,
                initializer=partial(_begin, self._tasks_folder()),
            )
        return self._pool

    def _tasks_folder(self) -> Path:
        """Return the folder of stored tasks."""
        if self._folder is None:
            self._folder = Path(mkdtemp(prefix="labkit-"))
        return self._folder

    def _close_pool(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _end(self) -> None:
        for worker in set(multiprocessing.active_children()) - self._others:
            worker.terminate()


def _here(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    lost: dict[int, str],
    heard: Callable[[str], None] | None,
    lookup: Callable[[str], object],
) -> Iterator[tuple[int, Result]]:
    for index, task in enumerate(tasks):
        try:
            with _saying(heard), looked_up_by(lookup):
                result = function(task)
        except MemoryError:
            lost[index] = NO_MEMORY
        else:
            yield index, result


def _begin(folder: Path) -> None:
    """Set up a worker."""
    threading.Thread(target=_end_with_parent, args=(folder,), daemon=True).start()
    pin_threads()


def _import(module: str) -> None:
    import_module(module)


def _end_with_parent(folder: Path) -> None:
    """Wait for the parent process to end, clear up after it, and end this process at once."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _begun(stored: Path) -> Path:
    """Return the path of a file that exists once work on a task has begun."""
    return stored.with_name(f"{stored.name}.begun")


def _said(stored: Path) -> Path:
    """Return the path of the file with the current step of a task."""
    return stored.with_name(f"{stored.name}.said")


def _run_stored(function: Callable[[Task], Result], stored: Path) -> Result:
    _begun(stored).touch()

    def heard(step: str) -> None:
        with suppress(OSError):  # on a full disk it is unheard
            _said(stored).write_text(step, encoding="utf-8")

    with (
        _saying(heard),
        looked_up_by(lambda digest: _read(_of_digest(stored.parent, digest))),
    ):
        return function(pickle.loads(stored.read_bytes()))


def _of_digest(folder: Path, digest: str) -> Path:
    """Return the path of a shared value."""
    return folder / f"shared-{digest}"


@lru_cache(maxsize=SHARED_KEPT)
def _read(path: Path) -> object:
    """Return a shared value, which each process reads once."""
    value: object = pickle.loads(path.read_bytes())
    return value


@contextmanager
def _saying(heard: Callable[[str], None] | None) -> Iterator[None]:
    """Send what this process says to `heard` until the end of the block."""
    token = _say.set(heard)
    try:
        yield
    finally:
        _say.reset(token)


def _begin_tracker() -> None:
    """Start Python's resource tracker so that it works unseen.

    A closed terminal does not end the tracker, and its messages go nowhere.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})  # it inherits both
    before = os.environ.get("PYTHONWARNINGS")
    silent = "ignore:resource_tracker"
    os.environ["PYTHONWARNINGS"] = f"{before},{silent}" if before else silent
    try:
        resource_tracker.ensure_running()
    finally:
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Keep processes that start in this block from running the user's script again.

    Python would run the script in each of them, unless its work stands behind `if __name__
    == "__main__"`; the processes need nothing of it.
    """
    main = vars(sys.modules["__main__"])
    kept: dict[str, object] = {
        name: main[name] for name in ("__file__", "__spec__") if name in main
    }
    main.update(dict.fromkeys(kept))
    try:
        yield
    finally:
        main.update(kept)


@contextmanager
def _interrupt_held() -> Iterator[None]:
    """Hold Ctrl-C, SIGTERM and SIGHUP until the end of the block.

    Processes that start meanwhile ignore Ctrl-C: their parent ends them.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # processes inherit it
    in_main = threading.current_thread() is threading.main_thread()
    held: list[int] = []  # by way of another thread, whose mask is its own
    handlers = {}
    if in_main:
        # those that are ignored, as under nohup, or end the process, as everywhere but on the command line, stay so
        handlers = {
            number: kept
            for number in INTERRUPTS
            if callable(kept := signal.getsignal(number))
        }
        for number in handlers:
            signal.signal(number, lambda caught, _: held.append(caught))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if held:
            signal.raise_signal(held[0])
