"""Open devices by address: the text before the colon is the driver's name, an entry point.

The groups are `labkit.cameras`, `labkit.rails`, `labkit.displays`, `labkit.monitors` and
`labkit.controllers`; each entry is a callable (address, plan, context) -> device. Drivers
use their arguments without changing them. A callable of group `labkit.finders`, by the name
of its driver, lists the devices it finds: [(address, model), ...]; it raises DeviceError. A
callable of `labkit.probes` names the controller at a serial port, given its path: a name or
None; nothing moves, and it raises DeviceError. A callable of `labkit.pages` lists pages
served now: [(address for a plan or "", URL, state), ...]. A lab adds a device by
an entry point of its own package.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib.metadata import entry_points
from typing import Any

from labkit.devices.context import DeviceContext, Devices
from labkit.devices.observer import Monitor, Observed, Observer
from labkit.devices.operator import AnswerPage
from labkit.devices.protocols import (
    Camera,
    Controller,
    Display,
    Rail,
    SeesDisplay,
    SimulatedTime,
)
from labkit.errors import PlanError
from labkit.plan import Plan
from labkit.plan.tables import BY_HAND

ENTRY_POINT_GROUPS = {
    "camera": "labkit.cameras",
    "rail": "labkit.rails",
    "display": "labkit.displays",
    "monitor": "labkit.monitors",
    "controller": "labkit.controllers",
}


FINDERS = "labkit.finders"
PROBES = "labkit.probes"
PAGES = "labkit.pages"


def installed(device: str) -> tuple[str, ...]:
    """Return the names of the drivers installed for one of `ENTRY_POINT_GROUPS`."""
    return tuple(sorted(entry_points(group=ENTRY_POINT_GROUPS[device]).names))


def finders() -> dict[str, Callable[[], Sequence[tuple[str, str]]]]:
    """Return the functions that list connected devices, by the driver's name."""
    return {entry.name: entry.load() for entry in entry_points(group=FINDERS)}


def probes() -> dict[str, Callable[[str], str | None]]:
    """Return the functions that ask a serial port for a driver's rail, by the driver's name."""
    return {entry.name: entry.load() for entry in entry_points(group=PROBES)}


def page_finders() -> dict[str, Callable[[], Sequence[tuple[str, str, str]]]]:
    """Return the functions that list served pages, by the driver's name."""
    return {entry.name: entry.load() for entry in entry_points(group=PAGES)}


def open_camera(address: str, plan: Plan, context: DeviceContext) -> Camera:
    """Open the camera at an address such as gphoto2:usb:001,004. Raises PlanError and the driver's errors."""
    camera: Camera = _open("camera", address, plan, context)
    return camera


def open_rail(address: str, plan: Plan, context: DeviceContext) -> Rail:
    """Open the rail at an address such as grbl:/dev/ttyUSB0. Raises PlanError and the driver's errors."""
    rail: Rail = _open("rail", address, plan, context)
    return rail


def open_display(address: str, plan: Plan, context: DeviceContext) -> Display:
    """Open the display at an address such as web://0.0.0.0:8642. Raises PlanError and the driver's errors."""
    display: Display = _open("display", address, plan, context)
    return display


@contextmanager
def open_monitor(address: str, plan: Plan, context: DeviceContext) -> Iterator[Monitor]:
    """Open an operator's page at an address such as web://0.0.0.0:8642, which takes the operator's answers.

    To show a capture on the page, open the devices with dataclasses.replace(context,
    observers=(page,)). Raises PlanError and the driver's errors.
    """
    opened: AbstractContextManager[Monitor] = _open("monitor", address, plan, context)
    with opened as page, context.operator.reached_by(page):
        yield page


def open_controller(address: str, plan: Plan, context: DeviceContext) -> Controller:
    """Open the simulated controller of a rail at an address such as grbl:simulated.

    Raises PlanError and the controller's errors.
    """
    controller: Controller = _open("controller", address, plan, context)
    return controller


@contextmanager
def open_devices(
    plan: Plan, simulated: str | None = None, context: DeviceContext | None = None
) -> Iterator[Devices]:
    """Open all three devices of a plan together until the end of the block.

    Pages that a device serves also take answers to the operator's questions. Without
    [display] the target is on paper.

    Parameters
    ----------
    plan : with [camera] and [rail]
    simulated : an address such as "simulated:seed=3" in place of all three
    context : the caller's services for the devices

    Raises
    ------
    PlanError
        the plan lacks a table that a capture needs
    DeviceError
        a device cannot be opened

    >>> with labkit.open_devices(plan) as bench:
    ...     bench.rail.home()
    """
    context = context or DeviceContext()
    settings = plan.capture_camera
    if settings is None or plan.rail is None:
        tables = {"camera": settings, "rail": plan.rail}
        missing = ", ".join(f"[{name}]" for name in tables if tables[name] is None)
        raise PlanError(
            f"the plan has no {missing}: to capture, it needs [camera] and [rail]"
        )
    shown_at = BY_HAND if plan.display is None else plan.display.address
    with ExitStack() as stack:
        camera = stack.enter_context(
            open_camera(simulated or settings.address, plan, context)
        )
        rail = stack.enter_context(open_rail(simulated or plan.rail.address, plan, context))
        display = stack.enter_context(open_display(simulated or shown_at, plan, context))
        if isinstance(camera, SeesDisplay):
            context.glass.watched_by(camera.see)
        devices = (camera, rail, display)
        observers = observers_of(context, devices)
        for page in observers:
            if isinstance(page, AnswerPage):
                stack.enter_context(context.operator.reached_by(page))
        waits = [device.wait for device in devices if isinstance(device, SimulatedTime)]
        yield Devices(camera, rail, display, waits[0] if waits else time.sleep, observers)


def observers_of(context: DeviceContext, devices: Iterable[object]) -> tuple[Observer, ...]:
    """Return the caller's observers and the devices' own, such as a web display's monitor, each once."""
    brought = [
        observer
        for device in devices
        if isinstance(device, Observed)
        for observer in device.observers
    ]
    return tuple(
        {id(observer): observer for observer in (*context.observers, *brought)}.values()
    )


def _open(device: str, address: str, plan: Plan, context: DeviceContext) -> Any:
    scheme = address.partition(":")[0]
    found = entry_points(group=ENTRY_POINT_GROUPS[device], name=scheme)
    if not found:
        known = (
            ", ".join(f"{name}:" for name in installed(device))
            or "none (is labkit installed?)"
        )
        raise PlanError(
            f'{device}.address = "{address}": no driver "{scheme}" for a {device}; installed: {known}'
        )
    return next(iter(found)).load()(address, plan, context)
