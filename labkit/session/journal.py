"""The journal of a session: append-only, one JSON object a line, each line with its own checksum.

A line counts once it is whole and synced. The last line may be torn by a crash; any other damage is an error.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labkit.errors import SessionError
from labkit.files import writing

Event = dict[str, Any]


def encode(event: Event) -> bytes:
    """One journal line: the event and, as "check", the start of the SHA-256 of the rest."""
    return _dumps({**event, "check": _check(event)}) + b"\n"


def decode(line: bytes) -> Event | None:
    """The event of a line without its newline, checked; None if the line is damaged."""
    try:
        event = json.loads(line)
    except ValueError:
        return None
    if not isinstance(event, dict):
        return None
    check = event.pop("check", None)
    return event if check == _check(event) and "event" in event else None


def read_journal(path: Path) -> tuple[list[Event], bytes]:
    """(events, torn): what a journal says, and the bytes of its torn last line, if any.

    Raises SessionError if the file cannot be read, or a line other than the last is damaged.
    """
    try:
        *lines, rest = path.read_bytes().split(b"\n")
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}") from error
    events = [decode(line) for line in lines]
    torn = rest
    if not rest and events and events[-1] is None:
        events.pop()
        torn = lines[-1] + b"\n"
    for number, event in enumerate(events, start=1):
        if event is None:
            raise SessionError(f"{path}: line {number} does not fit its checksum: it was altered or is damaged")
    return [event for event in events if event is not None], torn


class JournalWriter:
    """The one writer of a journal; the lock goes with the process, however it ends."""

    def __init__(self, path: Path) -> None:
        """Open `path`, made if absent. Raises SessionError if another writer has it, InputError if it cannot be written."""
        with writing(path):
            self._file = path.open("ab", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise SessionError(f"session {path.parent} is being written by another process; wait for it") from None

    def append(self, event: str, **fields: Any) -> Event:
        """Write one event with the time of now; it is on the disk when this returns. Raises InputError if it cannot be."""
        entry = {"event": event, "time": datetime.now(UTC).isoformat(timespec="milliseconds"), **fields}
        line = encode(entry)
        with writing(Path(self._file.name)):
            written = self._file.write(line)
            if written != len(line):
                self.drop_last(written)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        return entry

    def drop_last(self, count: int) -> None:
        """Cut `count` bytes off the end: a torn line."""
        self._file.truncate(os.fstat(self._file.fileno()).st_size - count)
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Give the lock back."""
        self._file.close()


def _check(event: Event) -> str:
    return hashlib.sha256(_dumps(event)).hexdigest()[:16]


def _dumps(event: Event) -> bytes:
    return json.dumps(event, sort_keys=True, ensure_ascii=False, allow_nan=False).encode()
