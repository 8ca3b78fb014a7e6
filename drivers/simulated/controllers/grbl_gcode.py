"""Parse the G-code of the simulated GRBL: a line into words, with GRBL's error numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TypeVar

WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")

MODAL_GROUPS = ({0, 1}, {17, 18, 19}, {20, 21}, {54}, {90, 91}, {93, 94}, {4, 10, 53})
KNOWN_M = {0, 2, 3, 5, 8, 9, 30}
AXES = "XYZ"
Key = TypeVar("Key", int, str)
LONGEST_GCODE_LINE = 80


class GcodeError(Exception):
    """A line that GRBL refuses; `number` as in error:N."""

    def __init__(self, number: int) -> None:
        super().__init__(f"error:{number}")
        self.number = number


@dataclass(frozen=True, slots=True)
class Block:
    """One line: G numbers, axis words in mm or inches as given, F, and other words by letter."""

    g: frozenset[int]
    axes: dict[int, float] = field(default_factory=dict)
    feed: float | None = None
    values: dict[str, float] = field(default_factory=dict)


def clean(line: str) -> str:
    """Return a line as GRBL stores it: no spaces, no comments, capitals. Raises GcodeError 11 if too long."""
    bare = re.sub(r"\([^)]*\)?|;.*|\s", "", line).upper()
    if len(bare) > LONGEST_GCODE_LINE:
        raise GcodeError(11)
    return bare


def parse(line: str) -> Block:
    """Return the words of a cleaned line. Raises GcodeError 2, 4, 20, 21 or 25."""
    g: set[int] = set()
    axes: dict[int, float] = {}
    values: dict[str, float] = {}
    at = 0
    while at < len(line):
        found = WORD.match(line, at)
        if not found:
            raise GcodeError(2)
        at = found.end()
        letter = found[1]
        value = float(found[2])
        if letter == "G":
            _add_g(g, value)
        elif letter == "M":
            if value not in KNOWN_M:
                raise GcodeError(20)
        elif letter in AXES:
            _add_once(axes, AXES.index(letter), value)
        elif letter in "FLNPST":
            _add_once(values, letter, value)
            if value < 0:
                raise GcodeError(4)
        else:
            raise GcodeError(20)
    return Block(frozenset(g), axes, values.pop("F", None), values)


def _add_g(g: set[int], value: float) -> None:
    group = next((group for group in MODAL_GROUPS if value in group), None)
    if group is None:
        raise GcodeError(20)
    if g & group:
        raise GcodeError(21)
    g.add(int(value))


def _add_once(found: dict[Key, float], key: Key, value: float) -> None:
    if key in found:
        raise GcodeError(25)
    found[key] = value
