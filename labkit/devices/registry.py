"""Devices by address: what stands before the colon is the driver's name, an entry point.

Groups `labkit.cameras`, `labkit.rails`, `labkit.displays`, `labkit.monitors` and `labkit.controllers`; each entry is a
callable (address, plan, context) -> device.
A lab adds its own device by an entry point of a package of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib.metadata import entry_points
from typing import Any

from labkit.devices.context import DeviceContext, Devices
from labkit.devices.protocols import Camera, Controller, Display, Rail
from labkit.errors import PlanError
from labkit.plan import Plan

GROUPS = {
    "camera": "labkit.cameras",
    "rail": "labkit.rails",
    "display": "labkit.displays",
    "monitor": "labkit.monitors",
    "controller": "labkit.controllers",
}


def installed(device: str) -> tuple[str, ...]:
    """Names of the drivers installed for one of `GROUPS`."""
    return tuple(sorted(entry_points(group=GROUPS[device]).names))


def open_camera(address: str, plan: Plan, context: DeviceContext) -> Camera:
    """The camera at an address such as gphoto2:usb:001,004. Raises PlanError, or what the driver raises."""
    camera: Camera = _open("camera", address, plan, context)
    return camera


def open_rail(address: str, plan: Plan, context: DeviceContext) -> Rail:
    """The rail at an address such as grbl:/dev/ttyUSB0. Raises PlanError, or what the driver raises."""
    rail: Rail = _open("rail", address, plan, context)
    return rail


def open_display(address: str, plan: Plan, context: DeviceContext) -> Display:
    """The display at an address such as web://0.0.0.0:8642. Raises PlanError, or what the driver raises."""
    display: Display = _open("display", address, plan, context)
    return display


def open_monitor(address: str, plan: Plan, context: DeviceContext) -> AbstractContextManager[object]:
    """An operator's page at an address such as web://0.0.0.0:8642, in the context before its devices, until the context ends.

    Raises PlanError, or what the driver raises.
    """
    monitor: AbstractContextManager[object] = _open("monitor", address, plan, context)
    return monitor


def open_controller(address: str, plan: Plan, context: DeviceContext) -> Controller:
    """The simulated controller behind a rail at an address such as grbl:simulated. Raises PlanError, or what it raises."""
    controller: Controller = _open("controller", address, plan, context)
    return controller


@contextmanager
def open_devices(plan: Plan, simulated: str | None = None, context: DeviceContext | None = None) -> Iterator[Devices]:
    """All three devices of a plan, opened together and closed together.

    simulated: an address such as "simulated:seed=3" that takes the place of all three; context: what they share, given
    by a caller who wants to look into it. Raises PlanError if the plan lacks a table that capture needs.
    """
    context = context or DeviceContext()
    if plan.camera is None or plan.rail is None or plan.display is None:
        missing = ", ".join(f"[{name}]" for name in ("camera", "rail", "display") if getattr(plan, name) is None)
        raise PlanError(f"the plan has no {missing}: to capture, it needs [camera], [rail] and [display]")
    with ExitStack() as stack:
        camera = stack.enter_context(open_camera(simulated or plan.camera.address, plan, context))
        rail = stack.enter_context(open_rail(simulated or plan.rail.address, plan, context))
        display = stack.enter_context(open_display(simulated or plan.display.address, plan, context))
        yield Devices(camera, rail, display, context.wait, context.observers)


def _open(device: str, address: str, plan: Plan, context: DeviceContext) -> Any:
    scheme = address.partition(":")[0]
    found = entry_points(group=GROUPS[device], name=scheme)
    if not found:
        known = ", ".join(f"{name}:" for name in installed(device)) or "none (is labkit installed?)"
        raise PlanError(f'{device}.address = "{address}": no driver "{scheme}" for a {device}; installed: {known}')
    return next(iter(found)).load()(address, plan, context)
