"""The error tree.

LabkitError                 something failed: one line, exit status 1
├── InputError              an input cannot be used: one line, exit status 2
│   ├── PlanError           the plan is wrong
│   ├── SessionError        the session folder, its journal or its lock
│   ├── RawError            a file that is no usable photograph
│   ├── TargetError         a target that cannot be made or is not in the frame
│   └── DataError           frames that do not suffice for the request
│       └── NewerError      results that a newer labkit made
├── FitError                an estimate that failed
├── LostTasksError          tasks that failed, were killed, or lacked memory
├── WorkersError            the workers, or their scheduler, are gone or of no use
└── DeviceError             a device did not obey
    ├── DeviceTimeoutError
    ├── CameraError
    ├── RailError
    │   └── RailLimitError
    └── DisplayError
"""

from __future__ import annotations

import errno
from collections.abc import Sequence
from typing import Any

LONGEST_VALUE = 60
"""Characters of a value that a message repeats."""


REFUSALS_OF_MEMORY = (
    "can't start new thread",
    "cannot allocate memory",
    "failed to map segment",
    "insufficient memory",
)
"""In the words of Python, of the C library's calls, of its loader of libraries, and of OpenCV."""


class LabkitError(Exception):
    """Base of every error that labkit raises on purpose.

    Messages are printable: control characters in texts of files and devices are replaced.

    >>> try:
    ...     results = labkit.fit("night-3")
    ... except labkit.LabkitError as error:
    ...     print(error)
    """

    exit_status = 1

    def __str__(self) -> str:
        return printable(super().__str__())


class InputError(LabkitError):
    """An unusable input."""

    exit_status = 2


class PlanError(InputError):
    """The plan is wrong; the message states field, value and what is allowed."""


class SessionError(InputError):
    """The session folder, its journal or its lock is damaged or in the wrong state."""


class RawError(InputError):
    """A file is no usable photograph."""


class TargetError(InputError):
    """A target cannot be made, or is not found in the frame.

    likely_px: corners (4, 2), [row, column], of the likeliest places in the frame, for a picture of what was looked at.
    """

    def __init__(self, message: str, likely_px: Sequence[Any] = ()) -> None:
        super().__init__(message)
        self.likely_px = likely_px


class DataError(InputError):
    """The frames do not suffice for the request."""


class NewerError(DataError):
    """Results of a newer labkit, which must not be replaced."""


class FitError(LabkitError):
    """An estimate did not come about."""


class WorkersError(LabkitError):
    """The workers, or their scheduler, are gone or of no use; the message says what to do."""


class LostTasksError(LabkitError):
    """Tasks failed, or did not finish even when each ran alone. lost: each task and the reason."""

    def __init__(self, lost: Sequence[tuple[Any, str]]) -> None:
        self.lost = tuple(lost)
        reasons = "; ".join(dict.fromkeys(why for _, why in lost))
        super().__init__(
            f"{len(lost)} of the tasks did not come to an end: {reasons}; try with --workers 1"
        )


class DeviceError(LabkitError):
    """A device did not obey."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer in time."""


class CameraError(DeviceError):
    """The camera failed."""


class RailError(DeviceError):
    """The rail failed."""


class RailLimitError(RailError):
    """A position outside the rail's travel."""


class DisplayError(DeviceError):
    """The display failed, or did not confirm its picture."""


def printable(text: str) -> str:
    """Return the text with all unprintable characters escaped as in Python.

    They are control characters, those that turn the direction of writing, and bytes of names that are not UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text
    )


def out_of_memory(error: BaseException) -> bool:
    """Return whether an error, or one that led to it, is the system's refusal of memory.

    Beside MemoryError these are threads that cannot start, libraries that cannot be loaded, and OpenCV's own error.
    """
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, MemoryError) or getattr(seen, "errno", None) == errno.ENOMEM:
            return True
        if any(words in str(seen).lower() for words in REFUSALS_OF_MEMORY):
            return True
        seen = seen.__cause__ or seen.__context__
    return False


def shown(value: object) -> str:
    """Return a value for a message: its Python repr, shortened."""
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."
