"""A simulated GRBL 1.1 or grblHAL controller in its own time: bytes in, bytes out, without a port.

The answers follow recordings of the real firmwares: `ok` when a line is queued, silence
while homing and after a soft limit until a reset, alarms after a reset in motion, work
offsets and overrides in some reports only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

from labkit.drivers.grbl.protocol import (
    HAL_OFFSET,
    HAL_ORIGIN_AT_HOME,
    HARD_LIMITS,
    HOMING_SETTING,
)
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, Firmware
from labkit.drivers.simulated.controllers.grbl_gcode import GcodeError, clean
from labkit.drivers.simulated.controllers.grbl_interpreter import Interpreter
from labkit.drivers.simulated.controllers.grbl_machine import Machine
from labkit.drivers.simulated.controllers.motion import Braking

RESET_CODE = 0x18
ASK_CODE = 0x3F
HOLD_CODE = 0x21
RESUME_CODE = 0x7E
CANCEL_JOG = 0x85
MOVE_START_S = 0.001
"""Between the ok of a move and its start: a report then still says Idle."""

UNLOCK = "[MSG:'$H'|'$X' to unlock]"
REFRESH = {"WCO": (9, 29), "Ov": (9, 19)}
"""Reports without a field between two with it: at rest, in motion. By GRBL's config.h."""


class GrblController:
    """A controller with settings and firmware, a true place of the carriage at power-up, and a home switch.

    limit_alarm: 1 stops everything until a reset, like the firmware on a microcontroller; 3
    is a reset in motion, recorded from the firmware compiled for a computer. blank: whether
    settings were never stored. `noticed` is called with each received line and real-time
    command, `moved` with the true place of the carriage at rest.
    """

    def __init__(
        self,
        firmware: Firmware = GRBL,
        settings: Mapping[int, float] | None = None,
        options: str = "V",
        carriage_mm: float = -50.0,
        switch_works: bool = True,
        limit_alarm: int = 1,
        blank: bool = False,
    ) -> None:
        self.firmware = firmware
        self.settings = {
            number: float(text) for number, text in firmware.defaults.items()
        } | dict(settings or {})
        origin = (
            int(self.settings[HOMING_SETTING]) & HAL_ORIGIN_AT_HOME
            if firmware.is_hal
            else "Z" in options
        )
        self.machine = Machine(
            self.settings, bool(origin), carriage_mm, switch_works, firmware.is_hal
        )
        self.options = options
        self.limit_alarm = limit_alarm
        self._blank = blank
        self.noticed: Callable[[str], None] = lambda command: None
        self.moved: Callable[[float], None] = lambda carriage_mm: None
        self.stale_reply = b"ok\r\n"
        self.now_s = 0.0
        self.state = "Idle"
        self.dead = False
        self.wedged = False
        self.checking = False
        self.offset_mm = [0.0, 0.0, 0.0]
        self._said = bytearray()
        self._typed = bytearray()
        self._lines: deque[str] = deque()
        self._asked = False
        self._refused = False
        self._due_s: float | None = None
        self._start_s: float | None = None
        self._began_s = 0.0
        self._dwell_s: float | None = None
        self._until_refresh = dict.fromkeys(REFRESH, 0)
        self._interpreter = Interpreter(self)

    def power_on(self) -> None:
        """Begin as after a power cut: counted from zero, locked if homing is required."""
        self.machine.forget(self.now_s)
        locks = int(self.settings[HOMING_SETTING]) & (4 if self.firmware.is_hal else 1)
        self._forget("Alarm" if locks else "Idle")
        if self._blank:
            self.say("error:7")
            if not self.firmware.is_hal:
                self.tell_settings()
        self._greet()

    def tell_settings(self) -> None:
        """Send all settings, in answer to $$."""
        for number, value in sorted(self.settings.items()):
            self.say(f"${number}={self.firmware.show(number, value)}")

    def receive(self, data: bytes) -> None:
        """Take in bytes now. Real-time commands act at once, wherever they stand."""
        for byte in data:
            if byte in (RESET_CODE, ASK_CODE, HOLD_CODE, RESUME_CODE, CANCEL_JOG):
                self.noticed(chr(byte))
                self._at_once(byte)
            elif byte in b"\r\n":
                line = self._typed.decode("latin-1")
                self._typed.clear()
                self.noticed(line)
                self._lines.append(line)
            elif byte < 0x80:
                self._typed.append(byte)
        self._work()

    def advance(self, now_s: float) -> bytes:
        """Run all events up to a time, and return the output."""
        while (due_s := self.due_s()) is not None and due_s <= now_s:
            self.now_s = due_s
            self._happen()
            self._work()
        self.now_s = now_s
        said = bytes(self._said)
        self._said.clear()
        return said

    def due_s(self) -> float | None:
        """Return the time of the next event."""
        motion = self.machine.motion
        times = [
            self._due_s,
            self._start_s,
            motion.end_s if motion else None,
            self._trip_s(),
        ]
        return min((time for time in times if time is not None), default=None)

    def say(self, text: str) -> None:
        """Send a line."""
        self._said += f"{text}\r\n".encode()

    def limit(self) -> None:
        """Trip the limit switch."""
        if self.limit_alarm == 3:
            self.reset(moving=True)
            return
        self.machine.cut_off(self.now_s)
        self.moved(self.machine.carriage_mm(self.now_s))
        self.critical(1)

    def critical(self, alarm: int) -> None:
        """Raise an alarm that stops all answers until a reset."""
        self.state = "Alarm"
        self.dead = True
        self._due_s = self._start_s = None
        self.say(f"ALARM:{alarm}")
        self.say("[MSG:Reset to continue]")

    def refuse_move(self) -> None:
        """Apply soft limits: the line stays unanswered, and only a reset brings its ok, too late."""
        self._refused = True
        self.critical(2)

    def strike(self, trouble: str) -> None:
        """Cause trouble: reboot (power cut), reset (the button), alarm (the limit switch), slip (by 3 mm)."""
        match trouble:
            case "reboot":
                self.power_on()
            case "reset":
                self.reset()
            case "alarm":
                self.limit()
            case "slip":
                self.machine.slip_mm += 3.0  # the carriage slides, unseen by the firmware
                self.moved(self.machine.carriage_mm(self.now_s))

    def reset(self, moving: bool | None = None) -> None:
        """Reset softly, by the line or by a button."""
        homing = self.state == "Home"
        if moving is None:
            moving = self.state in ("Run", "Jog") or isinstance(
                self.machine.motion, Braking
            )
        if homing and not self.wedged:
            self.machine.homing_cut_off(self.now_s - self._began_s)
        if homing or (moving and not self.firmware.is_hal):
            self.say(f"ALARM:{6 if homing else 3}")
        self.machine.cut_off(self.now_s)
        self.moved(self.machine.carriage_mm(self.now_s))
        if self._refused or self._dwell_s is not None or (homing and not self.wedged):
            self.say("ok")  # of the line that was being executed
        locked = (
            homing
            or (moving and not self.firmware.is_hal)
            or self.state in ("Alarm", "Sleep")
        )
        self._forget("Alarm" if locked else "Idle")
        self._greet()

    def has_room(self) -> bool:
        """Return whether another move can be queued."""
        return len(self.machine.planned) < self.firmware.blocks

    def begin_homing(self) -> None:
        """Search for the switch; the line's ok comes with the switch."""
        self.state, self._began_s = "Home", self.now_s
        self._due_s = self.now_s + (
            self.machine.homing_s()
            if self.machine.switch_works
            else self.machine.search_s()
        )

    def begin_dwell(self, seconds: float) -> None:
        """Wait for all motion, and then as long again; the line's ok comes then."""
        self._dwell_s = seconds

    def _at_once(self, byte: int) -> None:
        if byte == RESET_CODE:
            self.reset()
        elif self.dead:
            return
        elif byte == ASK_CODE:
            if self.state == "Home" and not self.wedged and not self.firmware.is_hal:
                self._asked = True
            else:
                self._report()
        elif byte == HOLD_CODE and self.state in ("Idle", "Run"):
            self.state = "Hold"
            self.machine.brake(self.now_s)
        elif byte == RESUME_CODE and self.state == "Hold" and self.machine.motion is None:
            self.state = "Idle"
        elif byte == CANCEL_JOG and self.state == "Jog":
            self.machine.brake(self.now_s)

    def _work(self) -> None:
        """Execute the next lines, and start planned moves."""
        while True:
            if self.machine.planned and self.machine.motion is None:
                self._set_out()
            if self._dwell_s is not None and not (
                self.machine.planned or self._due_s or self.dead
            ):
                self._due_s = self.now_s + self._dwell_s
            waits = self._dwell_s is not None or (self.state == "Home" and not self.wedged)
            if (
                not self._lines
                or self.dead
                or waits
                or self.state == "Sleep"
                or not self.has_room()
            ):
                return
            self._answer(self._lines.popleft())

    def _set_out(self) -> None:
        """Begin the next planned move: at once after another or as a jog, else a moment later."""
        if self.state == "Idle":
            self._start_s = self._start_s or self.now_s + MOVE_START_S
        elif self.state in ("Run", "Jog"):
            self.machine.start(self.now_s)

    def _answer(self, line: str) -> None:
        try:
            done = self._interpreter.execute(clean(line))
        except GcodeError as error:
            self.say(str(error))
        else:
            if done:
                self.say("ok")
        self._interpreter.after()

    def _happen(self) -> None:
        """Run the event that is due."""
        if self._due_s is not None and self._due_s <= self.now_s:
            self._due_s = None
            if self.dead:
                self._forget("Alarm")
                self._greet()
            elif self.state == "Home":
                self._end_homing()
            elif self._dwell_s is not None:
                self._dwell_s = None
                self.say("ok")
        elif self._start_s is not None and self._start_s <= self.now_s:
            self._start_s = None
            self.state = (
                "Run" if self.state == "Idle" and self.machine.planned else self.state
            )
        elif (trip_s := self._trip_s()) is not None and trip_s <= self.now_s:
            self.limit()
        elif self.machine.motion is not None and self.machine.motion.end_s <= self.now_s:
            self.machine.arrive(self.now_s)
            self.moved(self.machine.carriage_mm(self.now_s))
            if self.state == "Jog" and self.machine.planned:  # a cancelled jog is dropped
                self.machine.planned.clear()
            if not self.machine.planned and self.state != "Hold":
                self.state = "Idle"

    def _trip_s(self) -> float | None:
        return (
            self.machine.trips_s() if self.settings[HARD_LIMITS] and not self.dead else None
        )

    def _end_homing(self) -> None:
        if not self.machine.switch_works:
            self.machine.position = (-1.5 * self.settings[130], *self.machine.position[1:])
            self.say("ALARM:9")
            self.state, self.dead, self._due_s = "Alarm", True, self.now_s + 0.1
            return
        self.machine.homed(self.firmware.homed_axes)
        self.moved(self.machine.carriage_mm(self.now_s))
        if self._asked:
            self._report()
        self.state = "Idle"
        self.say("ok")

    def _forget(self, state: str) -> None:
        """Clear the state that a reset clears."""
        self.state = state
        self.dead = False
        self.wedged = False
        self.checking = False
        self._typed.clear()
        self._lines.clear()
        self._asked = False
        self._refused = False
        self._due_s = None
        self._start_s = None
        self._dwell_s = None
        self._until_refresh = dict.fromkeys(REFRESH, 0)
        self._interpreter = Interpreter(self)

    def _greet(self) -> None:
        self.say("")
        self.say(self.firmware.banner)
        if self.settings[HARD_LIMITS] and self.machine.on_switch(self.now_s):
            self.state = "Alarm"
            self.say("[MSG:Check Limits]")
        if self.state == "Alarm":
            self.say(UNLOCK)

    def _report(self) -> None:
        self._asked = False
        machine = self.machine
        moving = self.state in ("Run", "Jog", "Home", "Hold")
        state = (
            f"Hold:{int(machine.motion is not None)}"
            if self.state == "Hold"
            else self.state
        )
        place = machine.place(self.now_s)
        mask = int(self.settings[10])
        if mask & 1:
            fields = [state, f"MPos:{_axes(place)}"]
        else:
            fields = [
                state,
                f"WPos:{_axes([mm - off for mm, off in zip(place, self.offset_mm, strict=True)])}",
            ]
        if mask & 2:
            waiting = len(self._typed) + sum(len(line) + 1 for line in self._lines)
            fields.append(
                f"Bf:{self.firmware.blocks - len(machine.planned)},{self.firmware.room - waiting}"
            )
        running = machine.planned and self.state in ("Run", "Jog", "Home")
        fields.append(f"FS:{machine.planned[0].speed * 60:.0f},0" if running else "FS:0,0")
        if machine.on_switch(self.now_s):
            fields.append("Pn:X")
        if self._turn("WCO", moving) and (mask & HAL_OFFSET or not self.firmware.is_hal):
            # GRBL puts the two into different reports
            self._until_refresh["Ov"] = max(self._until_refresh["Ov"], 1)
            fields.append(f"WCO:{_axes(self.offset_mm)}")
        if self._turn("Ov", moving):
            fields.append("Ov:100,100,100" + ("|A:|TLR:0" if self.firmware.is_hal else ""))
        self.say(f"<{'|'.join(fields)}>")

    def offset_changed(self) -> None:
        """Include the work offset in the next report."""
        self._until_refresh["WCO"] = 0

    def _turn(self, name: str, moving: bool) -> bool:
        """Return whether a field stands in this report."""
        if self._until_refresh[name]:
            self._until_refresh[name] -= 1
            return False
        self._until_refresh[name] = REFRESH[name][moving]
        return True


def _axes(values: tuple[float, ...] | list[float]) -> str:
    return ",".join(f"{value:.3f}" for value in values)
