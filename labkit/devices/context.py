"""What the caller provides to devices that are opened together, and the bench that they make."""

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
    """What is on a display now: whoever shows it says so, and whoever looks is called with it."""

    def __init__(self) -> None:
        self._see: Callable[[Picture], None] = lambda picture: None

    def watched_by(self, see: Callable[[Picture], None]) -> None:
        """Call this with every picture from now on."""
        self._see = see

    def shows(self, picture: Picture) -> None:
        """It is on the glass, as the display has confirmed."""
        self._see(picture)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceContext:
    """What the caller provides to devices that are opened together. Opening or closing a device changes none of it.

    shared: where devices that depend on each other find their common part; operator: answers questions; requests: what
    a person picked on a page, such as a picture by name; observers: the caller's own, notified of a capture;
    show_link: shows a person a page to open (what it is, its URL); warn: shows a person one line about a delay; glass: what a
    display shows, for a simulated camera before it.
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
    """A bench, ready: one camera, one rail, one display, how to wait (for seconds) beside them, and its observers."""

    camera: Camera
    rail: Rail
    display: Display
    wait: Callable[[float], None] = time.sleep
    observers: Sequence[Observer] = ()
