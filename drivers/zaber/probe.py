"""Detect a Zaber stage at a serial port by asking for its state; nothing moves."""

from __future__ import annotations

import time

from labkit.drivers.serial.wire import SerialWire
from labkit.drivers.zaber.protocol import command_line, read_reply
from labkit.drivers.zaber.rail import AXIS, DEVICE

PROBE_ANSWER_S = 0.5
PROBE_NUMBER = 17
"""Message id of the request, which the reply repeats."""


def answers(path: str) -> str | None:
    """Return "Zaber" for a Zaber stage; None for any other device. Raises RailError for a port that does not
    open.
    """
    wire = SerialWire(path, 115_200)
    try:
        end_s = time.monotonic() + PROBE_ANSWER_S
        wire.send(
            b"\n" + command_line(DEVICE, AXIS, PROBE_NUMBER, "")
        )  # after whatever half a line is there
        while (line := wire.line(end_s)) is not None:
            reply = read_reply(line)
            if reply is not None and reply.number == PROBE_NUMBER:
                return "Zaber"
        return None
    finally:
        wire.close()
