"""A table of the report: each number has its standard error, or its column or row the reason why it has none.

Reasons are marked by letters and stand below the table; `tests/unit/test_report_numbers.py` walks the page and holds it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from string import ascii_lowercase


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    text: set to the left; channel: marked by that channel's colour; why: the reason why its numbers have no error; exact: its
    numbers cannot have one, being definitions, counts or errors themselves.
    """

    label: str
    unit: str = ""
    text: bool = False
    channel: str = ""
    why: str = ""
    exact: bool = False


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
    """Columns and rows. strong: the column that answers, in bold; channels: the one that names channels, which are marked by
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
        """Whether any column has a unit."""
        return any(column.unit for column in self.columns)


def channel_columns(channels: Sequence[str], unit: str = "") -> Iterator[Column]:
    """A column for each channel."""
    return (Column(channel, unit, channel=channel) for channel in channels)
