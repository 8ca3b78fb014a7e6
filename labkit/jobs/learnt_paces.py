"""How long work of a kind took on this machine, for the time left of the next.

The store is a small file in the user's state folder. It is never needed: what is missing, odd or cannot be written means that
nothing was learnt.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from labkit.errors import InputError
from labkit.storage.files import state_folder, write_atomically
from labkit.storage.reading import read_bytes

MOST_STORE_BYTES = 2**16
MOST_LEARNT = 12
"""Last pieces of work of a kind kept: a machine's load changes."""

LIKE_SIZE = 3.0
"""Ratio of sizes up to which work is alike: the time of large work is not that of small work, times its size."""

FILE = "paces.json"


@dataclass(frozen=True, slots=True)
class Paces:
    """Sizes and durations of finished work, by kind.

    Attributes
    ----------
    file : where they are kept; None for a user without a home
    """

    file: Path | None

    @classmethod
    def of_user(cls) -> Paces:
        """Return the paces of this machine's user."""
        with suppress(RuntimeError):
            return cls(state_folder() / FILE)
        return cls(None)

    def expected_s(self, kind: str, size: float) -> float | None:
        """Return how long work will take, by the work that was alike; None if nothing was learnt.

        Parameters
        ----------
        kind : of work
        size : in any unit of the kind's own
        """
        learnt = self._read().get(kind, [])
        near = [one for one in learnt if max(one[0] / size, size / one[0]) <= LIKE_SIZE]
        each_s = [seconds / other for other, seconds in near or learnt]
        return size * median(each_s) if each_s else None

    def learn(self, kind: str, size: float, seconds: float) -> None:
        """Add finished work."""
        if self.file is None or not (_is_positive(size) and _is_positive(seconds)):
            return
        every = self._read()
        every[kind] = [*every.get(kind, []), (size, seconds)][-MOST_LEARNT:]
        with suppress(InputError, OSError):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(self.file, json.dumps(every).encode())

    def _read(self) -> dict[str, list[tuple[float, float]]]:
        """Return (size, seconds) of finished work by kind; nothing from a file that is odd in any way."""
        try:
            if self.file is None:
                return {}
            return _checked(json.loads(read_bytes(self.file, MOST_STORE_BYTES)))
        except (OSError, ValueError, RecursionError):
            return {}


def _checked(content: Any) -> dict[str, list[tuple[float, float]]]:
    """Return a store's content. Raises ValueError if it is no store."""
    if not isinstance(content, dict):
        raise ValueError("no table")
    for entries in content.values():
        if not isinstance(entries, list):
            raise ValueError("no list")
        for entry in entries:
            if not (
                isinstance(entry, list)
                and len(entry) == 2
                and all(map(_is_positive, entry))
            ):
                raise ValueError("no pair of numbers")
    return {
        kind: [(float(size), float(seconds)) for size, seconds in entries[-MOST_LEARNT:]]
        for kind, entries in content.items()
    }


def _is_positive(value: Any) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and value > 0
        and value < 1e12
        and math.isfinite(value)
    )
