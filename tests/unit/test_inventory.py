"""What is plugged in, as USB and serial ports report it."""

import os
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from serial.tools import list_ports

from labkit.devices import inventory
from labkit.devices.inventory import (
    Connected,
    FoundCamera,
    FoundRail,
    SerialPort,
    UsbDevice,
    holders,
    list_connected,
    udev_rules,
)
from labkit.errors import CameraError, RailError


@pytest.fixture(autouse=True)
def no_finders(monkeypatch: pytest.MonkeyPatch) -> None:
    """libgphoto2 is not asked here, nor are pages."""
    monkeypatch.setattr(inventory, "finders", dict)
    monkeypatch.setattr(inventory, "page_finders", dict)


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
    assert list_connected().usb == (
        UsbDevice("001,004", "04b0:0430", "Nikon DSC D7000", is_camera=True),
        UsbDevice("001,004", "04b0:0430", "", is_camera=False),
    )


def test_missing_libusb_is_a_note_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_backend(find_all: bool) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", no_backend)
    found = list_connected()
    assert found.usb is None
    assert "apt-get install libusb" in found.notes[0]


def test_cameras_are_listed_as_their_drivers_see_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        inventory, "finders", lambda: {"a": lambda: [("a:1", "One\n")], "b": lambda: []}
    )
    assert list_connected().cameras == (FoundCamera("a:1", "One?"),)


def probed(
    monkeypatch: pytest.MonkeyPatch, ports: list[SimpleNamespace], answers: Any
) -> Connected:
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    monkeypatch.setattr(
        inventory, "probes", lambda: {"acme": lambda path: None, "rig": answers}
    )
    return list_connected(probe=True)


def test_a_rail_that_answers_is_listed_with_its_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    builtin = SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None, pid=None)
    asked: list[str] = []

    def answers(path: str) -> str:
        asked.append(path)
        return "Rig 3"

    found = probed(monkeypatch, [builtin, fake_port("/dev/ttyUSB90")], answers)
    assert found.rails == (FoundRail("rig:/dev/ttyUSB90", "Rig 3"),)
    assert asked == [
        "/dev/ttyUSB90"
    ]  # what is no USB device may be anything: it is not written to


def test_a_port_that_does_not_open_is_noted_and_without_probing_none_is_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def held(path: str) -> str:
        raise RailError("held by another program")

    found = probed(monkeypatch, [fake_port("/dev/ttyUSB90")], held)
    assert found.rails == ()
    assert "/dev/ttyUSB90: was not asked for a rail: held by another program" in found.notes
    assert list_connected().rails is None


def test_a_driver_that_cannot_look_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    def hung() -> list[tuple[str, str]]:
        raise CameraError("it hung")

    monkeypatch.setattr(inventory, "finders", lambda: {"a": hung})
    found = list_connected()
    assert found.cameras is None
    assert "cameras of a: were not looked at: it hung" in found.notes


def test_serial_ports_are_listed_by_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
    ports = [fake_port(f"/dev/ttyUSB{i}") for i in (91, 90)]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    assert list_connected().serial == (
        SerialPort("/dev/ttyUSB90", "CH340", "1a86:7523"),
        SerialPort("/dev/ttyUSB91", "CH340", "1a86:7523"),
    )


def fake_port(path: str, name: str = "CH340") -> SimpleNamespace:
    return SimpleNamespace(device=path, description=name, vid=0x1A86, pid=0x7523)


def test_a_program_that_holds_a_port_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    near, far = os.openpty()
    path = os.ttyname(far)
    with subprocess.Popen(["sleep", "60"], stdin=far) as program:
        try:
            assert f"sleep ({program.pid})" in holders([path])[path]
            monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
            monkeypatch.setattr(list_ports, "comports", lambda: [fake_port(path)])
            assert f"{path}: in use by sleep ({program.pid})" in " ".join(
                list_connected().notes
            )
        finally:
            program.kill()
    assert holders([path])[path] == ()
    os.close(near)
    os.close(far)


def test_this_very_process_is_not_told_as_a_holder() -> None:
    near, far = os.openpty()
    assert holders([os.ttyname(far)]) == {os.ttyname(far): ()}
    os.close(near)
    os.close(far)


def test_without_proc_it_is_noted_that_holders_are_not_known(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # as on macOS
    monkeypatch.setattr(inventory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
    monkeypatch.setattr(list_ports, "comports", lambda: [fake_port("/dev/null")])
    assert list_connected().notes == (
        f"which programs hold a device is not known: this system has no {tmp_path}/proc",
    )
    assert holders(["/dev/null"], tmp_path / "proc") == {"/dev/null": ()}


def test_the_desktop_that_holds_a_camera_comes_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([FakeUsbDevice(6)]))
    monkeypatch.setattr(list_ports, "comports", lambda: [])
    held = {"/dev/bus/usb/001/004": ("gvfsd-gphoto2 (812)",)}
    monkeypatch.setattr(
        inventory,
        "holders",
        lambda paths, proc: {path: held.get(path, ()) for path in paths},
    )
    assert list_connected().notes == (
        "usb:001,004: in use by gvfsd-gphoto2 (812); let it go with: gio mount -s gphoto2",
    )


def test_a_missing_permission_points_to_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([FakeUsbDevice(6)]))
    monkeypatch.setattr(list_ports, "comports", lambda: [fake_port("/dev/null")])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert [
        note
        for note in list_connected().notes
        if "/dev/null: no permission" in note and "--udev" in note
    ]


def connection(**changes: Any) -> Connected:
    empty = Connected((), (), (), {}, ())
    return replace(empty, **changes)


def test_rules_match_what_is_plugged_in_and_nothing_else() -> None:
    camera = UsbDevice("001,004", "04b0:0430", "Nikon DSC D7000", is_camera=True)
    hub = UsbDevice("001,001", "1d6b:0002", "hub", is_camera=False)
    rail = SerialPort("/dev/ttyUSB0", "CH340", "1a86:7523")
    rules = udev_rules(
        connection(usb=(hub, camera), serial=(SerialPort("/dev/ttyS0", "n/a"), rail, rail))
    )
    assert [line for line in rules.splitlines() if not line.startswith("#")] == [
        'SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="04b0", ATTR{idProduct}=="0430", '
        'MODE="0660", GROUP="plugdev", TAG+="uaccess"',
        'SUBSYSTEM=="tty", ATTRS{idVendor}=="1a86", ATTRS{idProduct}=="7523", '
        'MODE="0660", GROUP="dialout", TAG+="uaccess", ENV{ID_MM_DEVICE_IGNORE}="1"',
    ]


def test_without_devices_the_rules_say_what_to_do() -> None:
    assert "plug them in and run this again" in udev_rules(connection())


def test_a_devices_name_cannot_add_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    evil = 'x\nSUBSYSTEM=="usb", RUN+="/bin/sh"'
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter([]))
    monkeypatch.setattr(list_ports, "comports", lambda: [fake_port("/dev/ttyUSB90", evil)])
    found = list_connected()
    assert "\n" not in found.serial[0].name
    direct = UsbDevice("001,004", "04b0:0430", evil, is_camera=True)
    for rules in (udev_rules(found), udev_rules(connection(usb=(direct,)))):
        assert not [
            line
            for line in rules.splitlines()
            if "RUN" in line and not line.startswith("# ")
        ]
