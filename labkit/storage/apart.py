"""Run functions that read foreign files in a separate process, with limits of time and memory, and without network.

Libraries that decode photographs follow whatever a damaged file states: for minutes,
through gigabytes, or into foreign memory. The process starts with the first file, serves
all later ones, and ends when there has been none for a while. A file that breaks a limit
ends the process, and a new process serves the next file. Results travel as values of the type that the function states (see
`labkit.storage.typed_file`), so even a process under an attacker's control cannot run code in this
one.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import re
import select
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import typing
from collections.abc import Callable
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from labkit.errors import InputError, RawError, shown
from labkit.storage import typed_file
from labkit.storage.confinement import confine
from labkit.storage.npz import Arrays
from labkit.types import JSON

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")
Bytes = NDArray[np.uint8]

SECONDS, BYTES_A_SECOND = 5, 4_000_000
"""Processor time allowed for a file: a constant, and a second per so many bytes. Raw files take a tenth of this."""

MEMORY_BYTES, MEMORY_A_BYTE = 2**31, 64
"""Memory allowed for a file: a constant, and so many bytes per byte. Decoding takes up to ten times the pixels."""

BACKSTOP_S = 1800
"""Longest wall time, for decoders that wait without using the processor."""

IDLE_S = 10.0
"""A process that has no file for so long is ended: its libraries take 60 MB, and fits go on for minutes without it."""

MOST_ANSWER_BYTES = 2**32
"""Of all arrays of an answer."""

MOST_TREE_BYTES = 2**24
"""Of the rest of an answer."""

MOST_PRINTED_BYTES = 2**20
"""Of files written while a file is decoded: what libraries print is collected."""

MOST_DESCRIPTORS = 128
MOST_TEXT = 10_000
"""Characters of an error."""

LENGTH = struct.Struct("<Q")
NUMBER_TYPES = re.compile(r"[<>|][biuf]\d")
"""Types of arrays: numbers only, no pointers."""

SHARED_ERRORS: dict[str, type[InputError]] = {
    one.__name__: one for one in (InputError, RawError)
}
DAMAGED = "is truncated or damaged"

WORKER_CODE = "import sys; sys.path[:] = {path!r}; from labkit.storage.apart import serve; serve({memory})"


def run_apart(
    function: Callable[Arguments, Value], *args: Arguments.args, **kwargs: Arguments.kwargs
) -> Value:
    """Return the value of a function of a file, its first argument, computed in the separate process.

    Raises InputError or RawError as the function does, InputError for a file that breaks a
    limit or the process, and OSError.
    """
    if _serving:  # it is that process itself
        return function(*args, **kwargs)
    path = args[0]
    assert isinstance(path, Path)
    with _lock:
        request = (function, args, kwargs, _allowed(path), _here())
        answer, arrays = _ask(pickle.dumps(request))
        _end_when_idle()
    if "failed" in answer:
        _raise(answer)
    try:
        kind = typing.get_type_hints(function)["return"]
        value: Value = typed_file.put_together(answer["tree"], kind, arrays)
    except (LookupError, TypeError, ValueError) as error:
        raise InputError(f"{DAMAGED} ({shown(str(error))})") from error
    return value


class _Process:
    """The process with limits, and this process's ends of its pipes."""

    def __init__(self) -> None:
        self._memory = _memory()
        begin = WORKER_CODE.format(path=sys.path, memory=self._memory.fileno())
        one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", begin],
            pass_fds=[self._memory.fileno()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **one_thread},
            bufsize=0,
        )
        self.of = os.getpid()

    def ask(self, request: bytes) -> tuple[dict[str, Any], Arrays]:
        """Send a request and return the answer. Raises EOFError where the process ended, TimeoutError."""
        deadline = time.monotonic() + BACKSTOP_S
        assert self._process.stdin is not None
        try:
            for part in (LENGTH.pack(len(request)), request):
                _write(self._process.stdin, part)
        except BrokenPipeError:
            raise EOFError from None
        (length,) = LENGTH.unpack(self._received(LENGTH.size, deadline).data)
        if length > MOST_TREE_BYTES:
            raise EOFError
        try:
            answer, arrays = self._checked(
                json.loads(bytes(self._received(length, deadline)))
            )
        except (LookupError, TypeError, ValueError, RecursionError):
            raise EOFError from None  # whoever took the process over answers so
        os.ftruncate(
            self._memory.fileno(), 0
        )  # a frame would stay in memory until the next
        return answer, arrays

    def _checked(self, answer: dict[str, Any]) -> tuple[dict[str, Any], Arrays]:
        """Return an answer and its arrays.

        Raises EOFError, LookupError, TypeError, ValueError for an answer that `_answer` does not give.
        """
        arrays: Arrays = {}
        at = 0
        for name, dtype, shape in answer.pop("arrays"):
            if not NUMBER_TYPES.fullmatch(dtype):
                raise EOFError
            if not all(type(side) is int and side >= 0 for side in shape):
                raise EOFError
            size = np.dtype(dtype).itemsize * prod(shape)
            if at + size > MOST_ANSWER_BYTES:
                raise EOFError
            arrays[str(name)] = self._read(size, at).view(dtype).reshape(shape)
            at += size
        if "failed" in answer:
            answer["text"] = str(answer["text"])[:MOST_TEXT]
            answer["errno"] = int(answer.get("errno", 0))
        elif "tree" not in answer:
            raise EOFError
        return answer, arrays

    def end(self) -> int:
        """End the process and return its exit status."""
        self._process.kill()
        status = self._process.wait()
        for file in (self._process.stdin, self._process.stdout, self._memory):
            assert file is not None
            with suppress(OSError):
                file.close()
        return status

    def ended(self) -> int:
        """Return the exit status of a process whose pipe has ended."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        return self.end()

    def _received(self, size: int, deadline: float) -> Bytes:
        """Return so many bytes of the answer."""
        assert self._process.stdout is not None
        buffer = np.empty(size, np.uint8)
        view = buffer.data
        while len(view):
            left_s = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._process.stdout], [], [], left_s)[0]:
                raise TimeoutError
            count = os.readv(self._process.stdout.fileno(), [view])
            if not count:
                raise EOFError
            view = view[count:]
        return buffer

    def _read(self, size: int, at: int) -> Bytes:
        """Return so many bytes of the shared file."""
        buffer = np.empty(size, np.uint8)
        view = buffer.data
        while len(view):
            count = os.preadv(self._memory.fileno(), [view], at)
            if not count:
                raise EOFError
            view = view[count:]
            at = at + count
        return buffer


_lock = threading.Lock()
_process: _Process | None = None
_timer: threading.Timer | None = None
_serving = False


def _ask(request: bytes) -> tuple[dict[str, Any], Arrays]:
    """Return the answer of the process, which is started if none runs.

    Raises InputError if the process ended.
    """
    global _process
    if _process is None or _process.of != os.getpid():
        _process = _Process()
    asked, _process = (
        _process,
        None,
    )  # an interrupt leaves half an answer: it is not used again
    try:
        answer = asked.ask(request)
    except EOFError:
        status = asked.ended()
        if status == -signal.SIGXCPU:
            raise InputError(f"{DAMAGED}: it takes too long to decode") from None
        raise InputError(f"{DAMAGED}: its decoder ended with status {status}") from None
    except TimeoutError:
        asked.end()
        raise InputError(f"{DAMAGED}: not decoded in {BACKSTOP_S} s") from None
    except BaseException:
        asked.end()
        raise
    _process = asked
    return answer


def _raise(answer: dict[str, Any]) -> NoReturn:
    """Raise the error that an answer reports."""
    name = str(answer["failed"])
    text = answer["text"]
    if name == OSError.__name__:
        raise OSError(answer["errno"], text)
    raise SHARED_ERRORS.get(name, InputError)(text)


def _end_when_idle() -> None:
    """End the process in IDLE_S, unless it is asked before."""
    global _timer
    if _timer is not None:
        _timer.cancel()
    _timer = threading.Timer(IDLE_S, _end_idle)
    _timer.daemon = True
    _timer.start()


def _end_idle() -> None:
    with _lock:
        # a request may have begun while this waited: its own timer follows
        if threading.current_thread() is _timer:
            _end()


@atexit.register
def _end() -> None:
    global _process
    if _process is not None and _process.of == os.getpid():
        _process.end()
    _process = None


def _memory() -> Any:
    """Return a file without a name for the arrays of answers: pixels through a pipe would take as long as to decode them."""
    if hasattr(os, "memfd_create"):  # TMPDIR may be full
        return open(os.memfd_create("labkit"), "w+b", buffering=0)
    return tempfile.TemporaryFile(buffering=0)


def _write(file: Any, content: bytes | memoryview) -> None:
    view = memoryview(content)
    while len(view):
        view = view[file.write(view) :]


def serve(memory: int) -> None:
    """Answer requests on standard input until its end. Discard what libraries print.

    memory: descriptor of the file for arrays
    """
    global _serving
    _serving = True
    _limit_for_good()
    confine()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asks ends this process
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)
    while len(head := requests.read(LENGTH.size)) == LENGTH.size:
        (length,) = LENGTH.unpack(head)
        _write(answers, _answer(requests.read(length), memory))


def _answer(request: bytes, memory: int) -> bytes:
    """Serve a request within limits and return the answer; its arrays go into the file for arrays."""
    arrays: Arrays = {}
    answer: dict[str, JSON]
    try:
        function, args, kwargs, allowed, here = pickle.loads(request)
        _limit(*allowed)
        if here is not None:
            os.chdir(here)
        value = function(*args, **kwargs)
        kind = typing.get_type_hints(function)["return"]
        answer = {"tree": typed_file.taken_apart(value, kind, arrays)}
    except InputError as error:
        answer = {"failed": type(error).__name__, "text": str(error)}
    except OSError as error:
        text = str(error.strerror or error)
        answer = {"failed": OSError.__name__, "errno": error.errno or 0, "text": text}
    except MemoryError:
        answer = {"failed": "InputError", "text": f"{DAMAGED}: it takes too much memory"}
    except Exception as error:  # of whatever a damaged file breaks
        answer = {"failed": "InputError", "text": f"{DAMAGED} ({shown(str(error))})"}
    _unlimit()
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    answer["arrays"] = [[name, a.dtype.str, list(a.shape)] for name, a in whole.items()]
    at = 0
    for array in whole.values():
        view = array.reshape(-1).view(np.uint8).data
        while len(view):
            count = os.pwrite(memory, view, at)
            view = view[count:]
            at = at + count
    head = json.dumps(answer).encode()
    return LENGTH.pack(len(head)) + head


def _here() -> Path | None:
    """Return the current folder, which relative paths start from; None if the folder was removed."""
    try:
        return Path.cwd()
    except OSError:
        return None


def _allowed(path: Path) -> tuple[float, int]:
    """Return the processor time, s, and the memory, bytes, that a file may take."""
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        size = 0
    return SECONDS + size / BYTES_A_SECOND, MEMORY_BYTES + MEMORY_A_BYTE * size


def _limit_for_good() -> None:
    """Limit what no file needs: open descriptors, and dumps of memory."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        if most == resource.RLIM_INFINITY or most > MOST_DESCRIPTORS:
            resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_DESCRIPTORS,) * 2)


def _limit(seconds: float, memory_bytes: int) -> None:
    """Limit the processor time and the memory of this process from now on.

    On a system without such limits only the clock limits the process.
    """
    with suppress(ImportError, OSError, ValueError):
        import resource

        used = resource.getrusage(resource.RUSAGE_SELF)
        until = int(used.ru_utime + used.ru_stime + seconds) + 1
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (until, most))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        taken = pages * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + memory_bytes, most))
        _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_PRINTED_BYTES, most))


def _unlimit() -> None:
    """Let the answer be sent, whatever the file took."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        for what in (resource.RLIMIT_CPU, resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
            _, most = resource.getrlimit(what)
            resource.setrlimit(what, (most, most))
