"""Open files to read: regular files up to a stated size, without waiting for a pipe and without acting on a device.

Whatever is read comes through here, for a file that a stranger put into a folder may have no
end, or no beginning. Where labkit itself wrote a file no link is followed; a file that the
user names may be a link.
"""

from __future__ import annotations

import errno
import io
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MOST_PHOTOGRAPH_BYTES = 2**30
"""Of a photograph or a target's picture: 178 million pixels of three colours, 16 bit each, not compressed."""

MOST_NOTE_BYTES = 2**16
"""Of small files of labkit's own, such as locks and secrets."""

WITHOUT_WAITING = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC


def opened(path: Path, most_bytes: int, *, follow_link: bool = False) -> io.BufferedReader:
    """Open a file to read.

    Parameters
    ----------
    path : the file
    most_bytes : largest size
    follow_link : whether the file may be a symbolic link, as a file that the user names may

    Raises
    ------
    OSError : the file cannot be opened, is larger, or is something else than a regular file
    """
    return open(path, "rb", opener=_opener(most_bytes, follow_link=follow_link))


def opened_photograph(path: Path) -> io.BufferedReader:
    """Open a photograph or a target's picture, see `opened`; it may be a link. Raises OSError."""
    return opened(path, MOST_PHOTOGRAPH_BYTES, follow_link=True)


def read_bytes(path: Path, most_bytes: int, *, follow_link: bool = False) -> bytes:
    """Return the content of a file, see `opened`. Raises OSError."""
    with opened(path, most_bytes, follow_link=follow_link) as file:
        return file.read(os.fstat(file.fileno()).st_size)


def read_text(path: Path, most_bytes: int, *, follow_link: bool = False) -> str:
    r"""Return the text of a file, see `opened`: without a byte order mark, lines ended by \n.

    Raises OSError, UnicodeDecodeError.
    """
    content = read_bytes(path, most_bytes, follow_link=follow_link)
    return io.StringIO(content.decode("utf-8-sig"), newline=None).read()


def read_private(path: Path, most_bytes: int) -> str:
    """Return the text of a file of this user's that nobody else may read or write. Raises OSError, UnicodeDecodeError."""
    with opened(path, most_bytes) as file:
        found = os.fstat(file.fileno())
        if found.st_uid != os.geteuid() or found.st_mode & 0o077:
            raise PermissionError(errno.EPERM, "others may read or write it", str(path))
        return file.read(found.st_size).decode()


def opened_to_append(path: Path) -> io.FileIO:
    """Open a file of labkit's own, made if missing, to read it and to append.

    Raises OSError as `opened` does, and for a file with a second name, whose content would change too.
    """
    return open(path, "a+b", buffering=0, opener=_opener(only_name=True))


def reason(error: Exception) -> str:
    """Return what an error says, of a system error without number and path."""
    return str(getattr(error, "strerror", None) or error)


def _opener(
    most_bytes: int | None = None, *, follow_link: bool = False, only_name: bool = False
) -> Callable[[str, int], int]:
    """Return a function that opens a file, for Python's `open`, and raises OSError for a file that may not be used."""

    def check(found: os.stat_result, name: str) -> None:
        if problem := _problem(found, name, most_bytes, only_name):
            raise OSError(*problem, name)

    def opener(name: str, flags: int) -> int:
        with suppress(FileNotFoundError):
            # before it is opened, for some devices act on that
            check(os.stat(name, follow_symlinks=follow_link), name)
        flags |= WITHOUT_WAITING | (0 if follow_link else os.O_NOFOLLOW)
        number = os.open(name, flags, 0o666)
        try:
            check(os.fstat(number), name)
        except OSError:
            os.close(number)
            raise
        return number

    return opener


def _problem(
    found: os.stat_result, name: str, most_bytes: int | None, only_name: bool
) -> tuple[int, str] | None:
    """Return why a file may not be used: the system's number for it, and words; None for one that may."""
    kind = found.st_mode
    if stat.S_ISLNK(kind):
        words = f"a link to {os.readlink(name)}; put the file itself there, or remove it"
        return errno.ELOOP, words
    if stat.S_ISDIR(kind):
        return errno.EISDIR, "a folder; a file is needed"
    if not stat.S_ISREG(kind):
        return errno.EINVAL, "a pipe or a device; a file is needed"
    if most_bytes is not None and found.st_size > most_bytes:
        words = f"{found.st_size} bytes long; a file of this kind has {most_bytes} at most"
        return errno.EFBIG, words
    if only_name and found.st_nlink > 1:
        words = "it has a second name (a hard link), whose content would change too; put a copy in its place"
        return errno.EMLINK, words
    return None
