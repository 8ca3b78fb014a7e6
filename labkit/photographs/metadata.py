"""Check what a photograph states in words and numbers, whatever program read it."""

from __future__ import annotations

import math
from collections.abc import Iterable

LONGEST_STATEMENT = 200
"""Characters of a name in a photograph's tags."""


def refuse_impossible(words: Iterable[str], numbers: Iterable[float | None]) -> None:
    """Raise ValueError for words that are long or not printable, and for numbers other than positive ones or None."""
    for text in words:
        if len(text) > LONGEST_STATEMENT or not text.isprintable():
            raise ValueError(
                f"a name of {len(text)} characters: allowed are {LONGEST_STATEMENT}, printable ones"
            )
    for number in numbers:
        if number is not None and not (math.isfinite(number) and number > 0):
            raise ValueError(f"{number:g} in its tags: allowed is a number above 0")
