"""The journal of a session: append-only, one JSON object a line, chained by checksums.

A line counts once it is whole and synced. A crash may tear the last line; any other damage
is an error. Lines of earlier versions have no `after` and are not chained, except the last
before a chained line.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NoReturn

from labkit.errors import InputError, SessionError
from labkit.storage.files import (
    open_standard_streams,
    refuse_links,
    write_atomically,
    writing,
)
from labkit.storage.reading import opened, opened_to_append, read_bytes

Event = dict[str, Any]

JOURNAL = "journal.jsonl"

RESERVED_FIELDS = ("event", "time", "after", "check")
"""Fields of every line, which no event may use for something else."""

MOST_JOURNAL_BYTES = 2**26
"""Of a journal: a photograph takes a thousand bytes, and more with many columns in its list."""

RESUME_ADVICE = "then go on with --resume"


@dataclass(frozen=True, slots=True)
class Line:
    """A whole line: its event, its own checksum, and the previous line's; "" for the first line, None if
    unchained.
    """

    event: Event
    check: str
    after: str | None


@dataclass(frozen=True, slots=True)
class Journal:
    """Content of a journal: events, bytes of a torn last line, checksum of the last whole line, number of
    unchained lines.
    """

    events: tuple[Event, ...]
    torn: bytes
    last_check: str
    unchained: int


def journal_in(folder: Path) -> Path:
    """Return the journal of a session's folder. Raise SessionError for a folder that is no session."""
    path = folder / JOURNAL
    refuse_links(path)
    if not os.path.lexists(path):
        within = next(
            (above for above in folder.absolute().parents if (above / JOURNAL).is_file()),
            None,
        )
        hint = (
            f"give {within}"
            if within
            else "give the folder that labkit import or labkit capture has made"
        )
        why = f"it has no {JOURNAL}" if folder.exists() else "it is not there"
        raise SessionError(f"{folder} is no session: {why}; {hint}")
    return path


def encode(event: Event, after: str | None) -> tuple[bytes, str]:
    """Return one journal line, and its "check": the start of the SHA-256 of the rest, "after" included."""
    chained = event if after is None else {**event, "after": after}
    check = hashlib.sha256(_dumps(chained)).hexdigest()[:16]
    return _dumps({**chained, "check": check}) + b"\n", check


def decode(line: bytes) -> Line | None:
    """Return a line, checked to the byte, from text without newline; None if damaged."""
    try:
        event = json.loads(line.decode(), parse_constant=_refuse)
        if not isinstance(event, dict) or not isinstance(event.get("event"), str):
            return None
        check = event.pop("check", None)
        after = event.pop("after", None)
        whole = check is not None and encode(event, after) == (line + b"\n", check)
    except (
        ValueError,
        RecursionError,
    ):  # no JSON, no UTF-8, no such character or number, or nested too deeply
        return None
    return Line(event, check, after) if whole else None


def read_journal(path: Path) -> Journal:
    """Read a journal, checking each line and the chain.

    Raises SessionError if the file cannot be read, a line other than the last is damaged,
    or lines are missing, doubled or out of order.
    """
    try:
        content = read_bytes(path, MOST_JOURNAL_BYTES)
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}") from error
    return _parse(content, path)


def _parse(content: bytes, path: Path) -> Journal:
    *written, rest = content.split(b"\n")
    lines = [decode(line) for line in written]
    torn = rest
    if not rest and lines and lines[-1] is None:
        lines.pop()
        torn = written[-1] + b"\n"
    whole: list[Line] = []
    for number, line in enumerate(lines, start=1):
        if line is None:
            raise SessionError(
                f"{path}: line {number} does not fit its checksum: it was altered or is damaged; "
                "put back a whole copy of the journal"
            )
        if not _follows(line, whole):
            raise SessionError(
                f"{path}: line {number} does not follow the one before: lines are missing, doubled or moved"
            )
        whole.append(line)
    events = tuple(line.event for line in whole)
    return Journal(
        events,
        torn,
        whole[-1].check if whole else "",
        sum(line.after is None for line in whole),
    )


def is_being_written(path: Path) -> bool:
    """Return whether some process has the journal open to append."""
    try:
        with opened(path, MOST_JOURNAL_BYTES) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks: nobody can write there
        return False
    return False


class JournalWriter:
    """The only writer of a journal; its lock ends with the process."""

    def __init__(self, path: Path) -> None:
        """Open `path`, made if absent, and read its content as `journal`.

        Raises SessionError if another process writes the journal or it is damaged,
        InputError if the file cannot be written.
        """
        open_standard_streams()
        self.path = path  # a session is made elsewhere and then renamed
        with writing(path):
            self._file = opened_to_append(path)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.journal = read_journal(path)
        except BlockingIOError:
            self._file.close()
            raise SessionError(
                f"session {path.parent} is being written by another process; wait for it"
            ) from None
        except OSError as error:
            self._file.close()
            raise InputError(
                f"cannot lock {path}: {error.strerror}; put the session on a disk of this machine"
            ) from error
        except BaseException:
            self._file.close()
            raise
        whole = os.fstat(self._file.fileno()).st_size - len(self.journal.torn)
        self._end = whole, self.journal.last_check

    def append(self, event: str, **fields: Any) -> Event:
        """Write one event with the present time; the event is on the disk at return.

        Raises InputError if the disk does not take the event, SessionError if the file was
        replaced, ValueError for a field with a reserved name.
        """
        if wrong := [name for name in fields if name in RESERVED_FIELDS]:
            raise ValueError(
                f"fields {', '.join(wrong)} of event {event!r}: the journal itself uses {', '.join(RESERVED_FIELDS)}"
            )
        self._refuse_strange_file()
        self._catch_up()
        size, last_check = self._end
        entry = {
            "event": event,
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            **fields,
        }
        line, check = encode(entry, last_check)
        with writing(self.path):
            written = self._file.write(line)
            if written != len(line):
                self.drop_last(written)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        self._end = size + len(line), check
        return entry

    def drop_last(self, count: int) -> None:
        """Cut `count` bytes off the end: a torn line."""
        self._file.truncate(os.fstat(self._file.fileno()).st_size - count)
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Give the lock back."""
        self._file.close()

    def _refuse_strange_file(self) -> None:
        """Raise SessionError if the journal was removed, replaced or shortened; save its content beside."""
        ours = os.fstat(self._file.fileno())
        whole = self._end[0]
        try:
            there = os.stat(self.path)
        except OSError:
            happened = "was removed"
        else:
            happened = (
                "" if os.path.samestat(ours, there) else "was replaced by another file"
            )
        if happened:
            saved = self.path.with_name(f"{self.path.name}.saved")
            write_atomically(saved, os.pread(self._file.fileno(), ours.st_size, 0))
            raise SessionError(
                f"{self.path} {happened} while it was being written: rename {saved} to that, {RESUME_ADVICE}"
            )
        if ours.st_size < whole:
            raise SessionError(
                f"{self.path} was cut from {whole} to {ours.st_size} bytes while it was being written: "
                f"put back a whole copy, {RESUME_ADVICE}"
            )

    def _catch_up(self) -> None:
        """Find the file's end again after an interrupted `append`: Ctrl-C, a full disk."""
        size = os.fstat(self._file.fileno()).st_size
        if size != self._end[0]:
            journal = _parse(os.pread(self._file.fileno(), size, 0), self.path)
            if journal.torn:
                self.drop_last(len(journal.torn))
            self._end = os.fstat(self._file.fileno()).st_size, journal.last_check


def _follows(line: Line, before: Sequence[Line]) -> bool:
    if line.after is None:  # as earlier labkits wrote them; never after one that is chained
        return not before or before[-1].after is None
    return line.after == (before[-1].check if before else "")


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")


def _dumps(event: Event) -> bytes:
    return json.dumps(event, sort_keys=True, ensure_ascii=False, allow_nan=False).encode()
