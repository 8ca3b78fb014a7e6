"""The caller's services for devices that open together, and the resulting bench."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from queue import SimpleQueue

from labkit.devices.observer import Observer
from labkit.devices.operator import Operator
from labkit.devices.protocols import Camera, Display, Picture, Rail
from labkit.devices.shared import SharedParts


class Glass:
    """The picture on a display now: displays report it, and listeners receive it."""

    def __init__(self) -> None:
        self._see: Callable[[Picture], None] = lambda picture: None

    def watched_by(self, see: Callable[[Picture], None]) -> None:
        """Call this with every picture from now on."""
        self._see = see

    def shows(self, picture: Picture) -> None:
        """Report a picture that the display has confirmed."""
        self._see(picture)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceContext:
    """The caller's services for devices that open together; no device changes them.

    Parameters
    ----------
    shared : parts that several devices have in common
    operator : answers questions
    requests : choices made by a person on a page, such as a picture by name
    observers : the caller's own, notified of a capture
    show_link : shows a person a page to open (description, URL)
    warn : shows a person one line about a delay
    glass : the picture on a display, for a simulated camera in front
    """

    shared: SharedParts = field(default_factory=SharedParts)
    operator: Operator = field(default_factory=Operator)
    requests: SimpleQueue[str] = field(default_factory=SimpleQueue)
    observers: tuple[Observer, ...] = ()
    show_link: Callable[[str, str], None] = lambda what, url: None
    warn: Callable[[str], None] = lambda text: None
    glass: Glass = field(default_factory=Glass)


@dataclass(frozen=True, slots=True)
class Devices:
    """An open bench: camera, rail, display, a function that waits for seconds, and observers."""

    camera: Camera
    rail: Rail
    display: Display
    wait: Callable[[float], None] = time.sleep
    observers: Sequence[Observer] = ()
