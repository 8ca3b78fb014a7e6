"""A Zaber stage without hardware, behind a real pseudo-terminal; Zaber's own library drives it as well.

As rail.address = "zaber:simulated" it replaces a rail; `python -m
labkit.drivers.simulated.controllers.zaber` serves a stage.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated.controllers.motion import Braking, Move
from labkit.drivers.simulated.controllers.pty_port import PtyPort
from labkit.drivers.simulated.controllers.serve import carrying, rail_of, serve
from labkit.drivers.zaber.protocol import SPEED_UNIT, checksum
from labkit.plan import Plan

COMMAND_LINE = re.compile(
    r"/(?P<device>\d+)?(?: ?(?P<axis>\d))?(?: (?P<id>\d\d))?(?: ?(?P<command>[a-z].*))?"
)

OF_DEVICE = {
    "deviceid": "50081",
    "system.serial": "99999",
    "version": "7.38",
    "version.build": "12345",
    "system.axiscount": "1",
}
OF_AXIS = {"peripheralid": "0"}


class ZaberController:
    """A device with one axis, in its own time. Positions in microsteps, speed in microsteps/s.

    The carriage is truly `slip` beyond the position; homing makes the slip zero. `moved` is
    called with the true place at rest.
    """

    def __init__(
        self,
        reach: int = 305_381,
        speed: float = 40_000.0,
        carriage: int = 60_000,
        acceleration: float = 200_000.0,
    ) -> None:
        self.noticed: Callable[[str], None] = lambda command: None
        self.moved: Callable[[float], None] = lambda carriage: None
        self.stale_reply = b"@01 1 98 OK IDLE -- 0:FF\r\n"
        self.reach = reach
        self.speed = speed
        self.acceleration = acceleration
        self.now_s = 0.0
        self.position = 0.0
        self.slip = float(carriage)
        self.flag = "WR"
        self._motion: Move | Braking | None = None
        self._homing = False
        self._typed = bytearray()
        self._said = bytearray()

    def power_on(self) -> None:
        """Begin as after a power cut: counted from zero, without a reference."""
        carriage = self.carriage
        self.position = 0.0
        self.slip = carriage
        self.flag = "WR"
        self._motion = None
        self._homing = False
        self._typed.clear()

    def receive(self, data: bytes) -> None:
        """Take in bytes now."""
        self._typed += data
        *lines, rest = re.split(rb"\r\n|\n|\r", bytes(self._typed))
        self._typed = bytearray(rest)
        for line in lines:
            self._take(line.decode("latin-1"))

    def advance(self, now_s: float) -> bytes:
        """Run all events up to a time, and return the output."""
        if self._motion is not None and self._motion.end_s <= now_s:
            self._arrive()
        self.now_s = now_s
        said = bytes(self._said)
        self._said.clear()
        return said

    def due_s(self) -> float | None:
        """Return the time when the present motion ends."""
        return self._motion.end_s if self._motion else None

    def strike(self, trouble: str) -> None:
        """Cause trouble: reboot or reset (power cut), alarm (a stall), slip (by 6000 microsteps)."""
        if trouble in ("reboot", "reset"):
            self.power_on()
        elif trouble == "alarm":
            self.slip += 500 if self._motion else 0
            self.position = self._place()
            self._motion = None
            self._homing = False
            self.flag = "FS"
        else:
            self.slip += 6000
        self.moved(self.carriage)

    @property
    def carriage(self) -> float:
        """True place of the carriage."""
        return self._place() + self.slip

    def _place(self) -> float:
        if self._motion is None:
            return self.position
        if isinstance(self._motion, Braking):
            return self._motion.position(self.now_s)[0]
        return self._motion.at(self._motion.along(self.now_s)[0])[0]

    def _arrive(self) -> None:
        self.now_s = self._motion.end_s if self._motion else self.now_s
        self.position = self._place()
        self._motion = None
        if self._homing:
            self.position = 0.0
            self.slip = 0.0
            self.flag = "--"
            self._homing = False
        self.moved(self.carriage)

    def _take(self, line: str) -> None:
        text, colon, check = line.partition(":")
        found = COMMAND_LINE.fullmatch(text.strip())
        if not found or (colon and check != checksum(text)):
            return
        if int(found["device"] or 0) not in (0, 1):
            return
        command = (found["command"] or "").strip()
        self.noticed(command)
        axis = int(found["axis"] or 0)
        verdict, data = self._do(axis, command)
        number = f"{found['id']} " if found["id"] else ""
        state = "IDLE" if self._motion is None else "BUSY"
        flag = (
            "--" if self._homing else self.flag
        )  # as recorded; a search that is broken off shows it again
        reply = f"@01 {axis} {number}{verdict} {state} {flag} {data}"
        whole = f"{reply}:{checksum(reply)}\r\n" if colon else f"{reply}\r\n"
        self._said += whole.encode()
        self.stale_reply = whole.encode()

    def _do(self, axis: int, command: str) -> tuple[str, str]:
        """Return verdict and data of a command."""
        words = command.split()
        match words:
            case []:
                return "OK", "0"
            case ["get", name]:
                data = self._get(axis, name)
                return ("OK", data) if data is not None else ("RJ", "BADCOMMAND")
            case ["home"]:
                self._go(-self.slip)
                self._homing = True
                if self._motion is None:
                    self._arrive()
            case ["move", kind, value] if kind in ("abs", "rel") and re.fullmatch(
                r"-?\d+", value
            ):
                target = int(value) + (self._place() if kind == "rel" else 0)
                if not 0 <= target <= self.reach:
                    return "RJ", "BADDATA"
                self._go(target)
            case ["stop"] | ["estop"]:
                if isinstance(self._motion, Move):
                    self._motion = Braking(self._motion, self.now_s)
                    self._homing = False
            case ["warnings"]:
                return "OK", "00" if self.flag == "--" else f"01 {self.flag}"
            case ["warnings", "clear"]:
                answer = "00" if self.flag == "--" else f"01 {self.flag}"
                self.flag = "WR" if self.flag == "FS" else self.flag
                return "OK", answer
            case _:
                return "RJ", "BADCOMMAND"
        return "OK", "0"

    def _go(self, target: float) -> None:
        self.position = self._place()
        self._motion = None
        self._homing = False
        if target != self.position:
            self._motion = Move(
                (self.position,),
                (float(target),),
                self.now_s,
                self.speed,
                self.acceleration,
            )

    def _get(self, axis: int, name: str) -> str | None:
        settings = (
            OF_DEVICE
            | OF_AXIS
            | {
                "pos": f"{self._place():.0f}",
                "limit.min": "0",
                "limit.max": str(self.reach),
                "maxspeed": f"{self.speed * SPEED_UNIT:.0f}",
            }
        )
        return None if axis and name in OF_DEVICE else settings.get(name)


def simulated_port(address: str, plan: Plan, context: DeviceContext) -> PtyPort:
    """Return a stage whose travel covers the plan's stations; it moves the context's simulated bench, if any."""
    rail = rail_of(address, plan)
    assert rail.microstep_um is not None  # the driver has refused a plan without it
    microstep_mm = rail.microstep_um * 1e-3
    stations_mm = [rail.position_mm(range_mm) for range_mm in rail.ranges_mm]
    reach = round((max(*stations_mm, 50.0) + 10.0) / microstep_mm)
    controller = ZaberController(reach, speed=50.0 / microstep_mm, carriage=reach // 5)
    carry = carrying(context)
    controller.moved = lambda carriage: carry(carriage * microstep_mm)
    return PtyPort(controller)


def main() -> None:
    """Serve a stage until Ctrl-C."""
    serve(PtyPort(ZaberController()))


if __name__ == "__main__":
    main()
