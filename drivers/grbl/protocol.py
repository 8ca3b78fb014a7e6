"""Parse the output of a GRBL 1.1 or grblHAL controller: status reports, alarms, errors, settings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite, isnan, nan

from labkit.devices.protocols import Travel

BANNER = re.compile(r"grbl(?:hal)? (\d+\.\d+)", re.IGNORECASE)
ALARM = re.compile(r"ALARM:(\d+)")
ERROR = re.compile(r"error:(\d+)")
SETTING = re.compile(r"\$(\d{1,9})=(.*)")
NUMBER_PATTERN = r"-?\d+(?:\.\d+)?"
REPORT_PATTERN = re.compile(
    rf"<(?P<state>[A-Z][a-z]+(?::\d+)?)\|(?P<kind>[MW])Pos:(?P<x>{NUMBER_PATTERN})(?:,{NUMBER_PATTERN})*(?P<rest>(?:\|[^|<>]*)*)>"
)
OFFSET = re.compile(rf"\|WCO:(?P<x>{NUMBER_PATTERN})(?:,|\||$)")

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

ERROR_WORDS = {
    3: "it does not know the command",
    5: "homing is off; turn it on with $22=1 and see its limit switch",
    8: "it was not idle",
    9: "it is locked until homed",
    11: "the line is too long",
    15: "the move would leave its travel",
    22: "no feed rate",
}
"""Errors that a rail may meet, by GRBL's documentation."""

IDLE_DELAY = 1
REPORTS = 10
INCHES = 13
SOFT_LIMITS = 20
HARD_LIMITS = 21
MAX_TRAVEL = 130
MAX_RATE = 110
ACCELERATION = 120
HOMING_SETTING = 22
HOMING_DIRECTION = 23
LOCATE_RATE = 24
SEEK_RATE = 25
PULL_OFF = 27
NEEDED_SETTINGS = (
    REPORTS,
    INCHES,
    HOMING_SETTING,
    HOMING_DIRECTION,
    LOCATE_RATE,
    SEEK_RATE,
    PULL_OFF,
    MAX_RATE,
    ACCELERATION,
    MAX_TRAVEL,
)
"""Settings that a rail is driven by; their numbers are the same in GRBL 1.1 and grblHAL."""

STEPS_PER_MM = 100

SENSIBLE = {
    STEPS_PER_MM: ("its steps per mm", 1e6),
    MAX_RATE: ("its largest speed in mm/min", 1e6),
    ACCELERATION: ("its acceleration in mm/s²", 1e6),
    MAX_TRAVEL: ("its travel in mm", 1e5),
    SEEK_RATE: ("the speed in mm/min at which it searches for its limit switch", 1e6),
    LOCATE_RATE: ("the speed in mm/min at which it approaches its limit switch", 1e6),
    PULL_OFF: ("how far it backs off its limit switch in mm", 1e3),
}
"""Settings above 0, in words, and their largest values, far beyond any rail: a lost EEPROM has zeros, or largest numbers."""

MACHINE_POSITION, HAL_OFFSET, HAL_PARSER_STATE = 1, 32, 512
"""Bits of $10: what reports hold. GRBL reports the work offset in any case; grblHAL's parser state would come unasked."""

ALWAYS_ON = 255
"""As $1: motors are held at rest too."""

FACTORY_TRAVEL_MM = 200.0

HAL_ORIGIN_AT_HOME = 8
"""Bit of grblHAL's $22; GRBL has it compiled in, the Z among its options."""


@dataclass(frozen=True, slots=True)
class Report:
    """A status report: state (Idle, Run, Hold:0 ...), X in mm, and the work offset if reported.

    `at_mm` counts from the machine's zero if `is_machine`, else from the work zero: machine
    = work + offset.
    """

    state: str
    at_mm: float
    is_machine: bool
    offset_mm: float | None


def read_report(line: str) -> Report | None:
    """Return the report in a line such as <Idle|MPos:-250.000,0.000,0.000|FS:0,0>; None if absent or damaged."""
    found = REPORT_PATTERN.fullmatch(line)
    if not found:
        return None
    offset = OFFSET.search(found["rest"])
    return Report(
        found["state"],
        float(found["x"]),
        found["kind"] == "M",
        float(offset["x"]) if offset else None,
    )


def read_settings(lines: Iterable[str]) -> dict[int, float]:
    """Return the settings in the answer to $$, by number; nan for one that is no number."""
    found = (SETTING.fullmatch(line.strip()) for line in lines)
    return {int(each[1]): _number(each[2]) for each in found if each}


def _number(text: str) -> float:
    """Return the number of a setting; nan for text that is no finite number."""
    # controllers write no exponents
    number = float(text) if re.fullmatch(NUMBER_PATTERN, text) else nan
    return number if isfinite(number) else nan


def unfit(settings: Mapping[int, float], is_hal: bool) -> str | None:
    """Return the setting with which a rail cannot be driven, in words; None if there is none."""
    for number in NEEDED_SETTINGS:
        if isnan(settings[number]):
            return f"reports no number as its setting ${number}; set ${number} again"
    reports = int(settings[REPORTS])
    if settings[INCHES]:
        return "reports in inches ($13=1); set $13=0"
    if not int(settings[HOMING_SETTING]) & 1:
        return "has homing turned off ($22=0), so its position cannot be known; set $22=1"
    if is_hal and not reports & (MACHINE_POSITION | HAL_OFFSET):
        return f"reports work positions without their offset ($10={reports}), so its position cannot be known; set $10=511"
    if is_hal and reports & HAL_PARSER_STATE:
        return f"reports its parser's state unasked ($10={reports}), which labkit takes for an answer; set $10=511"
    for number, (words, most) in SENSIBLE.items():
        # grblHAL's axes without motors have no steps to report
        if number in settings and not 0 < settings[number] <= most:
            return f"has {words} ${number}={settings[number]:g}; allowed is above 0, at most {most:g}: set ${number}"
    return None


def doubts(settings: Mapping[int, float]) -> tuple[str, ...]:
    """Describe settings that differ from docs/guides/bench.md but do not prevent a rail from running."""
    found = []
    if (delay := settings.get(IDLE_DELAY, ALWAYS_ON)) != ALWAYS_ON:
        found.append(
            f"$1={delay:g}: motors are let go {delay:g} ms after each move, and the carriage may creep; set $1=255"
        )
    if not settings.get(SOFT_LIMITS, 0):
        found.append("$20=0: soft limits are off; set $20=1")
    if not settings.get(HARD_LIMITS, 0):
        found.append("$21=0: hard limits are off; wire the switches and set $21=1")
    if settings[MAX_TRAVEL] == FACTORY_TRAVEL_MM:
        found.append("$130=200, as from the factory: is it the rail's travel in mm?")
    return tuple(found)


def travel(settings: Mapping[int, float], is_hal: bool, options: str) -> Travel:
    """Return the travel of X, in machine coordinates, a pull-off away from both ends. Raises ValueError if there is none.

    settings: by number; options: the letters of [OPT:...]. GRBL's machine space is negative, unless zero is set where
    the machine is homed.
    """
    whole_mm = settings[MAX_TRAVEL]
    margin_mm = settings[PULL_OFF]
    at_home = (
        int(settings[HOMING_SETTING]) & HAL_ORIGIN_AT_HOME if is_hal else "Z" in options
    )
    if not at_home:
        return Travel(margin_mm - whole_mm, -margin_mm)
    if int(settings[HOMING_DIRECTION]) & 1:
        return Travel(0.0, whole_mm - margin_mm)
    return Travel(margin_mm - whole_mm, 0.0)


def homing_s(settings: Mapping[int, float]) -> float:
    """Return the longest time of homing: three axes in two cycles, each searching 1.5 times the travel, then
    locating.
    """
    search_s = 1.5 * settings[MAX_TRAVEL] / (settings[SEEK_RATE] / 60)
    locate_s = 10 * settings[PULL_OFF] / (settings[LOCATE_RATE] / 60)
    return 2 * (search_s + locate_s)


def moving_s(settings: Mapping[int, float], distance_mm: float) -> float:
    """Time of a rapid move with its start and stop."""
    speed = settings[MAX_RATE] / 60
    return distance_mm / speed + 2 * speed / settings[ACCELERATION]
