"""List connected devices, programs that hold them, missing permissions and drivers: `labkit devices`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import usb.core
from serial.tools import list_ports

from labkit.devices.registry import (
    ENTRY_POINT_GROUPS,
    finders,
    installed,
    page_finders,
    probes,
)
from labkit.errors import DeviceError

IMAGE_CLASS = 6
"""USB interface class of still cameras (PTP), by the USB class codes."""

STABLE_NAMES = Path("/dev/serial/by-id")
"""Where Linux's udev keeps names of serial ports that do not change with the order of plugging."""

PROC = Path("/proc")
"""Folder in which Linux lists the open files of each process."""

RULES_FILE = "/etc/udev/rules.d/70-labkit.rules"
"""A number below 73, or the tag uaccess comes too late."""


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A device on USB; `where` is bus and number, as in gphoto2:usb:001,004; holders: programs that have the device open."""

    where: str
    vendor_product: str
    name: str
    is_camera: bool
    holders: tuple[str, ...] = ()
    permitted: bool = True


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port, where a rail may hang; stable_path stays the same however things are plugged."""

    path: str
    name: str
    vendor_product: str = ""
    stable_path: str = ""
    holders: tuple[str, ...] = ()
    permitted: bool = True


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera found by a driver, and the address that opens the camera."""

    address: str
    model: str


@dataclass(frozen=True, slots=True)
class FoundRail:
    """A rail's controller that answered at a serial port, and the address that opens the rail."""

    address: str
    model: str


@dataclass(frozen=True, slots=True)
class OpenPage:
    """A page served now.

    address: for a plan's display, empty for the operator's page; text: state of the page.
    """

    address: str
    url: str
    text: str


@dataclass(frozen=True, slots=True)
class Connected:
    """Connected devices.

    usb, cameras, rails: None if not searched, with the reason in `notes`; drivers:
    installed names for each of `GROUPS`; pages: served now.
    """

    cameras: tuple[FoundCamera, ...] | None
    usb: tuple[UsbDevice, ...] | None
    serial: tuple[SerialPort, ...]
    drivers: dict[str, tuple[str, ...]]
    notes: tuple[str, ...]
    rails: tuple[FoundRail, ...] | None = ()
    pages: tuple[OpenPage, ...] = ()


def list_connected(probe: bool = False) -> Connected:
    """List cameras, USB devices, serial ports, pages and entry points.

    Parameters
    ----------
    probe : whether to ask at each free serial port on USB for a rail; nothing moves, but
        opening a port restarts some controllers, which then need homing

    Returns
    -------
    what is connected; its `notes` name what was not searched

    >>> labkit.list_connected().cameras
    """
    cameras, notes = _cameras()
    devices: tuple[UsbDevice, ...] | None = None
    try:
        devices = tuple(_usb_devices())
    except usb.core.NoBackendError:
        notes += (
            "USB was not looked at: libusb is missing (Debian: apt-get install libusb-1.0-0)",
        )
    except usb.core.USBError as error:
        notes += (f"USB was not looked at: {error}",)
    if not PROC.is_dir():
        notes += (f"which programs hold a device is not known: this system has no {PROC}",)
    ports = tuple(_serial_ports())
    for device in devices or ():
        if device.is_camera:
            notes += _hindrances(f"usb:{device.where}", device.permitted, device.holders)
    for port in ports:
        notes += _hindrances(port.path, port.permitted, port.holders)
    rails, silent = _rails(ports) if probe else (None, ())
    drivers = {device: installed(device) for device in ENTRY_POINT_GROUPS}
    return Connected(
        cameras, devices, ports, drivers, (*notes, *silent), rails, tuple(_open_pages())
    )


def udev_rules(connected: Connected) -> str:
    """Return udev rules that let the user at this machine, and nobody else, open the cameras and USB serial ports."""
    lines = [
        f"# labkit devices --udev | sudo tee {RULES_FILE}",
        "# sudo udevadm control --reload && sudo udevadm trigger, then plug the devices in again",
    ]
    rules = [
        (
            device.vendor_product,
            device.name,
            'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", {ids}, {access}',
        )
        for device in connected.usb or ()
        if device.is_camera
    ]
    rules += [
        # ModemManager takes every new port for a modem, and talks to it
        (
            port.vendor_product,
            port.name,
            'SUBSYSTEM=="tty", {ids}, {access}, ENV{{ID_MM_DEVICE_IGNORE}}="1"',
        )
        for port in connected.serial
    ]
    written = set()
    for vendor_product, name, rule in rules:
        ids = re.fullmatch("([0-9a-f]{4}):([0-9a-f]{4})", vendor_product)
        if not ids or (vendor_product, rule) in written:
            continue
        written.add((vendor_product, rule))
        attribute, group = (
            ("ATTR", "plugdev") if "usb_device" in rule else ("ATTRS", "dialout")
        )
        match = f'{attribute}{{idVendor}}=="{ids[1]}", {attribute}{{idProduct}}=="{ids[2]}"'
        access = f'MODE="0660", GROUP="{group}", TAG+="uaccess"'
        lines += [f"# {printable(name)}", rule.format(ids=match, access=access)]
    if not written:
        lines.append(
            "# no camera and no USB serial port is plugged in: plug them in and run this again"
        )
    return "\n".join(lines)


def printable(name: str) -> str:
    """Return a device's own name, safe for a terminal and for a comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def holders(paths: Iterable[str], proc: Path = PROC) -> dict[str, tuple[str, ...]]:
    """Return the programs, as "name (process id)", that have each file open, without this process.

    Only root sees the programs of other users; without Linux's /proc the result is empty.
    """
    names_by_path: dict[str, list[str]] = {path: [] for path in paths}
    for folder in proc.glob("[0-9]*"):
        if folder.name == str(os.getpid()):
            continue
        with suppress(OSError):  # gone meanwhile, or somebody else's
            opened = {os.readlink(handle) for handle in (folder / "fd").iterdir()}
            name = printable(
                (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
            )
            for path in opened & names_by_path.keys():
                names_by_path[path].append(f"{name} ({folder.name})")
    return {path: tuple(sorted(names)) for path, names in names_by_path.items()}


def _hindrances(where: str, permitted: bool, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the reasons why this process cannot open a device."""
    notes: tuple[str, ...] = ()
    if not permitted:
        notes += (
            f"{where}: no permission to open it; `labkit devices --udev` prints the rule that gives it",
        )
    if names:
        advice = (
            "; let it go with: gio mount -s gphoto2"
            if any("gvfs" in name for name in names)
            else ""
        )
        notes += (f"{where}: in use by {', '.join(names)}{advice}",)
    return notes


def _cameras() -> tuple[tuple[FoundCamera, ...] | None, tuple[str, ...]]:
    """Return the cameras that drivers find, None if no driver could search, and notes on failed searches."""
    found: tuple[FoundCamera, ...] | None = None
    notes: tuple[str, ...] = ()
    for name, find in finders().items():
        try:
            seen = tuple(
                FoundCamera(address, printable(model)) for address, model in find()
            )
            found = (*(found or ()), *seen)
        except DeviceError as error:
            notes += (f"cameras of {name}: were not looked at: {error}",)
    return found, notes


def _rails(ports: Iterable[SerialPort]) -> tuple[tuple[FoundRail, ...], tuple[str, ...]]:
    """Return the rails that answer at free USB ports, and notes on ports that could not be asked."""
    found = list[FoundRail]()
    notes = list[str]()
    for port in ports:
        if not port.vendor_product or port.holders or not port.permitted:
            continue
        for name, answers in probes().items():
            try:
                model = answers(port.path)
            except DeviceError as error:
                notes.append(f"{port.path}: was not asked for a rail: {error}")
                break
            if model is not None:
                found.append(
                    FoundRail(f"{name}:{port.stable_path or port.path}", printable(model))
                )
                break
    return tuple(found), tuple(notes)


def _open_pages() -> Iterator[OpenPage]:
    for find in page_finders().values():
        yield from (
            OpenPage(address, url, printable(text)) for address, url, text in find()
        )


def _usb_devices() -> Iterator[UsbDevice]:
    devices = list(usb.core.find(find_all=True))
    held = holders((_usb_file(device) for device in devices), PROC)
    for device in devices:
        file = _usb_file(device)
        yield UsbDevice(
            where=f"{device.bus or 0:03d},{device.address or 0:03d}",
            vendor_product=f"{device.idVendor:04x}:{device.idProduct:04x}",
            name=_name(device),
            is_camera=any(
                interface.bInterfaceClass == IMAGE_CLASS
                for setting in device
                for interface in setting
            ),
            holders=held[file],
            permitted=_may_open(file),
        )


def _usb_file(device: usb.core.Device) -> str:
    return f"/dev/bus/usb/{device.bus or 0:03d}/{device.address or 0:03d}"


def _serial_ports() -> Iterator[SerialPort]:
    ports = sorted(list_ports.comports(), key=lambda port: port.device)
    held = holders((port.device for port in ports), PROC)
    stable = {str(link.resolve()): str(link) for link in sorted(STABLE_NAMES.glob("*"))}
    for port in ports:
        yield SerialPort(
            path=port.device,
            name=printable(port.description or ""),
            vendor_product="" if port.vid is None else f"{port.vid:04x}:{port.pid:04x}",
            stable_path=stable.get(port.device, ""),
            holders=held[port.device],
            permitted=_may_open(port.device),
        )


def _may_open(path: str) -> bool:
    """Return whether this user may read and write a device; an invisible file counts as allowed."""
    return not Path(path).exists() or os.access(path, os.R_OK | os.W_OK)


def _name(device: usb.core.Device) -> str:
    """Return maker and product, as far as this user may read them."""
    try:
        return printable(
            " ".join(str(word) for word in (device.manufacturer, device.product) if word)
        )
    except (usb.core.USBError, ValueError, NotImplementedError):
        return ""
