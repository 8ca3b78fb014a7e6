"""Cards that lead the report: numbers of one kind, with their errors."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.report.table import NO_ERROR, PLUS_MINUS, estimated
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class Number:
    """A value and its error as they are printed, the error with its sign."""

    value: str
    error: str


@dataclass(frozen=True, slots=True)
class Card:
    """Numbers of one kind.

    rows: a channel or words, and its numbers; head: what each column holds; strong: how many columns lead; big: words in
    place of rows.
    """

    title: str
    note: str
    rows: tuple[tuple[str, tuple[Number, ...]], ...] = ()
    head: tuple[str, ...] = ()
    strong: int = 1
    big: str = ""


def number_of(number: Uncertain, *, least: int = 0) -> Number:
    """Return a number as it is printed, with at least so many decimal places."""
    value, mark, error = estimated(number, least=least).partition(PLUS_MINUS)
    if not mark and value.endswith(NO_ERROR):
        return Number(value.removesuffix(NO_ERROR), NO_ERROR)
    return Number(value, f"{mark}{error}")


def signed(number: Uncertain) -> Number:
    """Return a number with its sign, a plus too."""
    printed = number_of(number)
    return Number(f"+{printed.value}", printed.error) if number.value > 0 else printed
