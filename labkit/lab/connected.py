"""What is plugged in, and which drivers are installed: for `labkit devices`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import usb.core
from serial.tools import list_ports

from labkit.lab.discover import GROUPS, installed

IMAGE_CLASS = 6
"""USB interface class of still cameras (PTP), by the USB class codes."""


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A device on USB; `where` is bus and number, as in gphoto2:usb:001,004."""

    where: str
    vendor_product: str
    name: str
    is_camera: bool


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port, where a rail may hang."""

    path: str
    name: str


@dataclass(frozen=True, slots=True)
class Connected:
    """Everything found; drivers: names of those installed for camera, rail, display; notes: what was not seen."""

    usb: tuple[UsbDevice, ...]
    serial: tuple[SerialPort, ...]
    drivers: dict[str, tuple[str, ...]]
    notes: tuple[str, ...]


def look_around() -> Connected:
    """Look at USB, serial ports and entry points. What cannot be looked at is told in `notes`."""
    notes: tuple[str, ...] = ()
    try:
        devices = tuple(_usb_devices())
    except usb.core.NoBackendError:
        devices = ()
        notes = ("USB was not looked at: libusb is missing (Debian: apt-get install libusb-1.0-0)",)
    except usb.core.USBError as error:
        devices = ()
        notes = (f"USB was not looked at: {error}",)
    ports = tuple(
        SerialPort(port.device, port.description or "")
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
    )
    return Connected(devices, ports, {device: installed(device) for device in GROUPS}, notes)


def _usb_devices() -> Iterator[UsbDevice]:
    for device in usb.core.find(find_all=True):
        yield UsbDevice(
            where=f"{device.bus or 0:03d},{device.address or 0:03d}",
            vendor_product=f"{device.idVendor:04x}:{device.idProduct:04x}",
            name=_name(device),
            is_camera=any(interface.bInterfaceClass == IMAGE_CLASS for setting in device for interface in setting),
        )


def _name(device: usb.core.Device) -> str:
    """Maker and product, as far as this user may read them."""
    try:
        return " ".join(str(word) for word in (device.manufacturer, device.product) if word)
    except (usb.core.USBError, ValueError, NotImplementedError):
        return ""
