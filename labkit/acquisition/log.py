"""What a capture reports: events to the journal and to observers, steps to whoever waits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labkit.acquisition.sequence import Shot
from labkit.devices.observer import Holding, Observer, Viewer
from labkit.finder.preview import Look
from labkit.pace import PAUSED
from labkit.raw.mosaic import Mosaic
from labkit.session.session import Session
from labkit.types import Progress

HOMED = "homed"


class CaptureLog:
    """done, total: photographs that the session has, and those of the whole plan."""

    def __init__(
        self,
        session: Session,
        observers: Sequence[Observer],
        progress: Progress,
        done: int,
        total: int,
    ) -> None:
        self.done = done
        self.total = total
        self._session = session
        self._observers = observers
        self._progress = progress

    def note(self, event: str, **fields: Any) -> None:
        """An event, into the journal and to observers."""
        self._session.log(event, **fields)
        self.show(event, **fields)

    def show(self, event: str, **fields: Any) -> None:
        """An event that only observers see."""
        for observer in self._observers:
            observer.noted(event, **fields)

    def step(self, doing: str) -> None:
        """A step begins, unless an observer holds it back."""
        self._progress(self.done, self.total, doing)
        self.show("doing", what=doing)
        for observer in self._observers:
            held = isinstance(observer, Holding) and observer.holds
            if held:
                self._progress(self.done, self.total, PAUSED)
            observer.may_go_on()
            if held:
                self._progress(self.done, self.total, doing)

    def saw(self, look: Look) -> None:
        """A photograph that is not kept as a frame, to those who show it."""
        for observer in self._observers:
            if isinstance(observer, Viewer):
                observer.saw(look)

    def homed(self) -> int:
        """The rail was homed; the how many'th time in this session, from 1, earlier processes counted."""
        homing = 1 + len(
            [event for event in self._session.events if event["event"] == HOMED]
        )
        self.note(HOMED, homing=homing)
        return homing

    def took(self, shot: Shot, mosaic: Mosaic) -> None:
        """A photograph was committed."""
        self.done += 1
        self._progress(self.done, self.total, shot.name)
        for observer in self._observers:
            observer.took(
                shot.name, shot.kind, shot.range_mm, mosaic, self.done, self.total
            )
