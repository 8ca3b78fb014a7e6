"""What a GRBL 1.1 or grblHAL controller sends: status reports, alarms, errors, settings. Text in, values out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from labkit.devices.protocols import Travel

BANNER = re.compile(r"grbl(?:hal)? (\d+\.\d+)", re.IGNORECASE)
ALARM = re.compile(r"ALARM:(\d+)")
ERROR = re.compile(r"error:(\d+)")
SETTING = re.compile(r"\$(\d+)=(-?\d+(?:\.\d+)?)")
NUMBER = r"-?\d+(?:\.\d+)?"
REPORT = re.compile(
    rf"<(?P<state>[A-Z][a-z]+(?::\d+)?)\|(?P<kind>[MW])Pos:(?P<x>{NUMBER})(?:,{NUMBER})*(?P<rest>(?:\|[^|<>]*)*)>"
)
OFFSET = re.compile(rf"\|WCO:(?P<x>{NUMBER})(?:,|\||$)")

ALARMS = {
    1: "it ran onto a limit switch",
    2: "the move would leave its travel",
    3: "it was reset in motion",
    6: "it was reset while homing",
    7: "its safety door opened while homing",
    8: "homing could not leave the limit switch",
    9: "homing did not find the limit switch",
}
"""Alarms of a rail, by GRBL's documentation."""

ERRORS = {
    3: "it does not know the command",
    5: "homing is off; turn it on with $22=1 and see its limit switch",
    8: "it was not idle",
    9: "it is locked until homed",
    11: "the line is too long",
    15: "the move would leave its travel",
    22: "no feed rate",
}
"""Errors that a rail may meet, by GRBL's documentation."""

INCHES, SOFT_LIMITS, HARD_LIMITS = 13, 20, 21
MAX_TRAVEL, MAX_RATE, ACCELERATION = 130, 110, 120
HOMING, HOMING_DIRECTION, LOCATE_RATE, SEEK_RATE, PULL_OFF = 22, 23, 24, 25, 27
NEEDED = (INCHES, HOMING, HOMING_DIRECTION, LOCATE_RATE, SEEK_RATE, PULL_OFF, MAX_RATE, ACCELERATION, MAX_TRAVEL)
"""Settings that a rail is driven by; their numbers are the same in GRBL 1.1 and grblHAL."""

HAL_ORIGIN_AT_HOME = 8
"""Bit of grblHAL's $22; GRBL has it compiled in, the Z among its options."""


@dataclass(frozen=True, slots=True)
class Report:
    """A status report: state (Idle, Run, Hold:0 ...), where X stands in mm, and the work offset where it is reported.

    `at_mm` is counted from the machine's zero if `is_machine`, else from the work zero: machine = work + offset.
    """

    state: str
    at_mm: float
    is_machine: bool
    offset_mm: float | None


def read_report(line: str) -> Report | None:
    """The report in a line such as <Idle|MPos:-250.000,0.000,0.000|FS:0,0>; None if it is none, or is damaged."""
    found = REPORT.fullmatch(line)
    if not found:
        return None
    offset = OFFSET.search(found["rest"])
    return Report(found["state"], float(found["x"]), found["kind"] == "M", float(offset["x"]) if offset else None)


def travel(settings: Mapping[int, float], is_hal: bool, options: str) -> Travel:
    """Where X may go, in machine coordinates, a pull-off away from both ends. Raises ValueError if that is nowhere.

    settings: by number; options: the letters of [OPT:...]. GRBL's machine space is negative, unless zero is set where
    the machine is homed.
    """
    whole_mm, margin_mm = settings[MAX_TRAVEL], settings[PULL_OFF]
    at_home = int(settings[HOMING]) & HAL_ORIGIN_AT_HOME if is_hal else "Z" in options
    if not at_home:
        return Travel(margin_mm - whole_mm, -margin_mm)
    if int(settings[HOMING_DIRECTION]) & 1:
        return Travel(0.0, whole_mm - margin_mm)
    return Travel(margin_mm - whole_mm, 0.0)


def homing_s(settings: Mapping[int, float]) -> float:
    """Longest that homing may take: three axes in two cycles, each searching 1.5 times the travel, then locating."""
    search_s = 1.5 * settings[MAX_TRAVEL] / (settings[SEEK_RATE] / 60)
    locate_s = 10 * settings[PULL_OFF] / (settings[LOCATE_RATE] / 60)
    return 2 * (search_s + locate_s)


def moving_s(settings: Mapping[int, float], distance_mm: float) -> float:
    """Time of a rapid move with its start and stop."""
    speed = settings[MAX_RATE] / 60
    return distance_mm / speed + 2 * speed / settings[ACCELERATION]
