"""Reports of a capture: events to the journal and to observers, steps to the progress display."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labkit.acquisition.sequence import Shot
from labkit.devices.observer import Holding, Observer, Viewer
from labkit.finder.preview import Look
from labkit.jobs.pace import PAUSED
from labkit.photographs.photograph import Photograph
from labkit.session.session import Session
from labkit.types import Progress

HOMED = "homed"


class CaptureLog:
    """Journal, observers and progress of a capture.

    done, total: photographs of the session, and of the whole plan.
    """

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
        """Report an event to the journal and to observers."""
        self._session.log(event, **fields)
        self.show(event, **fields)

    def show(self, event: str, **fields: Any) -> None:
        """Report an event to observers only."""
        for observer in self._observers:
            observer.noted(event, **fields)

    def step(self, doing: str) -> None:
        """Report the start of a step, unless an observer holds the capture."""
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
        """Pass a photograph that is not kept as a frame to observers."""
        for observer in self._observers:
            if isinstance(observer, Viewer):
                observer.saw(look)

    def homed(self) -> int:
        """Report that the rail was homed; return the homing's number in this session, from 1 over all processes."""
        homing = 1 + len(
            [event for event in self._session.events if event["event"] == HOMED]
        )
        self.note(HOMED, homing=homing)
        return homing

    def took(self, shot: Shot, mosaic: Photograph) -> None:
        """Report a committed photograph."""
        self.done += 1
        self._progress(self.done, self.total, shot.name)
        for observer in self._observers:
            observer.took(
                shot.name, shot.kind, shot.range_mm, mosaic, self.done, self.total
            )
