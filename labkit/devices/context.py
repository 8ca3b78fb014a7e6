"""What devices that are opened together share, and the bench that they make."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any

from labkit.devices.observer import Observer
from labkit.devices.operator import Operator
from labkit.devices.protocols import Camera, Display, Rail


@dataclass(slots=True)
class DeviceContext:
    """What devices that are opened together share.

    A driver whose devices depend on each other keeps their common part in `shared`, under its address; the
    simulated ones keep their bench there, and replace `wait`, for in their world time is not real. A driver adds to
    `observers` who looks on, tells a person of a page to open by `link` (what it is, its URL) and of a hold-up by
    `tell`, and puts into `wishes` what a person asked for on a page, such as a picture by name. `operator` is asked what
    only a person can do.
    """

    shared: dict[str, Any] = field(default_factory=dict)
    wait: Callable[[float], None] = time.sleep
    observers: list[Observer] = field(default_factory=list)
    link: Callable[[str, str], None] = lambda what, url: None
    tell: Callable[[str], None] = lambda words: None
    wishes: SimpleQueue[str] = field(default_factory=SimpleQueue)
    operator: Operator = field(default_factory=Operator)


@dataclass(frozen=True, slots=True)
class Devices:
    """A bench, ready: one camera, one rail, one display, how to wait (for seconds) beside them, and who looks on."""

    camera: Camera
    rail: Rail
    display: Display
    wait: Callable[[float], None] = time.sleep
    observers: Sequence[Observer] = ()
