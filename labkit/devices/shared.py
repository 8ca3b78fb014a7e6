"""Parts that several devices of one bench share, such as a web server or a simulated world, by key."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class Lease(Generic[Part]):
    """A shared part for as long as its user needs the part. close: give it back; again does nothing."""

    part: Part
    close: Callable[[], None]


@dataclass(slots=True)
class _Shared:
    part: Any
    end: Callable[[Any], None]
    users: int = 0


class SharedParts:
    """Parts by key, usually an address; the first user makes each part and the last ends it.

    given: parts that the caller made and keeps, which are never ended.
    """

    def __init__(self, given: Mapping[str, Any] | None = None) -> None:
        self._given = dict(given or {})
        self._made: dict[str, _Shared] = {}
        self._lock = threading.RLock()

    def lease(
        self,
        key: str,
        make: Callable[[], Part],
        end: Callable[[Part], None] = lambda part: None,
    ) -> Lease[Part]:
        """Return the part of a key, made by `make` if there is none; `end` is called with the part after its last user."""
        with self._lock:
            if key in self._given:
                return Lease(self._given[key], lambda: None)
            shared = self._made.get(key)
            if shared is None:
                shared = self._made[key] = _Shared(make(), end)
            shared.users += 1
            held = [
                shared
            ]  # emptied by the first call, so that a second one counts nothing
            return Lease(shared.part, lambda: self._release(key, held))

    def items(self) -> tuple[tuple[str, Any], ...]:
        """Return (key, part) of all present parts."""
        with self._lock:
            return (
                *self._given.items(),
                *((key, shared.part) for key, shared in self._made.items()),
            )

    def values(self) -> tuple[Any, ...]:
        """Return all present parts."""
        return tuple(part for _, part in self.items())

    def _release(self, key: str, held: list[_Shared]) -> None:
        with self._lock:
            if not held:
                return
            shared = held.pop()
            shared.users -= 1
            if not shared.users:
                del self._made[key]
                shared.end(shared.part)
