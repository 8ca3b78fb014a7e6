"""What devices of one bench have in common, such as a web server or a simulated world, found by its key."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class Lease(Generic[Part]):
    """A shared part for as long as it is needed. close: give it back; again does nothing."""

    part: Part
    close: Callable[[], None]


@dataclass(slots=True)
class _Shared:
    part: Any
    end: Callable[[Any], None]
    users: int = 0


class SharedParts:
    """Parts by key, usually an address. Each is made for its first user and ended when the last has given it back.

    given: parts that the caller made and keeps; these are never ended.
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
        """The part of that key, made by `make` if there is none; `end` is called with it after its last user."""
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
        """(key, part) of everything that is there now."""
        with self._lock:
            return (
                *self._given.items(),
                *((key, shared.part) for key, shared in self._made.items()),
            )

    def values(self) -> tuple[Any, ...]:
        """Everything that is there now."""
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
