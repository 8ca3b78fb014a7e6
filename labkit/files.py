"""Files that are whole or not there: written beside, synced, then renamed."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labkit.errors import InputError, SessionError


def write_atomically(path: Path, content: bytes) -> None:
    """Write `content` to `path`, replacing what is there; a crash leaves the old file or the new one.

    Raises InputError where the disk does not let us.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    with writing(path):
        try:
            with beside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
            sync_folder(path.parent)
        finally:
            beside.unlink(missing_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """What the system says against writing `path`, as an InputError that names it."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error


def copy_durably(source: Path, target: Path) -> str:
    """Copy a file, sync it, and return the SHA-256 of what was written, in hexadecimal.

    Raises InputError where the disk does not let us.
    """
    with source.open("rb") as reader, writing(target), target.open("wb") as writer:
        shutil.copyfileobj(reader, writer, 1 << 20)
        writer.flush()
        os.fsync(writer.fileno())
    return sha256_of(target)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable. Raises InputError where the disk does not let us."""
    with writing(folder):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def check_name(name: str) -> str:
    """`name` if it is safe as a file name anywhere. Raises SessionError otherwise."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}", name):
        raise SessionError(f"name {name!r}: allowed is letters, digits, '.', '_' and '-', 200 at most, no '.' first")
    return name
