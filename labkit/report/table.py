"""Tables and cards of the report, and their numbers as text.

Each number has its standard error, or its column or row the reason why it has none. Reasons are marked by letters and stand
below the table; `tests/unit/test_report_numbers.py` walks the page and holds it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import isfinite, isinf
from operator import attrgetter
from string import ascii_lowercase
from typing import Any

from labkit.results import Results, Wavefront
from labkit.uncertain import SIGN_OPEN, Uncertain, decimals

MINUS = "\N{MINUS SIGN}"
NAMES_OF_MONTHS = (
    "January February March April May June July August September October November December"
)
MONTHS = tuple(NAMES_OF_MONTHS.split())  # not by the locale: the page is in English
UNKNOWN = "\N{EM DASH}"
MOST_PLACES = 9
NO_ERROR = "\N{NO-BREAK SPACE}(error\N{NO-BREAK SPACE}unknown)"
PLUS_MINUS = "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}"  # never parted from its numbers at the end of a line


def fixed(value: float | None, places: int) -> str:
    """Return a number to so many decimal places; a dash for None."""
    if value is None or not isfinite(value):
        return UNKNOWN
    text = f"{value:.{places}f}"
    return (text if float(text) else text.lstrip("-")).replace("-", MINUS)


def plus_minus(value: float, std: float, places: int | None = None) -> str:
    """Return a number and its standard error to the same decimal place, never ± 0.00; words if the error is unknown."""
    if isinf(std):
        return "not determined"
    if not std > 0:
        return fixed(value, 4 if places is None else places) + NO_ERROR
    enough = decimals(std, MOST_PLACES)
    places = enough if places is None or std < 0.95 * 10.0**-places else places
    error = fixed(std, places) if std >= 0.5 * 10.0**-places else f"{std:.1e}"
    return f"{fixed(value, places)}{PLUS_MINUS}{error}"


def estimated(number: Uncertain | None, factor: float = 1.0, *, least: int = 0) -> str:
    """Return an estimate times a factor, to the decimal places of its error, at least `least`; a dash for None.

    An estimate of open sign has "±" in place of it.
    """
    if number is None:
        return UNKNOWN
    value = number.value * factor
    std = number.std * abs(factor)
    known = isfinite(std) and std > 0
    text = plus_minus(
        abs(value) if number.sign_open else value,
        std,
        max(least, decimals(std)) if known else max(least, 1 if abs(value) >= 10 else 3),
    )
    return f"±{text}, {SIGN_OPEN}" if number.sign_open else text


def when(iso: str) -> str:
    """Return a moment in words, "22 November 2026, 06:28 UTC"; any other text unchanged."""
    try:
        at = datetime.fromisoformat(iso)
    except ValueError:
        return iso
    zone = (
        ""
        if at.tzinfo is None
        else " UTC"
        if at.utcoffset() == timedelta(0)
        else f" UTC{at.isoformat()[-6:]}"
    )
    return f"{at.day} {MONTHS[at.month - 1]} {at.year}, {at:%H:%M}{zone}"


def millimetres(range_mm: float | None) -> str:
    """Return a range with its unit; "no range" for None."""
    return "no range" if range_mm is None else f"{range_mm:g} mm"


def bare(range_mm: float | None) -> str:
    """Return a range without its unit, which is at the head of the column."""
    return "none" if range_mm is None else f"{range_mm:g}"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    text: set to the left; channel: marked by that channel's colour; why: the reason why its numbers have no error; exact: its
    numbers cannot have one, being definitions, counts or errors themselves; cell: of an item
    of `listed`.
    """

    label: str
    unit: str = ""
    text: bool = False
    channel: str = ""
    why: str = ""
    exact: bool = False
    cell: Callable[[Any], str] = str


RANGE_COLUMN = Column("range", "mm", exact=True, cell=lambda w: bare(w.range_mm))
CHANNEL_COLUMN = Column("channel", text=True, cell=attrgetter("channel"))
"""Columns of fits."""


@dataclass(frozen=True, slots=True)
class Row:
    """Cells, one for each column. why, exact: as of a column; first: of a group; beside: what qualifies the row above."""

    cells: tuple[str, ...]
    why: str = ""
    exact: bool = False
    first: bool = False
    beside: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """Columns and rows. strong: the column that answers, in bold; channels: the one naming channels, which are marked by
    their colours; -1 for none."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    strong: int = -1
    channels: int = -1

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row.cells) != len(self.columns):
                raise ValueError(
                    f"a row of {len(row.cells)} cells in a table of {len(self.columns)} columns: {row}"
                )

    @property
    def notes(self) -> dict[str, str]:
        """The letter of each reason, in the order they come in."""
        reasons = dict.fromkeys(
            [c.why for c in self.columns if c.why]
            + [row.why for row in self.rows if row.why]
        )
        return {why: ascii_lowercase[k] for k, why in enumerate(reasons)}

    @property
    def groups(self) -> list[list[Row]]:
        """Rows in groups that stay together on paper: each begins with a `first` row; without any, each row is one."""
        groups = list[list[Row]]()
        for row in self.rows:
            if row.first or not groups or not any(each.first for each in self.rows):
                groups.append([])
            groups[-1].append(row)
        return groups

    @property
    def units(self) -> bool:
        """Return whether any column has a unit."""
        return any(column.unit for column in self.columns)


def channel_columns(channels: Sequence[str], unit: str = "") -> Iterator[Column]:
    """A column for each channel."""
    return (Column(channel, unit, channel=channel) for channel in channels)


def by_range(results: Results) -> list[tuple[Wavefront, ...]]:
    """Return the fits in groups, a group for each range."""
    return [tuple(results.at_range(range_mm)) for range_mm in results.ranges_mm]


def listed(
    groups: Iterable[Iterable[Any]], *columns: Column, channels: int = -1, strong: int = -1
) -> Table:
    """Return a table with a row for each item of some groups, made by the columns' cells."""
    rows = [
        Row(tuple(column.cell(item) for column in columns), first=k == 0)
        for group in groups
        for k, item in enumerate(group)
    ]
    return Table(columns, tuple(rows), strong, channels)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A row of a table that compares channels.

    number: of an item of `compared`, or words in its place; least: fewest decimal places of a number; why, exact, first and
    beside: as of a `Row`
    """

    name: str
    unit: str
    number: Callable[[Any], Uncertain | str]
    least: int = 0
    why: str = ""
    exact: bool = False
    first: bool = False
    beside: bool = False

    def cell(self, item: Any) -> str:
        """Return the text of an item's number."""
        number = self.number(item)
        return number if isinstance(number, str) else estimated(number, least=self.least)


def compared(items: Sequence[Any], quantities: Iterable[Quantity], head: str = "") -> Table:
    """Return a table with a column for each item, which has a channel, and a row for each quantity."""
    columns = (
        Column(head, text=True),
        Column("", text=True),
        *channel_columns([item.channel for item in items]),
    )
    rows = [
        Row((q.name, q.unit, *map(q.cell, items)), q.why, q.exact, q.first, q.beside)
        for q in quantities
    ]
    return Table(columns, tuple(rows))


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
