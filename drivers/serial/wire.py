"""A serial line to a controller: lines of text in, bytes out, every wait limited, every fault a RailError."""

from __future__ import annotations

import contextlib
import errno
import termios
import time

import serial
from serial.tools import list_ports

from labkit.errors import RailError

GLANCE_S = 0.02
"""Longest single wait inside pyserial; deadlines are kept here."""

AGAIN_S = 0.1
"""Between two attempts to open a port."""

LONGEST_LINE = 1024
"""More than this without an end of line is noise."""


class SerialWire:
    """A port opened exclusively. Raises RailError: no such port, no permission, held by another program.

    within_s: time to keep trying, for a port being plugged in again
    """

    def __init__(self, path: str, baud: int, within_s: float = 0.0) -> None:
        self.path = path
        self._heard = bytearray()
        deadline_s = time.monotonic() + within_s
        while True:
            try:
                # on a pseudo-terminal and on some drivers a second open succeeds unless it is exclusive
                self._port = serial.Serial(
                    path, baud, timeout=GLANCE_S, write_timeout=2.0, exclusive=True
                )
                return
            except (serial.SerialException, OSError, ValueError, termios.error) as error:
                if time.monotonic() >= deadline_s:
                    raise RailError(_why_not_open(path, error)) from error
            time.sleep(AGAIN_S)

    def send(self, data: bytes) -> None:
        """Write all bytes. Raises RailError when the line is gone, or blocks for two seconds."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._gone(error) from error

    def line(self, deadline_s: float) -> str | None:
        """Return the next whole line without its end, or None at the deadline (of time.monotonic).

        Bytes that are not ASCII become U+FFFD: a damaged line must not pass for another.
        """
        while True:
            raw, end, rest = self._heard.partition(b"\n")
            if end:
                self._heard = bytearray(rest)
                return raw.decode("ascii", errors="replace").strip()
            if len(self._heard) > LONGEST_LINE:
                self._heard.clear()
            if not self._listen() and time.monotonic() >= deadline_s:
                return None

    def close(self) -> None:
        """Let the port go; again does nothing."""
        with contextlib.suppress(
            OSError, termios.error
        ):  # unplugged: there is nothing left to let go
            self._port.close()

    def _listen(self) -> bool:
        """Wait a moment for bytes; whether any came."""
        try:
            more = self._port.read(max(1, self._port.in_waiting))
        except (serial.SerialException, OSError, termios.error, TypeError) as error:
            # pyserial raises TypeError when another thread has closed the port
            raise self._gone(error) from error
        self._heard += more
        return bool(more)

    def _gone(self, error: Exception) -> RailError:
        return RailError(f"{self.path} is gone ({error}); plug the rail in again")


def _why_not_open(path: str, error: Exception) -> str:
    """Explain why a port does not open, and the remedy."""
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        ports = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return f"there is no serial port {path}; found: {ports}"
    if number in (errno.EACCES, errno.EPERM):
        return f"no permission to open {path}; `labkit devices --udev` prints the rule that gives it"
    if number in (errno.EAGAIN, errno.EBUSY):
        return f"{path} is held by another program; `labkit devices` names it"
    return f"{path} does not open as a serial port: {error}"
