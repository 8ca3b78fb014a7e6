"""A simulated controller behind a real pseudo-terminal, with a thread that serves it, and faults of the line."""

from __future__ import annotations

import os
import re
import select
import shutil
import tempfile
import threading
import time
import tty
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

Kind = Literal[
    "late",
    "stale",
    "silence",
    "garbage",
    "partial",
    "torn",
    "unplug",
    "reboot",
    "reset",
    "alarm",
    "slip",
]


@dataclass(frozen=True, slots=True)
class LineFault:
    """Trouble at the controller's `nth` matching command, and at the `times` - 1 following ones.

    late: all output comes `lasts_s` later; stale: an unsolicited reply; silence: output
    during `lasts_s` is lost; garbage: the next line is damaged; partial: it comes in two
    pieces, `lasts_s` apart; torn: its second half and its end are lost; unplug: the port
    goes away, for `lasts_s`, and the power too; others: as defined by the controller. The
    fault occurs `after_s` after the command.
    """

    kind: Kind
    command: str
    nth: int = 1
    times: int = 1
    after_s: float = 0.0
    lasts_s: float = 0.1


class Controller(Protocol):
    """A machine with its own clock behind a port, which advances the clock."""

    noticed: Callable[[str], None]
    stale_reply: bytes

    def power_on(self) -> None:
        """Begin anew."""
        ...

    def receive(self, data: bytes) -> None:
        """Take in bytes at the present time of the controller."""
        ...

    def advance(self, now_s: float) -> bytes:
        """Run all events up to a time, and return the output."""
        ...

    def due_s(self) -> float | None:
        """Return the time of the next event."""
        ...

    def strike(self, trouble: str) -> None:
        """Take trouble from outside."""
        ...


class PtyPort:
    """Serves a controller at `path`, which stays the same when the port is unplugged and returns.

    `lock` guards the controller against the serving thread; `struck` counts the faults that
    occurred.
    """

    def __init__(self, controller: Controller, faults: Sequence[LineFault] = ()) -> None:
        self.controller = controller
        self.lock = threading.RLock()
        self._faults = tuple(faults)
        self._met: Counter[LineFault] = Counter()
        self.struck = 0
        self._folder = Path(tempfile.mkdtemp(prefix="labkit-rail-"))
        self.path = str(self._folder / "port")
        self._ends: tuple[int, int] | None = None
        self._out: deque[tuple[float, bytes]] = deque()  # when, what
        self._actions: list[tuple[float, Callable[[], None]]] = []
        self._spoil: deque[LineFault] = deque()
        self._silent_until_s = self._late_until_s = self._late_by_s = 0.0
        self._began_s = time.monotonic()
        self._wake_up, self._wake = os.pipe()
        self._closing = False
        controller.noticed = self._notice
        controller.power_on()
        self._plug()
        self._thread = threading.Thread(
            target=self._serve, name="simulated rail", daemon=True
        )
        self._thread.start()

    def strike(self, kind: Kind, lasts_s: float = 0.1) -> None:
        """Cause a fault now."""
        with self.lock:
            self._strike(LineFault(kind, "", lasts_s=lasts_s))
        os.write(self._wake, b".")

    def close(self) -> None:
        """Take the port away for good."""
        if self._closing:
            return
        self._closing = True
        os.write(self._wake, b".")
        self._thread.join(timeout=5.0)
        self._unplug()
        os.close(self._wake)
        os.close(self._wake_up)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _now_s(self) -> float:
        return time.monotonic() - self._began_s

    def _serve(self) -> None:
        while not self._closing:
            with self.lock:
                self._run(self._now_s())
                wait_s = self._wait_s(self._now_s())
            ears = [self._wake_up, *(self._ends[:1] if self._ends else ())]
            ready = select.select(ears, [], [], wait_s)[0]
            if self._wake_up in ready:
                os.read(self._wake_up, 64)
            with self.lock:
                if self._ends and self._ends[0] in ready:
                    data = os.read(self._ends[0], 4096)
                    self._run(self._now_s())
                    self.controller.receive(data)

    def _run(self, now_s: float) -> None:
        """Run all events that are due."""
        self._put(self.controller.advance(now_s), now_s)
        due = [action for when_s, action in self._actions if when_s <= now_s]
        self._actions = [item for item in self._actions if item[0] > now_s]
        for action in due:
            action()
        self._put(self.controller.advance(now_s), now_s)
        while self._out and self._out[0][0] <= now_s:
            _, data = self._out.popleft()
            if self._ends:
                os.write(self._ends[0], data)

    def _wait_s(self, now_s: float) -> float:
        times = [when_s for when_s, _ in self._actions]
        if self._out:
            times.append(self._out[0][0])
        if (due_s := self.controller.due_s()) is not None:
            times.append(due_s)
        return max(0.0, min([0.5, *(when_s - now_s for when_s in times)]))

    def _put(self, said: bytes, now_s: float) -> None:
        """Pass the controller's output on through the faults."""
        for line in said.splitlines(keepends=True):
            if now_s < self._silent_until_s:
                continue
            at_s = now_s + (self._late_by_s if now_s < self._late_until_s else 0.0)
            at_s = max(
                at_s, self._out[-1][0] if self._out else at_s
            )  # a line cannot overtake another
            half = len(line) // 2
            spoil = self._spoil.popleft() if self._spoil and line.strip() else None
            match spoil.kind if spoil else None:
                case "garbage":
                    self._out.append(
                        (at_s, b"\xff\x00" + line[:half] + b"\xfe" + line[half + 1 :])
                    )
                case "torn":
                    self._out.append((at_s, line[:half]))
                case "partial":
                    assert spoil
                    self._out += [(at_s, line[:half]), (at_s + spoil.lasts_s, line[half:])]
                case _:
                    self._out.append((at_s, line))

    def _notice(self, command: str) -> None:
        """Count a command, and set off its faults."""
        for fault in self._faults:
            if re.fullmatch(fault.command, command):
                self._met[fault] += 1
                if fault.nth <= self._met[fault] < fault.nth + fault.times:
                    self.struck += 1
                    self._later(fault.after_s, lambda fault=fault: self._strike(fault))  # type: ignore[misc]

    def _later(self, seconds: float, action: Callable[[], None]) -> None:
        if seconds:
            self._actions.append((self._now_s() + seconds, action))
        else:
            action()

    def _strike(self, fault: LineFault) -> None:
        now_s = self._now_s()
        match fault.kind:
            case "late":
                self._late_by_s, self._late_until_s = fault.lasts_s, now_s + fault.lasts_s
            case "stale":
                self._out.append((now_s, self.controller.stale_reply))
            case "silence":
                self._silent_until_s = now_s + fault.lasts_s
            case "garbage" | "partial" | "torn":
                self._spoil.append(fault)
            case "unplug":
                self._later(1e-6, lambda: self._pull(fault.lasts_s))
            case _:
                self._later(1e-6, lambda: self.controller.strike(fault.kind))

    def _pull(self, lasts_s: float) -> None:
        self._unplug()
        self._out.clear()
        self.controller.strike("reboot")
        self._later(lasts_s, self._plug)

    def _plug(self) -> None:
        near, far = os.openpty()
        tty.setraw(far)
        # kept open here: else reading before anyone has opened the port is an error
        self._ends = (near, far)
        beside = Path(f"{self.path}.new")
        beside.symlink_to(os.ttyname(far))
        beside.replace(self.path)

    def _unplug(self) -> None:
        if self._ends:
            Path(self.path).unlink(missing_ok=True)
            for end in self._ends:
                os.close(end)
        self._ends = None
