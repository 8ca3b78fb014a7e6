"""Processes of this machine as an executor.

Each process has one task at a time, so a process killed costs its task alone: the
others work on, and a new process takes its place. A process watches its parent and ends
with it, even if the parent is killed.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from queue import Empty, SimpleQueue
from typing import Any

KILLED = (
    "the process at work on it was killed, by the system for lack of memory as a rule; "
    "close other programs and fit again"
)

SAID, DONE, FAILED = range(3)
"""Kinds of message from a process."""

_say: ContextVar[Callable[[str], None] | None] = ContextVar("say", default=None)


def say(step: str) -> None:
    """Report the current step of this task to `heard` of `Workers`; elsewhere do nothing."""
    if (heard := _say.get()) is not None:
        heard(step)


@contextmanager
def saying(heard: Callable[[str], None] | None) -> Iterator[None]:
    """Send what this process says to `heard` until the end of the block."""
    token = _say.set(heard)
    try:
        yield
    finally:
        _say.reset(token)


class Processes(Executor):
    """An executor over processes of this machine, which start with their first task.

    Cancelling a task under way ends its process. The future of a task whose process was
    killed raises BrokenProcessPool.
    """

    def __init__(self, count: int) -> None:
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._said: SimpleQueue[str] = SimpleQueue()
        self._under_way: set[_Job] = set()
        self._threads = [
            threading.Thread(target=self._serve, name=f"labkit-process-{k}", daemon=True)
            for k in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return the future of a call in one of the processes."""
        job = _Job(pickle.dumps((fn, args, kwargs)))
        self._jobs.put(job)
        return job

    def said(self) -> Iterator[str]:
        """Yield messages of tasks since the last call."""
        with suppress(Empty):
            while True:
                yield self._said.get_nowait()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after their tasks. cancel_futures: at once, whatever they do."""
        if cancel_futures:
            with suppress(Empty):
                while True:
                    if (job := self._jobs.get_nowait()) is not None:
                        job.cancel()
            for job in list(self._under_way):
                job.cancel()
        for _ in self._threads:
            self._jobs.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def _serve(self) -> None:
        """Give tasks to one process, one after the other, until None comes in place of a task."""
        # this thread's processes inherit its mask: their parent ends them, not Ctrl-C
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process: _Process | None = None
        while (job := self._jobs.get()) is not None:
            if not job.set_running_or_notify_cancel():
                continue
            self._under_way.add(job)
            if process is not None and not process.serves(job):
                process.end()
                process = None
            if process is None:
                process = _Process(job.needs_main)
            process.answer(job, self._said)
            self._under_way.discard(job)
        if process is not None:
            process.end()


class _Job(Future[Any]):
    """The future of a task, and the message to a process."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.content = content
        self.needs_main = b"__main__" in content
        self._end_process: Callable[[], None] | None = None
        self._unwanted = False

    def cancel(self) -> bool:
        """Cancel the task; end its process if it is under way."""
        self._unwanted = True
        if super().cancel():
            return True
        if (end := self._end_process) is not None:
            end()
        return False

    @contextmanager
    def in_process(self, end: Callable[[], None]) -> Iterator[None]:
        """Let `cancel` end a process within a `with` block."""
        self._end_process = end
        if self._unwanted:
            end()
        try:
            yield
        finally:
            self._end_process = None


class _Process:
    """One process, and the pipe to it. with_main: whether it knows the user's script."""

    def __init__(self, with_main: bool) -> None:
        self._with_main = with_main
        # forked processes inherit the locks of OpenMP and cv2 in whatever state they are; fresh ones do not
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        with _start:
            _begin_tracker()
            if with_main:
                self._process.start()
            else:
                with _main_hidden():
                    self._process.start()
        theirs.close()

    def serves(self, job: _Job) -> bool:
        """Return whether the process lives and knows what a task needs."""
        return self._process.is_alive() and self._with_main >= job.needs_main

    def answer(self, job: _Job, said: SimpleQueue[str]) -> None:
        """Run a task and set its result."""
        try:
            with job.in_process(self._process.terminate):
                self._pipe.send_bytes(job.content)
                kind, value = self._pipe.recv()
                while kind == SAID:
                    said.put(value)
                    kind, value = self._pipe.recv()
        except (OSError, EOFError):
            self.end()
            kind, value = FAILED, BrokenProcessPool(KILLED)
        if kind == DONE:
            job.set_result(value)
        else:
            job.set_exception(value)

    def end(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()
        self._pipe.close()


def _work(pipe: Connection) -> None:
    """Run tasks from a pipe, in a process of their own."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with saying(lambda step: pipe.send((SAID, step))):
        while True:
            try:
                content = pipe.recv_bytes()
            except EOFError:
                return
            _reply(pipe, content)


def _reply(pipe: Connection, content: bytes) -> None:
    """Run a task and send its result, or the exception that it raised."""
    try:
        function, args, kwargs = pickle.loads(content)
        sent = pickle.dumps((DONE, function(*args, **kwargs)))
    except BaseException as error:
        error.add_note(traceback.format_exc())
        sent = _packed_error(error)
    pipe.send_bytes(sent)


def _packed_error(error: BaseException) -> bytes:
    """Return the message of an exception; the text of exceptions that cannot be pickled."""
    try:
        sent = pickle.dumps((FAILED, error))
        pickle.loads(sent)
    except Exception:
        return pickle.dumps((FAILED, RuntimeError(repr(error))))
    return sent


def _end_with_parent() -> None:
    """Wait for the parent process to end, and end this process at once."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


_start = threading.Lock()
"""Held while a process starts."""


def _begin_tracker() -> None:
    """Start Python's resource tracker detached from the terminal.

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
