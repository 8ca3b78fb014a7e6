"""A finding: a statement of an estimate about itself, as data and as a sentence."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from labkit.key import Key
from labkit.types import JSON

NOTE = "note"
"""The code of a warning in results of schema 1 and 2, which have no codes."""

KEBAB_CASE = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding's code, wavefront, numbers and sentence.

    Parameters
    ----------
    code : kebab-case; a code never changes its meaning
    key : the wavefront concerned; without a range, all wavefronts of its channel; None: the
        session
    numbers : JSON, the unit at the end of each name; a number that is not finite becomes
        None
    text : one sentence with the numbers
    warns : whether a user should see the text as a warning

    Raises
    ------
    ValueError
        `code` is not in kebab-case.
    TypeError
        `numbers` are not JSON.
    """

    code: str
    key: Key | None
    numbers: Mapping[str, JSON]
    text: str
    warns: bool = True

    def __post_init__(self) -> None:
        if not KEBAB_CASE.fullmatch(self.code):
            raise ValueError(
                f"code {self.code!r}: allowed are lower-case words with hyphens between"
            )
        object.__setattr__(
            self, "numbers", {name: _plain(value) for name, value in self.numbers.items()}
        )

    def __str__(self) -> str:
        return self.text

    def as_json(self) -> dict[str, JSON]:
        """Return an entry of "findings" in results.json; `warns` shows in "warnings"."""
        where = (
            {"range_mm": None, "channel": None, "tile": None}
            if self.key is None
            else self.key.as_json()
        )
        return {
            "code": self.code,
            "where": where,
            "numbers": self.numbers,
            "text": self.text,
        }

    @classmethod
    def from_json(cls, entry: Mapping[str, Any], warnings: Collection[str]) -> Finding:
        """Read a finding written by `as_json`.

        Parameters
        ----------
        warnings : the texts of all findings that warn

        Raises
        ------
        KeyError, TypeError, ValueError
            `entry` is not a finding.
        """
        where, text = entry["where"], str(entry["text"])
        key = None if where["channel"] is None else Key.from_json(where)
        return cls(str(entry["code"]), key, dict(entry["numbers"]), text, text in warnings)


def each_once(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings without repetitions."""
    first = dict[str, Finding]()
    for finding in findings:
        first.setdefault(finding.text, finding)
    return list(first.values())


def _plain(value: JSON) -> JSON:
    """Return a value as JSON stores and returns it."""
    if isinstance(value, Mapping):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):  # NumPy's too
        return float(value) if isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{value!r} is no number, text, list or table")
