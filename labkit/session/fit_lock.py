"""Lock a folder of results against a second fit; the second user learns which process is at work."""

from __future__ import annotations

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from labkit.errors import SessionError
from labkit.files import remove_unfinished, writing


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
        file = _locked(path)
    if file is None:
        raise SessionError(
            f"{results} is being fitted by {_holder(path)}: wait for it, or give another name (--name)"
        )
    try:
        with suppress(OSError):  # a full disk: the lock holds without a name in it
            os.ftruncate(file, 0)
            os.write(file, json.dumps(_ourselves()).encode())
        remove_unfinished(results.parent)
        yield
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
            results.parent.rmdir()  # where nothing was written
        os.close(file)


def _locked(path: Path) -> int | None:
    """Return a file locked by this process; None if another process has the lock."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            return None
        except OSError:  # a file system without locks
            return file
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        os.close(file)  # the fit before has ended meanwhile, and removed it


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
        told = json.loads(path.read_text(encoding="utf-8"))
        process = told["process"]
        machine = told["machine"]
        since = told["since"]
    except (OSError, ValueError, KeyError, TypeError):  # it has begun this moment
        return "another process"
    where = "" if machine == socket.gethostname() else f" on {machine}"
    return f"process {process}{where} since {since}"
