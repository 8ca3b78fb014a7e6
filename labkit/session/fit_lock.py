"""Lock a folder of results against a second fit; the second user learns which process is at work."""

from __future__ import annotations

import fcntl
import io
import json
import operator
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from labkit.errors import SessionError
from labkit.storage.files import remove_unfinished, writing
from labkit.storage.reading import MOST_NOTE_BYTES, opened_to_append, read_text


@contextmanager
def fitted_alone(results: Path) -> Iterator[None]:
    """Lock a folder of results until the end of the block, or of the process.

    Raises
    ------
    SessionError
        another process fits into this folder
    InputError
        the folder cannot be written to
    """
    path = results.with_name(f".{results.name}.fitting")
    with writing(results):
        results.parent.mkdir(parents=True, exist_ok=True)
    with writing(path):
        file = _locked(path)
    if file is None:
        raise SessionError(
            f"{results} is being fitted by {_holder(path)}: wait for it, or give another name (--name)"
        )
    try:
        with suppress(OSError):  # a full disk: the lock holds without a name in it
            file.truncate(0)
            file.write(json.dumps(_ourselves()).encode())
        remove_unfinished(results.parent)
        yield
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
            results.parent.rmdir()  # where nothing was written
        file.close()


def _locked(path: Path) -> io.FileIO | None:
    """Return a file locked by this process; None if another process has the lock."""
    while True:
        file = opened_to_append(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            return None
        except OSError:  # a file system without locks
            return file
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        file.close()  # the fit before has ended meanwhile, and removed it


def _ourselves() -> dict[str, object]:
    """Return a description of this process for others."""
    return {
        "process": os.getpid(),
        "machine": socket.gethostname(),
        "since": datetime.now().astimezone().strftime("%H:%M:%S %Z"),
    }


def _holder(path: Path) -> str:
    """Say which process has locked a file, and since when."""
    try:
        told = json.loads(read_text(path, MOST_NOTE_BYTES))
        process = operator.index(told["process"])
        machine = str(told["machine"])
        since = str(told["since"])
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RecursionError,
    ):  # it has begun this moment
        return "another process"
    where = "" if machine == socket.gethostname() else f" on {machine}"
    return f"process {process}{where} since {since}"
