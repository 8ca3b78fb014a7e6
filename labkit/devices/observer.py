"""Who looks on while a capture runs: told what happens, asked whether it may go on."""

from __future__ import annotations

from typing import Any, Protocol

from labkit.raw.mosaic import Mosaic
from labkit.types import FrameKind


class Observer(Protocol):
    """Looks on, from the capture's own thread: must return soon, and raises nothing but what `may_go_on` may."""

    def noted(self, event: str, **fields: Any) -> None:
        """Something happened: what the journal is told, and `doing` (what) as each step begins."""
        ...

    def took(self, name: str, kind: FrameKind, range_mm: float | None, mosaic: Mosaic, done: int, total: int) -> None:
        """A photograph is safe in the session: done of total."""
        ...

    def may_go_on(self) -> None:
        """Asked before each step: returns at once, or once a person lets it; KeyboardInterrupt to stop as by Ctrl-C."""
        ...
