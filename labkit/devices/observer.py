"""Observers of a capture: notified of what happens, and able to hold it or to stop it between steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from labkit.devices.operator import AnswerPage
from labkit.finder.preview import Look
from labkit.raw.mosaic import Mosaic
from labkit.types import FrameKind


class Observer(Protocol):
    """Notified from the capture's own thread: must return soon, and raises nothing but what `may_go_on` may."""

    def noted(self, event: str, **fields: Any) -> None:
        """Something happened: the journal's events, and `doing` (what) as each step begins."""
        ...

    def took(
        self,
        name: str,
        kind: FrameKind,
        range_mm: float | None,
        mosaic: Mosaic,
        done: int,
        total: int,
    ) -> None:
        """A photograph is safe in the session: done of total."""
        ...

    def may_go_on(self) -> None:
        """Called before each step: returns at once, or once a person lets it; KeyboardInterrupt to stop as by Ctrl-C."""
        ...


class Monitor(Observer, AnswerPage, Protocol):
    """An operator's page: it shows a capture, and the operator's questions may be answered on it."""


@runtime_checkable
class Viewer(Protocol):
    """An observer that also shows photographs that do not become frames: a preflight's, and those to focus by."""

    def saw(self, look: Look) -> None:
        """A photograph was taken and looked at."""
        ...


@runtime_checkable
class Holding(Protocol):
    """An observer that can say beforehand whether `may_go_on` would hold the capture."""

    @property
    def holds(self) -> bool:
        """Whether it would."""
        ...


@runtime_checkable
class Observed(Protocol):
    """A device that brings observers of its own, as a web display brings its server's monitor."""

    @property
    def observers(self) -> Sequence[Observer]:
        """They are notified of a capture with this device."""
        ...
