"""What is plugged in, as USB and serial ports tell it."""

from types import SimpleNamespace

import pytest
import usb.core
from serial.tools import list_ports

from labkit.lab.connected import SerialPort, UsbDevice, look_around


class FakeUsbDevice(list[list[SimpleNamespace]]):
    """A device as pyusb gives it: iterates over configurations, those over interfaces."""

    bus, address, idVendor, idProduct = 1, 4, 0x04B0, 0x0430  # noqa: N815
    manufacturer = "Nikon"

    def __init__(self, interface_class: int, readable: bool = True) -> None:
        super().__init__([[SimpleNamespace(bInterfaceClass=interface_class)]])
        self._readable = readable

    @property
    def product(self) -> str:
        if not self._readable:
            raise ValueError(
                "The device has no langid (permission issue, no string descriptors supported or device error)"
            )
        return "DSC D7000"


def test_a_camera_is_told_by_its_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [FakeUsbDevice(6), FakeUsbDevice(9, readable=False)]
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter(found))
    assert look_around().usb == (
        UsbDevice("001,004", "04b0:0430", "Nikon DSC D7000", is_camera=True),
        UsbDevice("001,004", "04b0:0430", "", is_camera=False),
    )


def test_missing_libusb_is_a_note_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_backend(find_all: bool) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", no_backend)
    found = look_around()
    assert found.usb == ()
    assert "apt-get install libusb" in found.notes[0]


def test_serial_ports_are_listed_by_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
    ports = [SimpleNamespace(device=f"/dev/ttyUSB{i}", description="CH340") for i in (1, 0)]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    assert look_around().serial == (SerialPort("/dev/ttyUSB0", "CH340"), SerialPort("/dev/ttyUSB1", "CH340"))
