"""A USB camera that is not there, described to libusb by umockdev; run by the system's Python, which has gi.

Arguments: how many claims of its interface another program wins, and the error number that every transfer ends in.
Prints the folder that UMOCKDEV_DIR must name, then serves; a line on stdin unplugs it ("unplug"), plugs it in again
("plug") or asks how often it was claimed and reset ("counts").
"""

from __future__ import annotations

import errno
import json
import os
import sys
import threading
from typing import Any

import gi  # type: ignore[import-not-found]

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # type: ignore[import-not-found]  # noqa: E402

CLAIM, RELEASE, SUBMIT, RESET, DRIVER = (
    0x8004550F,
    0x80045510,
    0x8038550A,
    0x5514,
    0x41045508,
)
SET_INTERFACE, CLEAR_HALT = 0x80085504, 0x80045515

DEVICE_DESCRIPTOR = bytes.fromhex("12010002 00000040 b0043704 00010102 0301")
INTERFACE = bytes.fromhex(
    "09040000 03060101 00 07058102 000200 07050202 000200 07058303 080010"
)
CONFIGURATION = (
    b"\x09\x02"
    + (9 + len(INTERFACE)).to_bytes(2, "little")
    + bytes.fromhex("010100 c001")
    + INTERFACE
)


def describe(number: int) -> str:
    """A Nikon D750 on bus 1, as umockdev-record would write it."""
    node = f"/dev/bus/usb/001/{number:03d}"
    descriptors = (DEVICE_DESCRIPTOR + CONFIGURATION).hex().upper()
    attributes = {
        "busnum": "1", "devnum": str(number), "idVendor": "04b0", "idProduct": "0437", "bConfigurationValue": "1",
        "speed": "480", "bDeviceClass": "00", "bNumConfigurations": "1", "bNumInterfaces": " 1", "devpath": "1",
    }  # fmt: skip
    lines = [
        "P: /devices/pci0000:00/usb1/1-1",
        f"N: {node.removeprefix('/dev/')}={descriptors}",
        f"E: DEVNAME={node}",
        "E: DEVTYPE=usb_device",
        "E: SUBSYSTEM=usb",
        "E: BUSNUM=001",
        f"E: DEVNUM={number:03d}",
        "E: MAJOR=189",
        f"E: MINOR={number - 1}",
        *(f"A: {name}={value}" for name, value in attributes.items()),
        f"H: descriptors={descriptors}",
    ]
    return "\n".join(lines) + "\n\n"


class Usb:
    """The testbed with the camera in it."""

    def __init__(self, busy_claims: int, transfer_error: int) -> None:
        self._bed = UMockdev.Testbed.new()
        self._busy, self._error = busy_claims, transfer_error
        self._number = 1
        self.counts = {"claims": 0, "resets": 0}
        self.plug()

    @property
    def folder(self) -> str:
        return str(self._bed.get_root_dir())

    def plug(self) -> None:
        self._number += 1
        self._bed.add_from_string(describe(self._number))
        self._handler = UMockdev.IoctlBase()
        self._handler.connect("handle-ioctl", self._ioctl)
        self._bed.attach_ioctl(self._node, self._handler)

    def unplug(self) -> None:
        self._bed.detach_ioctl(self._node)
        self._bed.remove_device("/sys/devices/pci0000:00/usb1/1-1")
        os.unlink(self.folder + self._node)

    @property
    def _node(self) -> str:
        return f"/dev/bus/usb/001/{self._number:03d}"

    def _ioctl(self, handler: Any, client: Any) -> bool:
        request = client.get_request() & 0xFFFFFFFF
        result, error = 0, 0
        if request == CLAIM:
            self.counts["claims"] += 1
            if self.counts["claims"] <= self._busy:
                result, error = -1, errno.EBUSY
        elif request == SUBMIT:
            result, error = -1, self._error
        elif request == DRIVER:
            result, error = -1, errno.ENODATA
        elif request == RESET:
            self.counts["resets"] += 1
        elif request not in (RELEASE, SET_INTERFACE, CLEAR_HALT):
            result, error = -1, errno.ENOTTY
        client.complete(result, error)
        return True


def obey(usb: Usb, loop: GLib.MainLoop) -> None:
    """Do what stdin says, in the main loop's thread, and answer each line."""

    def do(line: str) -> bool:
        if line == "unplug":
            usb.unplug()
        elif line == "plug":
            usb.plug()
        print(json.dumps(usb.counts), flush=True)
        return False

    for line in sys.stdin:
        GLib.idle_add(do, line.strip())
    loop.quit()


if __name__ == "__main__":
    usb = Usb(int(sys.argv[1]), int(sys.argv[2]))
    print(usb.folder, flush=True)
    loop = GLib.MainLoop()
    threading.Thread(target=obey, args=(usb, loop), daemon=True).start()
    loop.run()
