"""Observers of a capture, which are notified of events and can hold or stop the capture between steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from labkit.devices.operator import AnswerPage
from labkit.finder.preview import Look
from labkit.photographs.photograph import Photograph
from labkit.types import FrameKind


class Observer(Protocol):
    """An observer, called from the capture's own thread.

    Calls must return soon, and raise no error except as `may_go_on` states.
    """

    def noted(self, event: str, **fields: Any) -> None:
        """Receive an event of the journal, or `doing` (what) at the start of each step."""
        ...

    def took(
        self,
        name: str,
        kind: FrameKind,
        range_mm: float | None,
        mosaic: Photograph,
        done: int,
        total: int,
    ) -> None:
        """Receive a photograph after its commit to the session: done of total."""
        ...

    def may_go_on(self) -> None:
        """Return before a step, at once or when a person allows; raise KeyboardInterrupt to stop the capture."""
        ...


class Monitor(Observer, AnswerPage, Protocol):
    """An operator's page: shows a capture, and takes answers to the operator's questions."""


@runtime_checkable
class Viewer(Protocol):
    """An observer that also shows photographs that do not become frames: in preflight and focusing."""

    def saw(self, look: Look) -> None:
        """Receive a photograph, before and after it is judged."""
        ...


@runtime_checkable
class Holding(Protocol):
    """An observer that can predict whether `may_go_on` will hold the capture."""

    @property
    def holds(self) -> bool:
        """Return whether `may_go_on` would hold the capture now."""
        ...


@runtime_checkable
class Observed(Protocol):
    """A device with observers of its own, such as a web display with its server's monitor."""

    @property
    def observers(self) -> Sequence[Observer]:
        """They are notified of a capture with this device."""
        ...
