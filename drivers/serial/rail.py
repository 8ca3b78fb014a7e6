"""The common base of rails on a serial line: the line, reopened after a loss; travel; trust in the position."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import ClosesItself, Travel
from labkit.devices.registry import open_controller
from labkit.drivers.serial.wire import SerialWire
from labkit.errors import PlanError, RailError, RailLimitError
from labkit.plan import Plan, RailSettings

REST_TOLERANCE_MM = 0.02
"""Rounding to steps moves a stop by less; a carriage farther away than this is not where it was sent."""


def rail_settings(address: str, plan: Plan) -> RailSettings:
    """Return the [rail] of a plan whose address names a port, such as grbl:/dev/ttyUSB0. Raises PlanError."""
    driver, _, path = address.partition(":")
    if plan.rail is None or not path:
        raise PlanError(
            f'rail.address = "{address}": give the port as well, such as {driver}:/dev/ttyUSB0'
        )
    return plan.rail


def open_port(
    address: str, plan: Plan, context: DeviceContext
) -> tuple[str, Callable[[], None]]:
    """Return the port's device file, and a function to call after use; grbl:simulated starts a simulated
    controller.

    Raises PlanError.
    """
    path = address.partition(":")[2]
    if path != "simulated":
        return path, lambda: None
    controller = open_controller(address, plan, context)
    return controller.path, controller.close


class SerialRail(ClosesItself):
    """A line at `path`, opened by `_open`; any fault of the line raises RailError and closes it.

    The rail must be homed before it moves, and again whenever its position is in doubt.
    run_up_mm: each stop is approached upward over this distance, to remove backlash.
    reply_s: longest silence. back_s: wait for an unplugged port; at the first opening the
    port must be there. after_close: releases other parts.
    """

    NAME: ClassVar[str]
    BAUD: ClassVar[int] = 115_200

    def __init__(
        self,
        path: str,
        run_up_mm: float,
        reply_s: float,
        back_s: float,
        after_close: Callable[[], None],
    ) -> None:
        self._path = path
        self._run_up_mm = run_up_mm
        self._reply_s = reply_s
        self._back_s = back_s
        self._opened_before = False
        self._after_close = after_close
        self._wire: SerialWire | None = None
        self._lock = threading.RLock()
        self._homed = False
        self._stopping = False  # another thread has ordered a stop
        self._at_mm = 0.0
        self._reach = Travel(0.0, 1.0)

    @property
    def travel_mm(self) -> Travel:
        """Positions within the controller's own limits that can be approached from below."""
        return Travel(self._reach.low_mm + self._run_up_mm, self._reach.high_mm)

    def move_to(self, position_mm: float) -> float:
        """Approach a position from below, and return the position in mm that the controller reports at rest.

        Raises RailLimitError outside the travel; RailError when the position is unknown, or
        was lost; DeviceTimeoutError.
        """
        travel = self.travel_mm
        if not travel.low_mm <= position_mm <= travel.high_mm:
            raise RailLimitError(
                f"{position_mm:.3f} mm is outside {travel.low_mm:g}..{travel.high_mm:g} mm"
            )
        with self._lock:
            self._check_ready()
            return self._approach(position_mm)

    def check_still(self) -> None:
        """Raise RailError if the rail moved since the last move ended; DeviceTimeoutError without an answer."""
        with self._lock:
            self._check_ready()

    def close(self) -> None:
        """Let the rail go; again does nothing."""
        self._hang_up()
        self._after_close()

    def __str__(self) -> str:
        return f"{self.NAME} at {self._path}"

    def _open(self, begin: Callable[[], None]) -> None:
        """Open the line and run the first commands; close the line again if they fail."""
        self._wire = SerialWire(
            self._path, self.BAUD, self._back_s if self._opened_before else 0.0
        )
        try:
            begin()
        except BaseException:
            self._hang_up()
            raise
        self._opened_before = True

    def _refuse_stopped(self) -> None:
        """Raise if a stop was ordered before anything moved, which the controller would not know of."""
        if self._stopping:
            raise RailError(f"{self} was stopped before it moved")

    @abstractmethod
    def _check_ready(self) -> None:
        """Raise an error if the carriage's place is unknown."""

    @abstractmethod
    def _approach(self, position_mm: float) -> float:
        """Approach a position within the travel from below, and return the measured position."""

    def _send(self, data: bytes) -> None:
        try:
            self._connected().send(data)
        except RailError:
            self._hang_up()
            raise

    def _line(self, deadline_s: float) -> str | None:
        """Return the next line, or None at the deadline."""
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
        """Return the error for a carriage at an unknown place."""
        self._homed = False
        return RailError(f"{self} {reason}; its position is lost: home it")
