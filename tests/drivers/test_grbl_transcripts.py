"""The simulated controller against what real firmware, GRBL 1.1h and grblHAL, was recorded to say.

Every line is compared in its order. Of a status report: state, buffers, pins, whether it moves, and X where it stands; X
in motion depends on the recording computer's speed, and WCO and Ov come every so many reports, some not recorded.
"""

from __future__ import annotations

import ast
import copy
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from labkit.drivers.grbl.protocol import (
    HOMING_SETTING,
    REPORTS,
    doubts,
    read_report,
    read_settings,
    unfit,
)
from labkit.drivers.simulated.controllers.grbl_controller import GrblController
from labkit.drivers.simulated.controllers.grbl_firmware import GRBL, GRBL_HAL

TRANSCRIPTS = Path(__file__).parent / "transcripts"

EVENT = re.compile(r" *\d+\.\d+ (>>|>|<|poll right after ok|after barrier) (.+)")

HIDDEN = {
    "35.981": ("G1 X-3 F1500", "its ok as well"),
    "36.441": ("G1 X-3 F1500", "its ok as well"),
    "36.907": ("G1 X-3 F1500", "its ok as well"),
    "37.375": ("G1 X-3 F1500", "its ok as well"),
    "28.321": ("$H", "to its end"),
    "31.013": ("$H", "a little"),
}
"""Commands that the recording program sent without writing them down, before the line of this time; how it went on."""

SPEED = 0.7
"""The recorded firmware's clock ran at about this share of true time."""


@dataclass
class Event:
    time: str
    kind: str
    text: bytes


def events(text: str) -> Iterator[Event]:
    for line in text.splitlines():
        if found := EVENT.match(line):
            said = ast.literal_eval(found[2])
            kind = "<" if found[1] in ("poll right after ok", "after barrier") else found[1]
            yield Event(
                line.split()[0], kind, said if isinstance(said, bytes) else said.encode()
            )


class Replay:
    """Feeds a controller what was sent, and compares what it says with what was heard."""

    def __init__(self, controller: GrblController, recorded: list[Event]) -> None:
        self.controller = controller
        self.recorded = recorded
        self.said: deque[str] = deque()
        self.compared = 0

    def run(self) -> int:
        self.controller.power_on()
        self.pass_time(0.0)
        before_s, hidden = 0.0, set[str]()
        for at, event in enumerate(self.recorded):
            if event.time in HIDDEN and event.time not in hidden:
                hidden.add(event.time)
                self.send_hidden(*HIDDEN[event.time])
            stops = event.kind == ">>" and event.text in (b"!", b"\x85", b"\x18")
            if event.kind != "<":
                self.pass_time(
                    0.002 if stops else max(0.002, (float(event.time) - before_s) * SPEED)
                )
            before_s = float(event.time)
            if event.kind == "<":
                self.hear(event.text.decode())
                self.compared += 1
            elif stops:
                self.interrupt(event.text, self.stands_next(at))
            else:
                self.send(event.text if event.kind == ">>" else event.text + b"\n")
        return self.compared

    def send_hidden(self, command: str, then: str) -> None:
        self.send(command.encode() + b"\n")
        if then == "its ok as well":
            self.hear("ok")
        elif then == "to its end":
            self.pass_until_said()

    def pass_time(self, seconds: float) -> None:
        self.said += (
            self.controller.advance(self.controller.now_s + seconds).decode().splitlines()
        )

    def send(self, data: bytes) -> None:
        self.controller.receive(data)
        self.pass_time(0.0)

    def hear(self, expected: str) -> None:
        if expected.startswith("<"):
            self.hear_report(expected)
            return
        self.pass_until_said()
        assert self.said, f"silent; recorded was {expected}"
        assert self.said.popleft() == expected

    def hear_report(self, expected: str) -> None:
        report = read_report(expected)
        assert report
        if not self.said and report.state == "Home" and not self.controller.firmware.is_hal:
            self.pass_until_said()
        if not self.said:  # asked for by a loop that was not written down, until it stood
            ends = (
                report.state == "Idle"
                and f"Bf:{self.controller.firmware.blocks}," in expected
            )
            while (
                ends
                and self.controller.machine.planned
                and (due_s := self.controller.due_s()) is not None
            ):
                self.pass_time(due_s - self.controller.now_s)
            if report.state == "Run":
                self.pass_time(0.002)
            self.send(b"?")
        compare(self.said.popleft(), expected)

    def pass_until_said(self) -> None:
        while not self.said and (due_s := self.controller.due_s()) is not None:
            self.pass_time(due_s - self.controller.now_s)

    def stands_next(self, at: int) -> float | None:
        """Where the next report says that X is: still standing, or just setting out."""
        for event in self.recorded[at + 1 :]:
            report = read_report(event.text.decode("latin-1"))
            if event.kind == "<" and report:
                return report.at_mm
        return None

    def interrupt(self, command: bytes, then_mm: float | None) -> None:
        """Send a command that stops motion at the moment after which X stands where it was recorded to."""
        motion = self.controller.machine.motion
        if motion is not None and then_mm is not None:
            low_s, high_s = 0.0, motion.end_s - self.controller.now_s
            rising = self.stop_at(command, high_s) > self.stop_at(command, low_s)
            for _ in range(40):
                middle_s = (low_s + high_s) / 2
                short = (self.stop_at(command, middle_s) < then_mm) == rising
                low_s, high_s = (middle_s, high_s) if short else (low_s, middle_s)
            self.pass_time(high_s)
        self.send(command)

    def stop_at(self, command: bytes, after_s: float) -> float:
        trial = copy.deepcopy(self.controller)
        trial.advance(trial.now_s + after_s)
        trial.receive(command)
        trial.advance(trial.now_s + 1.0)
        return trial.machine.position[0]


def compare(line: str, recorded: str) -> None:
    assert essence(line) == essence(recorded)
    report, wanted = read_report(line), read_report(recorded)
    assert report
    assert wanted
    if wanted.state in ("Idle", "Alarm", "Hold:0", "Sleep"):
        assert report.at_mm == pytest.approx(
            wanted.at_mm, abs=0.0085
        )  # two steps of the motor


def essence(line: str) -> list[object]:
    report, buffers, speed = (
        read_report(line),
        re.search(r"Bf:\d+,\d+", line),
        re.search(r"FS:(\d+)", line),
    )
    assert report
    assert speed
    return [report.state, buffers and buffers[0], speed[1] != "0", "Pn:X" in line]


@pytest.mark.parametrize(("name", "reports"), [("grbl-1.1h", 1), ("grblhal", 511)])
def test_what_labkit_says_of_settings_is_true_of_those_that_were_recorded(
    name: str, reports: int
) -> None:
    """As from the factory: homing is off, soft and hard limits are, motors are let go, and the travel is a default."""
    lines = [
        event.text.decode("latin-1")
        for event in events((TRANSCRIPTS / f"{name}.txt").read_text())
    ]
    settings = read_settings(lines[: lines.index("$132=200.000") + 1])
    is_hal = name == "grblhal"
    assert settings[REPORTS] == reports
    assert "$22=0" in str(unfit(settings, is_hal))
    assert unfit(settings | {HOMING_SETTING: 1}, is_hal) is None
    assert [words.partition(":")[0].partition(",")[0] for words in doubts(settings)] == [
        "$1=25",
        "$20=0",
        "$21=0",
        "$130=200",
    ]
    seen = [report for line in lines if (report := read_report(line))]
    assert all(report.is_machine for report in seen)  # bit 0 of $10
    assert any(
        report.offset_mm is not None for report in seen
    )  # bit 5 of grblHAL's; GRBL's come in any case


SESSIONS = re.split(r"(?m)^#####.*$", (TRANSCRIPTS / "grbl-1.1h.txt").read_text())
"""Of one controller, power cycled between them; its settings are kept."""


def test_grbl_says_what_the_firmware_was_recorded_to_say() -> None:
    settings: dict[int, float] = {}
    counts = []
    for number, text in enumerate(SESSIONS):
        controller = GrblController(
            GRBL, settings, carriage_mm=0.0, limit_alarm=3, blank=number == 0
        )
        controller.machine.lost_mm = 0.0  # the recorded firmware drove no mass
        counts.append(Replay(controller, list(events(text))).run())
        settings = controller.settings
    assert counts == [89, 70, 69, 52]  # every line heard


def test_grblhal_says_what_the_firmware_was_recorded_to_say() -> None:
    controller = GrblController(
        GRBL_HAL, options="VNML+", carriage_mm=0.0, switch_works=False, blank=True
    )
    recorded = list(events((TRANSCRIPTS / "grblhal.txt").read_text()))
    assert Replay(controller, recorded).run() == 134  # every line heard
