"""Allowed values of a plan's fields: ranges of numbers and patterns of text, as validators and as words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BeforeValidator, Strict
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

Value = TypeVar("Value", str, float)

LONGEST_PATH = 1000

MOST_PROBLEMS = 20
"""Number of faults that one line names."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """A closed range of numbers, as a pydantic validator and as words for messages."""

    low: float
    high: float
    whole: bool = False

    def __call__(self, value: float) -> float:
        if not self.low <= value <= self.high:
            raise not_allowed(str(self))
        return value

    def __str__(self) -> str:
        return f"{'a whole' if self.whole else 'a'} number, {self.low:.10g} to {self.high:.10g}"


@dataclass(frozen=True, slots=True)
class Matching:
    """Printable text that matches a regular expression, as a pydantic validator and as words for messages."""

    pattern: str
    words: str

    def __call__(self, value: str) -> str:
        if not (value.isprintable() and re.fullmatch(self.pattern, value)):
            raise not_allowed(self.words)
        return value

    def __str__(self) -> str:
        return self.words


@dataclass(frozen=True, slots=True)
class Takes:
    """Words for messages and the reference on a field's values, beyond its type."""

    words: str

    def __str__(self) -> str:
        return self.words


def or_fit(low: float, high: float) -> BeforeValidator:
    """Return a validator of a number from `low` to `high`, or of "fit"."""
    words = f'{low:g} to {high:g}, or "fit"'

    def checked(given: Any) -> Any:
        if given != "fit" and not (type(given) in (int, float) and low <= given <= high):
            raise not_allowed(words)
        return given

    return BeforeValidator(checked)


@dataclass(frozen=True, slots=True)
class Names:
    """Some names, as a pydantic validator and as words for messages."""

    names: tuple[str, ...]

    def __call__(self, value: str) -> str:
        if value not in self.names:
            raise not_allowed(str(self))
        return value

    def __str__(self) -> str:
        return f"one of {', '.join(self.names)}"


def one_of(names: Iterable[str]) -> AfterValidator:
    """A validator of one of some names."""
    return AfterValidator(Names(tuple(names)))


def matches(pattern: str, words: str) -> AfterValidator:
    """Return a validator of printable text that matches a regular expression; `words` state what is allowed."""
    return AfterValidator(Matching(pattern, words))


def what_it_takes(field: FieldInfo) -> str:
    """Return in words which values a field takes; empty if the type says enough."""
    optional = [
        item
        for part in get_args(field.annotation)
        for item in getattr(part, "__metadata__", ())
    ]
    found = [
        item.func if isinstance(item, AfterValidator) else item
        for item in (*field.metadata, *optional)
    ]
    for kind in (Takes, Allowed, Matching, Names):
        for item in found:
            if isinstance(item, kind):
                return str(item)
    return ""


def not_allowed(words: str) -> PydanticCustomError:
    """Return the error of a value that its field rejects; `words` state what is allowed."""
    return PydanticCustomError("allowed", "{words}", {"words": f"allowed is {words}"})


def problem(words: str) -> PydanticCustomError:
    """Return the error of a whole table; `words` name the field."""
    return PydanticCustomError("problem", "{words}", {"words": words})


def joined(problems: Sequence[str], more: int = 0) -> str:
    """Return problems in one line: `MOST_PROBLEMS` at most, and the number of those left out.

    more: number of problems left out before
    """
    left_out = max(len(problems) - MOST_PROBLEMS, 0) + more
    rest = [f"and {left_out} more problems"] if left_out else []
    return "; ".join([*problems[:MOST_PROBLEMS], *rest])


def repeated(values: Iterable[Value]) -> list[Value]:
    """Return the values that occur more than once."""
    return [value for value, times in Counter(values).items() if times > 1]


Number = Annotated[float, Strict()]
Count = Annotated[int, Strict()]
Corner = tuple[Number, Number]
Length = Annotated[Number, AfterValidator(Allowed(1e-3, 1e6))]
Name = Annotated[
    str,
    matches(r"[A-Za-z][A-Za-z0-9]{0,39}", "a letter, then letters and digits, 40 at most"),
]
Line = Annotated[str, matches(r".+", "printable text")]
Short = Annotated[
    str, matches(r"(?=.*\S).{1,80}", "printable text of 1 to 80 characters on one line")
]
Note = Annotated[
    str, matches(r"(?=.*\S).{1,200}", "printable text of 1 to 200 characters on one line")
]
Address = Annotated[
    str,
    matches(
        r"[a-z][a-z0-9]*:\S*",
        "driver:where, such as simulated:, gphoto2: or grbl:/dev/ttyUSB0",
    ),
]
