"""What all rails on a serial line share: the line, found again after it was lost, and whether the position is known."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from labkit.drivers.serial_wire import SerialWire
from labkit.errors import RailError


class SerialRail:
    """A line at `path`, opened by `_open`; whatever breaks it is told as RailError and closes it.

    name: what it is called in messages. back_s: how long a port that was unplugged is waited for; the first time it has
    to be there. after_close: what else is to be let go.
    """

    def __init__(self, name: str, path: str, baud: int, back_s: float, after_close: Callable[[], None]) -> None:
        self._name = name
        self._path = path
        self._baud = baud
        self._back_s = back_s
        self._opened_before = False
        self._after_close = after_close
        self._wire: SerialWire | None = None
        self._lock = threading.RLock()
        self._homed = False

    def close(self) -> None:
        """Let the rail go; again does nothing."""
        self._hang_up()
        self._after_close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __str__(self) -> str:
        return f"{self._name} at {self._path}"

    def _open(self, begin: Callable[[], None]) -> None:
        """Open the line and do what has to be done first; closes it again if that fails."""
        self._wire = SerialWire(self._path, self._baud, self._back_s if self._opened_before else 0.0)
        try:
            begin()
        except BaseException:
            self._hang_up()
            raise
        self._opened_before = True

    def _send(self, data: bytes) -> None:
        try:
            self._connected().send(data)
        except RailError:
            self._hang_up()
            raise

    def _line(self, deadline_s: float) -> str | None:
        """The next line, or None at the deadline."""
        try:
            return self._connected().line(deadline_s)
        except RailError:
            self._hang_up()
            raise

    def _connected(self) -> SerialWire:
        if self._wire is None:
            raise RailError(f"{self} is not connected; home it")
        return self._wire

    def _hang_up(self) -> None:
        self._homed = False
        if self._wire is not None:
            self._wire.close()
        self._wire = None

    def _lost(self, reason: str) -> RailError:
        """The error to raise when the carriage may stand anywhere."""
        self._homed = False
        return RailError(f"{self} {reason}; its position is lost: home it")
