"""Write files that are whole or absent: written beside, synced, then renamed."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from labkit.errors import InputError, SessionError
from labkit.storage.reading import MOST_NOTE_BYTES, opened_photograph, read_private

PART_NAME = re.compile(r"\..+\.([1-9]\d{0,9})\.part")
"""Names of files that are being written, with the number of the process that writes."""

MOST_LINKS = 10
"""Number of names in one message."""


def open_standard_streams() -> None:
    """Open descriptors 0 to 2 where they are closed.

    Otherwise the next opened file would get such a number, and printed text, or a crash's
    dump, would end up in the file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest that is free


def write_atomically(path: Path, content: bytes) -> None:
    """Write `content` to `path`, replacing what is there; a crash leaves the old file or the new one.

    Raises InputError if the file cannot be written.
    """
    with replacing(path) as file:
        file.write(content)


def write_private(path: Path, content: bytes) -> None:
    """Write a file that only this user may read, in a folder made if missing, as `write_atomically` does."""
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with replacing(path, 0o600) as file:
        file.write(content)


@contextmanager
def replacing(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `path` when the block ends without an exception.

    mode: who may read and write the file. Raises InputError if the file cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    with writing(path):
        beside.unlink(missing_ok=True)
        try:
            # never through a link
            with open(beside, "x+b", opener=partial(os.open, mode=mode)) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
            sync_folder(path.parent)
        finally:
            beside.unlink(missing_ok=True)


def remove_unfinished(folder: Path) -> None:
    """Remove what killed processes left of files that they wrote into a folder or the folders in it, by `replacing`."""
    for path in folder.rglob(".*.part"):
        found = PART_NAME.fullmatch(path.name)
        if found and not _lives(int(found[1])):
            with suppress(OSError):
                if stat.S_ISREG(path.lstat().st_mode):
                    path.unlink()


def _lives(process: int) -> bool:
    """Return whether a process of this number lives."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a system error in writing `path` into an InputError naming the path."""
    try:
        yield
    except OSError as error:
        advice = NOT_ALLOWED.get(error.errno or 0, "")
        raise InputError(f"cannot write {path}: {error.strerror}{advice}") from error


NOT_ALLOWED = {
    errno.EACCES: "; work in a folder that you may write to, or have its owner allow it",
    errno.EPERM: "; work in a folder that you may write to, or have its owner allow it",
    errno.EROFS: "; that is a read-only disk: copy the session to one that can be written to, or name a folder there",
}
"""What to do where writing is not allowed, by the system's number for why."""


def is_full(error: BaseException) -> bool:
    """Return whether an error, or its cause, is that of a full disk."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        cause = cause.__cause__
    return False


def links_in(folder: Path) -> list[Path]:
    """Return all symbolic links in a folder and in the folders in it."""
    return sorted(
        path
        for parent, folders, files in os.walk(folder)
        for name in (*folders, *files)
        if (path := Path(parent, name)).is_symlink()
    )


def link_problem(path: Path) -> str:
    """Describe a symbolic link in a session: no checksum covers the file behind the link."""
    return f"{path}: a link to {os.readlink(path)}; put the file or folder itself there, or remove it"


def refuse_links(*paths: Path) -> None:
    """Raise SessionError for symbolic links among some paths: through them files outside of a session are changed."""
    if links := [link_problem(path) for path in paths if path.is_symlink()]:
        more = len(links) - MOST_LINKS
        raise SessionError(
            "; ".join(
                [*links[:MOST_LINKS], *([f"and {more} more links"] if more > 0 else [])]
            )
        )


def drop_link(path: Path) -> None:
    """Remove a symbolic link, but not what it links to; anything else stays. Raises OSError."""
    if path.is_symlink():
        path.unlink()


def refuse_taken(path: Path) -> None:
    """Raise InputError if a file of this name exists."""
    if path.exists() or path.is_symlink():
        raise InputError(f"{path} is there already: give another name with --out")


def write_new(path: Path, text: str) -> None:
    """Write a new file. Raises InputError if the file exists or cannot be written."""
    with writing(path):
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            refuse_taken(path)
            raise


def copy_durably(source: Path, target: Path) -> str:
    """Copy a file, sync it, and return the SHA-256 of the written bytes, in hexadecimal.

    Raises InputError if the copy cannot be written.
    """
    with writing(target):
        target.unlink(missing_ok=True)  # a link is not followed
    reader = opened_photograph(source)
    with reader, writing(target), target.open("xb") as writer:
        shutil.copyfileobj(reader, writer, 1 << 20)
        writer.flush()
        os.fsync(writer.fileno())
    return sha256_of(target)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal."""
    with opened_photograph(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable. Raises InputError if the folder cannot be written."""
    with writing(folder):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def checksum_problem(path: Path, sha256: str) -> str | None:
    """Describe how a file contradicts its SHA-256; None if it does not."""
    if path.is_symlink():
        return link_problem(path)
    try:
        return (
            None
            if sha256_of(path) == sha256
            else f"{path}: does not fit its checksum: it was altered or is damaged"
        )
    except FileNotFoundError:
        return f"{path}: missing"
    except OSError as error:
        return f"{path}: cannot be read: {error.strerror}"


def write_folder(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files by name into a folder, which is made if missing, and return their paths. Raises InputError if it fails."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_atomically(folder / name, content)
    return [folder / name for name in files]


def is_name(name: Any) -> bool:
    """Return whether a value is a string that is safe as a file name on every system."""
    return (
        isinstance(name, str)
        and re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}", name) is not None
    )


def check_name(name: str) -> str:
    """Return `name` if it is safe as a file name on every system. Raises SessionError otherwise."""
    if not is_name(name):
        raise SessionError(
            f"name {name!r}: allowed is letters, digits, '.', '_' and '-', 200 at most, no '.' first"
        )
    return name


def state_folder() -> Path:
    """Return the folder for the user's state. Raises RuntimeError for a user without a home."""
    given = os.environ.get("XDG_STATE_HOME")
    return (Path(given) if given else Path.home() / ".local" / "state") / "labkit"


def kept_secret(file: Path) -> str:
    """Return the secret in a file that only the user may read.

    A new secret is made if there is none, or if others can read it. A secret that cannot be
    stored serves for this run only.
    """
    with suppress(OSError, UnicodeDecodeError):
        kept = read_private(file, MOST_NOTE_BYTES).strip()
        if re.fullmatch(r"[A-Za-z0-9_-]{22,64}", kept):
            return kept
    made = secrets.token_urlsafe(16)
    with suppress(InputError):
        write_private(file, made.encode())
    return made
