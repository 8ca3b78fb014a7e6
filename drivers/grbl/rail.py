"""A rail on a GRBL 1.1 or grblHAL controller: grbl:/dev/ttyUSB0, or grbl:simulated.

Rail positions are X in machine coordinates, in mm: negative everywhere, unless zero is set
where the machine is homed.

An `ok` means "queued", may come late, and after a reset may belong to an old line: no
decision rests on an `ok`. A group of lines is done when the parser state, requested after
them by $G, arrives: GRBL works line by line, and a dwell before the request waits for all
motion. The carriage's place is taken from two equal Idle reports afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Check
from labkit.drivers.grbl import protocol as grbl
from labkit.drivers.serial.rail import (
    REST_TOLERANCE_MM,
    SerialRail,
    open_port,
    rail_settings,
)
from labkit.errors import LONGEST_VALUE, DeviceTimeoutError, RailError
from labkit.plan import Plan

BANNER_QUIET_S = 0.1
"""After a banner, a controller that says nothing for so long has said all."""

REPORT_POLL_S = 0.1

RESET_BYTE = b"\x18"
HOLD_BYTE = b"!"
ASK_BYTE = b"?"
STOPPED = ("Hold", "Door", "Sleep")
STANDING = ("Idle", "Hold:0", "Alarm", "Sleep")
"""States in which nothing moves; Hold:1 is still braking."""

STEPS_KEPT = ("Idle", "Hold:0")
"""States in which a soft reset loses no steps."""


def open_rail(address: str, plan: Plan, context: DeviceContext) -> GrblRail:
    """Open the rail at grbl:PORT, or a simulated controller at grbl:simulated. Raises PlanError, RailError."""
    rail = rail_settings(address, plan)
    path, after_close = open_port(address, plan, context)
    return GrblRail(path, rail.run_up_mm, after_close=after_close)


class GrblRail(SerialRail):
    """A Rail, Checkable. The controller is woken and checked at once. Raises RailError, DeviceTimeoutError."""

    NAME = "the GRBL rail"

    def __init__(
        self,
        path: str,
        run_up_mm: float = 1.0,
        reply_s: float = 3.0,
        back_s: float = 10.0,
        after_close: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(path, run_up_mm, reply_s, back_s, after_close)
        self._under_way = False  # lines were sent whose end was not seen
        self._homing = False
        self._offset_mm: float | None = None
        self._settings: dict[int, float] = {}
        self._wake()

    def check(self, frames: int) -> Check:
        """List settings that differ from docs/guides/bench.md, for the user to check."""
        return Check(
            (), tuple(f"the rail's {words}" for words in grbl.doubts(self._settings))
        )

    def home(self) -> None:
        """Find the zero at the limit switch; connects again where the line was lost, clears alarms.

        Raises RailError, DeviceTimeoutError.
        """
        with self._lock:
            self._homed = False
            self._wake()
            self._homing = True
            self._search()
            # a stale ok ends the search too soon for us; what follows is done only after it
            self._carry_out(["G21 G90 G94"], grbl.homing_s(self._settings), watch=False)
            self._homing = False
            self._at_mm = self._rest()
            self._homed = True

    def stop(self) -> None:
        """Hold the feed, then drop queued lines. A carriage that came to rest in hold keeps its position.

        Any thread may call this. Raises RailError, DeviceTimeoutError.
        """
        if self._wire is None:
            return
        self._stopping = True
        try:
            self._send(RESET_BYTE if self._homing else HOLD_BYTE)
            with self._lock:
                # to reset what still rolls loses steps, and Idle afterwards does not prove that it did not
                self._homed = self._homed and not self._homing and self._has_braked()
                self._reset()
                if self._homed:
                    self._at_mm = self._rest()
        finally:
            self._stopping = False

    def close(self) -> None:
        """Stop all motion and release the rail; again does nothing."""
        try:
            if self._under_way:
                self.stop()
        except (RailError, DeviceTimeoutError):
            pass  # it is being let go because of trouble; that trouble is what is raised
        finally:
            super().close()

    def _has_braked(self) -> bool:
        """Return whether a feed hold has brought the carriage to rest without loss."""
        try:
            within_s = self._reply_s + grbl.moving_s(self._settings, 0.0)
            report = self._report(within_s, STANDING, in_hold=True)
        except RailError:
            return False
        return report is not None and report.state in STEPS_KEPT

    def _approach(self, position_mm: float) -> float:
        below_mm = position_mm - self._run_up_mm
        allowed_s = grbl.moving_s(
            self._settings, abs(below_mm - self._at_mm) + self._run_up_mm
        )
        moves = [f"G53 G0 X{mm:.4f}" for mm in (below_mm, position_mm)]
        self._refuse_stopped()
        self._carry_out([*moves, "G4 P0.01"], 2 * allowed_s)
        at_mm = self._rest()
        if abs(at_mm - position_mm) > REST_TOLERANCE_MM:
            raise self._lost(
                f"was sent to {position_mm:.3f} mm and stands at {at_mm:.3f} mm"
            )
        self._at_mm = at_mm
        return at_mm

    def _check_ready(self) -> None:
        if self._homed and not self._under_way:
            self._hear_out()
        if not self._homed or self._under_way:
            raise RailError(f"{self} does not know where it is; home it first")
        at_mm = self._rest()
        if abs(at_mm - self._at_mm) > REST_TOLERANCE_MM:
            raise self._lost(
                f"was left at {self._at_mm:.3f} mm and now reports {at_mm:.3f} mm"
            )

    def _wake(self) -> None:
        """Bring the controller to a known state with an empty queue."""
        if self._wire is None:
            self._open(self._begin)
        else:
            self._reset()

    def _begin(self) -> None:
        self._reset()
        self._get_to_know()

    def _search(self) -> None:
        """Home, and send nothing else before the ok.

        grblHAL may drop other lines meanwhile, and GRBL answers no "?".
        """
        self._under_way = True
        self._send(b"$H\n")
        deadline_s = time.monotonic() + grbl.homing_s(self._settings) + self._reply_s
        while (line := self._line(deadline_s)) != "ok":
            if line is None:
                raise DeviceTimeoutError(
                    f"{self} did not finish homing in time; look whether it can move, then home it"
                )
            self._note(line)

    def _reset(self) -> None:
        """Reset softly. Queued lines, and pending replies, end with the banner in answer.

        An Arduino restarts when its port is opened and sleeps through the reset; its own
        banner comes instead. A controller that was slow, and not asleep, answers the
        second reset too: its banner is awaited: later it would look like a restart.
        """
        for quiet_s in (BANNER_QUIET_S, self._reply_s + BANNER_QUIET_S):
            self._send(RESET_BYTE)
            if self._await_banner(self._reply_s):
                while self._line(time.monotonic() + quiet_s) is not None:
                    pass
                self._offset_mm = None
                self._under_way = self._homing = False
                return
        self._homed = False
        raise DeviceTimeoutError(
            f"{self} does not answer as GRBL at {self.BAUD} baud; look at its power and its cable"
        )

    def _await_banner(self, within_s: float) -> bool:
        """Return whether the banner comes in time. Raises RailError for unknown firmware."""
        deadline_s = time.monotonic() + within_s
        while (line := self._line(deadline_s)) is not None:
            if found := grbl.BANNER.search(line):
                if found[1] != "1.1":
                    said = line[:LONGEST_VALUE]
                    raise RailError(f'{self} runs "{said}"; GRBL 1.1 or grblHAL is needed')
                return True
        return False

    def _get_to_know(self) -> None:
        """Read firmware and settings. Raises RailError for settings that prevent driving a rail."""
        lines = self._carry_out(["$I", "$$"], 0.0, watch=False)
        options = "".join(
            line[5:-1].partition(",")[0] for line in lines if line.startswith("[OPT:")
        )
        is_hal = any("grblhal" in line.lower() for line in lines)
        self._settings = grbl.read_settings(lines)
        if missing := [
            f"${number}" for number in grbl.NEEDED_SETTINGS if number not in self._settings
        ]:
            raise RailError(
                f"{self} did not report its settings {', '.join(missing)}; try again"
            )
        if words := grbl.unfit(self._settings, is_hal):
            raise RailError(f"{self} {words}")
        try:
            self._reach = grbl.travel(self._settings, is_hal, options)
            _ = self.travel_mm
        except ValueError as error:
            raise RailError(
                f"{self} has no room to move: travel $130 = {self._settings[130]:g} mm"
            ) from error

    def _carry_out(
        self, commands: Sequence[str], allowed_s: float, watch: bool = True
    ) -> list[str]:
        """Send lines and return everything received until the last is done, at most `allowed_s` and a reply's
        time.

        watch: ask for reports meanwhile, and raise an error without answer. Raises
        RailError, DeviceTimeoutError.
        """
        self._under_way = True
        self._send("".join(f"{command}\n" for command in (*commands, "$G")).encode())
        heard_s = asked_s = time.monotonic()
        deadline_s = heard_s + allowed_s + self._reply_s
        received: list[str] = []
        while (now_s := time.monotonic()) < deadline_s:
            line = self._line(
                min(deadline_s, asked_s + REPORT_POLL_S) if watch else deadline_s
            )
            if line is not None:
                if line.startswith("[GC:"):
                    self._under_way = False
                    return received
                received.append(line)
                heard_s = time.monotonic() if self._note(line) else heard_s
            if watch and now_s - heard_s > self._reply_s:
                break
            if watch and now_s - asked_s >= REPORT_POLL_S:
                asked_s = now_s
                self._send(ASK_BYTE)
        self._homed = False
        raise DeviceTimeoutError(
            f"{self} did not finish {commands[0]} in time; look whether it can move, then home it"
        )

    def _rest(self) -> float:
        """Return the carriage's place in mm after two Idle reports that agree.

        Raises RailError, DeviceTimeoutError.
        """
        before_mm: float | None = None
        deadline_s = time.monotonic() + self._reply_s
        while time.monotonic() < deadline_s:
            report = self._report(self._reply_s, ("Idle",))
            at_mm = self._machine_mm(report) if report else None
            if at_mm is not None and at_mm == before_mm:
                return at_mm
            before_mm = at_mm
        self._homed = False
        raise DeviceTimeoutError(f"{self} does not report where it stands; home it")

    def _report(
        self, within_s: float, states: Sequence[str], in_hold: bool = False
    ) -> grbl.Report | None:
        """Return the next report of one of these states, asking until it comes; None if none comes in time.

        in_hold: whether a hold is expected. Raises RailError for trouble.
        """
        deadline_s = time.monotonic() + within_s
        while (now_s := time.monotonic()) < deadline_s:
            self._send(ASK_BYTE)
            while (line := self._line(min(deadline_s, now_s + REPORT_POLL_S))) is not None:
                report = self._note(line, in_hold)
                if report and report.state in states:
                    return report
                if report:
                    time.sleep(REPORT_POLL_S / 5)
                    break
        return None

    def _note(self, line: str, in_hold: bool = False) -> grbl.Report | None:
        """Return the report in a line, if any. Raises RailError for a line that reports trouble."""
        if grbl.BANNER.search(line):
            raise self._lost("restarted by itself")
        if found := grbl.ALARM.search(line):
            raise self._lost(
                f"raised alarm {found[1]}: {grbl.ALARMS.get(int(found[1]), 'see its manual')}"
            )
        if found := grbl.ERROR.search(line):
            reason = grbl.ERROR_WORDS.get(int(found[1]), "see its manual")
            self._homed = False
            raise RailError(f"{self} refused a command with error {found[1]}: {reason}")
        report = grbl.read_report(line)
        if report is None:
            return None
        if report.offset_mm is not None:
            self._offset_mm = report.offset_mm
        if report.state == "Alarm":
            raise self._lost("is in alarm")
        if report.state.partition(":")[0] in STOPPED and not in_hold:
            raise RailError(f"{self} was stopped (it reports {report.state}); home it")
        return report

    def _machine_mm(self, report: grbl.Report) -> float | None:
        if report.is_machine:
            return report.at_mm
        return None if self._offset_mm is None else report.at_mm + self._offset_mm

    def _hear_out(self) -> None:
        """Read unsolicited output of the controller."""
        while (line := self._line(0.0)) is not None:
            self._note(line)
