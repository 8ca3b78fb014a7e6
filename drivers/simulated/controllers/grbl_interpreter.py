"""Execute lines of the simulated GRBL: settings and $ commands, moves, jogs, dwells, offsets."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from labkit.drivers.grbl.protocol import HOMING_SETTING, SOFT_LIMITS
from labkit.drivers.simulated.controllers.grbl_gcode import Block, GcodeError, parse
from labkit.drivers.simulated.controllers.grbl_machine import Planned

if TYPE_CHECKING:
    from labkit.drivers.simulated.controllers.grbl_controller import GrblController

INCH_MM = 25.4


class Interpreter:
    """Modal state since the last reset, and the effects of lines on a controller."""

    def __init__(self, controller: GrblController) -> None:
        self._of = controller
        self._motion = 0
        self._incremental = False
        self._inches = False
        self._feed = 0.0
        self._then: list[str] = []

    def execute(self, line: str) -> bool:
        """Do a cleaned line; whether its `ok` is due now. Raises GcodeError."""
        if not line:
            return True
        if line.startswith("$"):
            return self._system(line[1:])
        if self._of.state in ("Alarm", "Sleep"):
            raise GcodeError(9)
        return self._gcode(parse(line))

    def after(self) -> None:
        """Send the output that follows a line's reply."""
        then = self._then
        self._then = []
        for what in then:
            if what == "reset":
                self._of.reset()
            else:
                self._of.say(what)

    def _system(self, line: str) -> bool:
        controller = self._of
        if line.startswith("J="):
            return self._jog(parse(line[2:]))
        if line in ("", "$", "#", "I", "G", "N"):
            self._tell(line)
        elif line == "X":
            if controller.state == "Alarm":
                controller.state = "Idle"
                controller.say("[MSG:Caution: Unlocked]")
        elif line == "C":
            controller.checking = not controller.checking
            controller.say("[MSG:Enabled]" if controller.checking else "[MSG:Disabled]")
            self._then += [] if controller.checking else ["reset"]
        elif line == "SLP":
            controller.state = "Sleep"
            self._then.append("[MSG:Sleeping]")
        elif line.startswith("H"):
            return self._home(line)
        else:
            self._set(line)
        return True

    def _tell(self, line: str) -> None:
        controller = self._of
        if line in ("$", "I", "#") and controller.state not in ("Idle", "Alarm"):
            raise GcodeError(8)
        if line == "":
            controller.say(
                "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
            )
        elif line == "$":
            controller.tell_settings()
        elif line == "I":
            for text in controller.firmware.about:
                controller.say(text.format(options=controller.options))
        elif line == "G":
            modes = f"G{self._motion} G54 G17 G{20 if self._inches else 21} G{91 if self._incremental else 90}"
            controller.say(f"[GC:{modes} G94 M5 M9 T0 F{self._feed:.0f} S0]")
        elif line == "#":
            self._tell_offsets()

    def _tell_offsets(self) -> None:
        zero = "0.000,0.000,0.000"
        first = ",".join(f"{mm:.3f}" for mm in self._of.offset_mm)
        for name in ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30", "G92"):
            self._of.say(f"[{name}:{first if name == 'G54' else zero}]")
        self._of.say("[TLO:0.000]")
        self._of.say(f"[PRB:{zero}:0]")

    def _home(self, line: str) -> bool:
        controller = self._of
        if not int(controller.settings[HOMING_SETTING]) & 1:
            raise GcodeError(5)
        if controller.state not in ("Idle", "Alarm"):
            raise GcodeError(8)
        if line != "H":
            # the real firmware begins to home before it finds that it does not know the rest, and stays so
            controller.state = "Home"
            controller.wedged = True
            raise GcodeError(3)
        controller.begin_homing()
        return False

    def _set(self, line: str) -> None:
        controller = self._of
        found = re.fullmatch(r"(\d+)=(-?\d+\.?\d*)", line)
        if not found or int(found[1]) not in controller.settings:
            raise GcodeError(3)
        if controller.state not in ("Idle", "Alarm"):
            raise GcodeError(8)
        number = int(found[1])
        value = float(found[2])
        if value < 0:
            raise GcodeError(4)
        if (
            number == SOFT_LIMITS
            and value
            and not int(controller.settings[HOMING_SETTING]) & 1
        ):
            raise GcodeError(10)
        controller.settings[number] = value

    def _gcode(self, block: Block) -> bool:
        g = block.g
        self._inches = 20 in g if g & {20, 21} else self._inches
        self._incremental = 91 in g if g & {90, 91} else self._incremental
        self._motion = 1 if 1 in g else 0 if 0 in g else self._motion
        if block.feed is not None:
            self._feed = block.feed * self._mm()
        if 4 in g:
            if "P" not in block.values:
                raise GcodeError(28)
            self._of.begin_dwell(block.values["P"])
            return False
        if 10 in g:
            self._offset(block)
        elif block.axes:
            self._move(block)
            return not self._of.dead
        return True

    def _offset(self, block: Block) -> None:
        """Set the work zero by G10 L2, or by the present place's reading with G10 L20."""
        controller = self._of
        if block.values.get("L") not in (2, 20):
            raise GcodeError(20)
        for axis, value in block.axes.items():
            here_mm = (
                controller.machine.end()[axis]
                if block.values["L"] == 20
                else 2 * value * self._mm()
            )
            controller.offset_mm[axis] = here_mm - value * self._mm()
        controller.offset_changed()

    def _move(self, block: Block) -> None:
        controller = self._of
        if self._motion == 1 and not self._feed:
            raise GcodeError(22)
        target = self._target(block, self._incremental)
        if controller.machine.outside(target):
            controller.refuse_move()
            return
        if not controller.checking:
            self._plan(target, None if self._motion == 0 else self._feed)

    def _jog(self, block: Block) -> bool:
        controller = self._of
        if controller.state not in ("Idle", "Jog"):
            raise GcodeError(8)
        if not block.feed:
            raise GcodeError(22)
        target = self._target(block, 91 in block.g)
        if controller.machine.outside(target):
            raise GcodeError(15)
        self._plan(target, block.feed * self._mm())
        if controller.machine.planned:
            controller.state = "Jog"
        return True

    def _target(self, block: Block, incremental: bool) -> tuple[float, ...]:
        machine = self._of.machine
        target = list(machine.end())
        for axis, value in block.axes.items():
            mm = value * self._mm()
            if 53 in block.g:
                target[axis] = mm
            elif incremental:
                target[axis] += mm
            else:
                target[axis] = mm + self._of.offset_mm[axis]
        return tuple(target)

    def _plan(self, target: tuple[float, ...], feed: float | None) -> None:
        machine = self._of.machine
        if target != machine.end():
            machine.planned.append(Planned(target, machine.speed(feed)))

    def _mm(self) -> float:
        return INCH_MM if self._inches else 1.0
