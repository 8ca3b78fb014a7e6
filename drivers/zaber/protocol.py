"""Zaber's ASCII protocol, version 3: commands with a message id and a checksum, and the replies to them."""

from __future__ import annotations

import re
from dataclasses import dataclass

REPLY = re.compile(
    r"@(?P<device>\d\d) (?P<axis>\d) (?:(?P<id>\d\d) )?(?P<verdict>OK|RJ) (?P<state>IDLE|BUSY) (?P<flag>\S\S) (?P<data>.+)"
)

SPEED_UNIT = 1.6384
"""Divisor from data of maxspeed to microsteps per second."""

UNREFERENCED = {"WR", "WH", "WL"}
"""Warnings after which the position means nothing: no reference, not homed, a limit met unexpectedly."""

FLAGS = {
    "FS": "it stalled",
    "FE": "it met a limit unexpectedly",
    "FQ": "its encoder failed",
    "FD": "its driver is disabled",
    "FO": "its driver is overloaded or too hot",
    "WR": "it has no reference",
    "WH": "it was not homed",
    "WL": "it met a limit unexpectedly",
}

REASONS = {
    "BADDATA": "a value outside what it allows",
    "BADCOMMAND": "a command it does not know",
    "STATUSBUSY": "not while it moves",
    "DRIVERDISABLED": "its driver is disabled",
    "PARKED": "it is parked",
}


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply: whether it was accepted, whether the axis moves, its highest warning ("--" for none), data."""

    device: int
    axis: int
    number: int | None
    accepted: bool
    busy: bool
    flag: str
    data: str

    @property
    def is_fault(self) -> bool:
        """Return whether the axis's reported position is unreliable."""
        return self.flag[0] == "F" or self.flag in UNREFERENCED


def checksum(text: str) -> str:
    """Return two hexadecimal digits that bring the sum of all bytes after the first to 0 modulo 256."""
    return f"{-sum(text[1:].encode()) & 0xFF:02X}"


def command_line(device: int, axis: int, number: int, command: str) -> bytes:
    """Return a whole command; an empty command requests the status."""
    text = f"/{device} {axis} {number:02d} {command}".rstrip()
    return f"{text}:{checksum(text)}\n".encode()


def read_reply(line: str) -> Reply | None:
    """Return the reply in a line with a valid checksum; None for alerts, information and damaged lines."""
    text, _, check = line.rpartition(":")
    found = REPLY.fullmatch(text)
    if not found or check != checksum(text):
        return None
    number = int(found["id"]) if found["id"] else None
    accepted = found["verdict"] == "OK"
    busy = found["state"] == "BUSY"
    return Reply(
        int(found["device"]),
        int(found["axis"]),
        number,
        accepted,
        busy,
        found["flag"],
        found["data"],
    )
