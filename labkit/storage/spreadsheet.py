"""Tables as CSV that spreadsheets read as numbers and texts, and never as formulas."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from math import isfinite

import numpy as np

Cell = str | int | float | None

NO_LETTERS = r"[\s\0\u200b\ufeff]*"
"""White space and what a spreadsheet does not see at the beginning of a cell."""

FORMULA = re.compile(NO_LETTERS + "[=+\\-@\uff1d\uff0b\uff0d\uff20]")
"""The beginning of a formula; the last four signs are full-width forms, which Excel takes too."""

NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def csv_text(rows: Iterable[Sequence[Cell]]) -> str:
    """Return rows as CSV, RFC 4180; numbers that are not finite become empty cells, others have nine digits."""
    text = io.StringIO(newline="")
    # with this end of lines Python puts quotes around either of its two characters
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerows([_written(cell) for cell in row] for row in rows)
    return text.getvalue()


def _written(cell: Cell) -> Cell:
    """Return a cell as it is written; an apostrophe keeps a text from being a formula."""
    if isinstance(cell, str):
        harmless = NUMBER.fullmatch(cell) or not (
            FORMULA.match(cell) or cell[:1] in ("\t", "\r", "\n")
        )
        return cell if harmless else f"'{cell}"
    if isinstance(cell, float | np.floating):
        return f"{cell:.9g}" if isfinite(cell) else None
    return cell
