"""A Zaber stage, in its ASCII protocol: zaber:/dev/ttyUSB0, the only device on its chain, or zaber:simulated.

Rail positions are mm from the home sensor. The stage counts microsteps; their size is in
the plan. Replies carry the id of their command and a checksum, so that late, stale and
damaged ones are recognised and dropped.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from math import inf

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Travel
from labkit.drivers.serial.rail import (
    REST_TOLERANCE_MM,
    SerialRail,
    open_port,
    rail_settings,
)
from labkit.drivers.zaber.protocol import (
    FLAGS,
    REASONS,
    SPEED_UNIT,
    Reply,
    command_line,
    read_reply,
)
from labkit.errors import DeviceTimeoutError, PlanError, RailError, shown
from labkit.plan import Plan

DEVICE = 1
AXIS = 1
COMMAND_TRIES = 3
NOBODY = 99
"""Message id whose reply nobody waits for; the others are used in turn."""

REST_POLL_S = 0.05
MOVING_S = 5.0
"""Added to twice the time of a move at full speed: ramps, and settling of an encoder."""

HOMING_S = 60.0


def open_rail(address: str, plan: Plan, context: DeviceContext) -> ZaberRail:
    """Open the stage at zaber:PORT, or a simulated stage at zaber:simulated. Raises PlanError, RailError."""
    rail = rail_settings(address, plan)
    if rail.microstep_um is None:
        raise PlanError(
            "rail.microstep_um is missing: a Zaber needs it; see its data sheet, such as 0.49609375"
        )
    path, after_close = open_port(address, plan, context)
    return ZaberRail(
        path, rail.microstep_um * 1e-3, rail.run_up_mm, after_close=after_close
    )


class ZaberRail(SerialRail):
    """A Rail. The stage is looked for at once. Raises RailError, DeviceTimeoutError."""

    NAME = "the Zaber"

    def __init__(
        self,
        path: str,
        microstep_mm: float,
        run_up_mm: float = 1.0,
        reply_s: float = 1.0,
        back_s: float = 10.0,
        after_close: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(path, run_up_mm, reply_s, back_s, after_close)
        self._microstep_mm = microstep_mm
        self._number = 0
        self._speed_mm_per_s = 1.0
        self._open(self._get_to_know)

    def home(self) -> None:
        """Find the home sensor; connects again where the line was lost. Raises RailError, DeviceTimeoutError."""
        with self._lock:
            self._homed = False
            if self._wire is None:
                self._open(self._get_to_know)
            self._ask("stop")
            self._await_rest(HOMING_S, stale_faults=True)
            self._ask("warnings clear")
            self._ask("home")
            travel_mm = self._reach.high_mm - self._reach.low_mm
            self._await_rest(
                HOMING_S + 2 * travel_mm / self._speed_mm_per_s, stale_faults=True
            )
            self._check(self._ask(""))
            self._at_mm = self._position_mm()
            self._homed = True

    def stop(self) -> None:
        """Brake and stand; the position is kept. Any thread may call this.

        Raises RailError, DeviceTimeoutError.
        """
        if self._wire is None:
            return
        self._stopping = True
        try:
            self._send(command_line(DEVICE, AXIS, NOBODY, "stop"))
            with self._lock:
                self._ask("stop")
                self._await_rest(self._reply_s + MOVING_S, stale_faults=True)
                self._homed = not self._ask("").is_fault
                self._at_mm = self._position_mm()
        finally:
            self._stopping = False

    def close(self) -> None:
        """Stop and release the stage; again does nothing."""
        if self._wire is not None:
            with contextlib.suppress(RailError):
                self._send(command_line(DEVICE, AXIS, NOBODY, "stop"))
        super().close()

    def _check_ready(self) -> None:
        if not self._homed:
            raise RailError(f"{self} does not know where it is; home it first")
        self._check_in_place(self._at_mm, "was left at")

    def _approach(self, position_mm: float) -> float:
        for stop_mm in (position_mm - self._run_up_mm, position_mm):
            self._refuse_stopped()
            distance_mm = abs(stop_mm - self._at_mm)
            self._homed = False  # until it is known to have arrived
            self._ask(f"move abs {round(stop_mm / self._microstep_mm)}")
            self._await_rest(MOVING_S + 2 * distance_mm / self._speed_mm_per_s)
            self._homed = True
            self._at_mm = self._check_in_place(stop_mm, "was sent to")
        return self._at_mm

    def _get_to_know(self) -> None:
        """Read limits and speed. Raises RailError for limits without room to move."""
        low, high, speed = (
            self._number_of(name) for name in ("limit.min", "limit.max", "maxspeed")
        )
        if not 0 < speed < inf:
            raise RailError(
                f"{self} has maxspeed = {speed:g}; allowed is above 0: set maxspeed"
            )
        self._speed_mm_per_s = speed / SPEED_UNIT * self._microstep_mm
        try:
            self._reach = Travel(low * self._microstep_mm, high * self._microstep_mm)
            _ = self.travel_mm
        except ValueError as error:
            raise RailError(
                f"{self} has limits that leave no room to move; check rail.microstep_um"
            ) from error

    def _number_of(self, setting: str) -> float:
        data = self._ask(f"get {setting}").data
        try:
            return float(data)
        except ValueError:
            raise RailError(
                f"{self} reports {setting} = {shown(data)}, which is no number; look at its axis and its firmware"
            ) from None

    def _position_mm(self) -> float:
        return self._number_of("pos") * self._microstep_mm

    def _check_in_place(self, wanted_mm: float, why: str) -> float:
        """Return the measured position; raise an error unless it is the expected one."""
        self._check(self._ask(""))
        at_mm = self._position_mm()
        if abs(at_mm - wanted_mm) > REST_TOLERANCE_MM:
            if self._stopping:
                self._at_mm = at_mm
                raise RailError(
                    f"{self} was stopped at {at_mm:.3f} mm, on its way to {wanted_mm:.3f} mm"
                )
            raise self._lost(f"{why} {wanted_mm:.3f} mm and stands at {at_mm:.3f} mm")
        return at_mm

    def _check(self, reply: Reply) -> None:
        if reply.is_fault:
            raise self._lost(
                f"warns {reply.flag}: {FLAGS.get(reply.flag, 'see its manual')}"
            )

    def _await_rest(self, within_s: float, stale_faults: bool = False) -> None:
        """Wait for rest. stale_faults: whether earlier warnings are ignored at first."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            reply = self._ask("")
            if not stale_faults:
                self._check(reply)
            if not reply.busy:
                return
            time.sleep(REST_POLL_S)
        self._homed = False
        raise DeviceTimeoutError(f"{self} still moved after {within_s:.0f} s; home it")

    def _ask(self, command: str) -> Reply:
        """Return the reply to a command, which is sent again without a reply. Raises RailError,
        DeviceTimeoutError.
        """
        for _ in range(COMMAND_TRIES):
            self._number = (self._number + 1) % NOBODY
            self._send(command_line(DEVICE, AXIS, self._number, command))
            reply = self._hear(self._number)
            if reply and reply.accepted:
                return reply
            if reply:
                self._homed = False
                raise RailError(
                    f'{self} refused "{command}": {REASONS.get(reply.data, reply.data)}; home it'
                )
        self._homed = False
        raise DeviceTimeoutError(
            f"{self} does not answer at {self.BAUD} baud; look at its power and its cable"
        )

    def _hear(self, number: int) -> Reply | None:
        """Return the reply with this id, if it comes in time; drop all others."""
        deadline_s = time.monotonic() + self._reply_s
        while (line := self._line(deadline_s)) is not None:
            reply = read_reply(line)
            if reply and (reply.device, reply.axis, reply.number) == (DEVICE, AXIS, number):
                return reply
        return None
