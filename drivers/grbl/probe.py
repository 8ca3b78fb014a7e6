"""Detect a GRBL controller at a serial port by asking for its state; nothing moves."""

from __future__ import annotations

import time

from labkit.drivers.grbl.protocol import BANNER, read_report
from labkit.drivers.serial.wire import SerialWire

BOOT_S = 2.5
"""Opening the port resets an Arduino, whose controller then takes two seconds to come up."""

ASK_AGAIN_S = 0.5


def answers(path: str) -> str | None:
    """Return the firmware at a port, such as "GRBL 1.1"; None for other devices. Raises RailError if the port does not open."""
    wire = SerialWire(path, 115_200)
    try:
        end_s = time.monotonic() + BOOT_S
        while time.monotonic() < end_s:
            wire.send(b"?")
            while (
                line := wire.line(min(end_s, time.monotonic() + ASK_AGAIN_S))
            ) is not None:
                if found := BANNER.search(line):
                    return f"GRBL {found[1]}"
                if read_report(line) is not None:
                    return "GRBL"
        return None
    finally:
        wire.close()
