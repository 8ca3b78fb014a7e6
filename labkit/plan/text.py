"""Read plans in TOML, and write them so that they read back the same."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from labkit.errors import LONGEST_VALUE, PlanError, shown
from labkit.files import refuse_special
from labkit.plan.messages import dotted, plain_number

DEEPEST_TABLE = 6
"""Tables and lists in one another: corners stand three deep, and what is deeper is no plan."""

TOO_DEEP = "not TOML that can be read: lists or tables too deep in one another"

KEY = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.){0,256}+"|'[^'\n]{0,256}+')"""
LONG_KEY = re.compile(rf"(?<![\w-])(?:{KEY}\s*+\.\s*+){{64}}")
"""A dotted key, its parts bare or in quotes: tomllib takes minutes for one of 20,000 parts."""

MOST_CHARACTERS = 2**18
"""Of a plan: of those in use the longest has some thousand."""


def read_text(path: Path) -> str:
    """Return a plan's text without a byte order mark. Raises PlanError for a missing file or one not in UTF-8."""
    try:
        refuse_special(path)
        with path.open(encoding="utf-8-sig") as file:
            return file.read(MOST_CHARACTERS + 1)  # what is longer is refused
    except IsADirectoryError as error:
        plan = path / "plan.toml"
        raise PlanError(
            f"is a folder: give {plan if plan.exists() else 'the plan in it'}"
        ) from error
    except OSError as error:
        raise PlanError(str(error.strerror)) from error
    except UnicodeDecodeError as error:
        raise PlanError(f"not UTF-8 at byte {error.start}") from error


def read_tables(text: str) -> dict[str, Any]:
    """Return the tables in TOML. Raises PlanError that names the line."""
    text = text.removeprefix("\ufeff")
    if len(text) > MOST_CHARACTERS:
        raise PlanError(f"has more than {MOST_CHARACTERS} characters: no plan is as long")
    if LONG_KEY.search(text):
        raise PlanError(TOO_DEEP)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlanError(f"not TOML: {_place(str(error), text)}") from error
    except ValueError as error:  # Python converts no more than 4,300 digits
        raise PlanError("not TOML: an integer of more than 64 bits") from error
    except RecursionError:
        raise PlanError(TOO_DEEP) from None


def write_tables(tables: Mapping[str, Any]) -> str:
    """Return TOML of tables and lists of tables whose values are plain."""
    blocks = []
    for name, value in tables.items():
        if isinstance(value, Mapping):
            blocks.append([f"[{name}]", *_pairs(value)])
        else:
            blocks += [[f"[[{name}]]", *_pairs(item)] for item in value]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def plain(value: Any, *where: str) -> Any:
    """Return a value as TOML has it: tables, lists, text and Python's own numbers, without keys that hold None.

    where: the keys that lead to the value. Raises PlanError for integers of more than 64
    bits and for values nested too deeply.
    """
    if len(where) > DEEPEST_TABLE:
        raise PlanError(
            f"{dotted(where[:2])}: lists or tables more than {DEEPEST_TABLE} deep in one another"
        )
    match value:
        case None | bool() | str():
            return value
        case Integral():
            if not -(2**63) <= int(value) < 2**63:
                raise PlanError(f"{dotted(where)}: an integer of more than 64 bits")
            return int(value)
        case Real():
            return float(value)
        case Path():
            return str(value)
        case BaseModel():
            return plain(value.model_dump(exclude_unset=True), *where)
        case Mapping():
            return {
                str(key): plain(item, *where, str(key))
                for key, item in value.items()
                if item is not None
            }
        case Iterable():
            return [plain(item, *where, str(place)) for place, item in enumerate(value)]
    return value


def _place(words: str, text: str) -> str:
    """Return an error of tomllib with the line it names, and a hint."""
    at = re.search(r" \(at line (\d+),[^)]*\)$", words)
    lines = text.split("\n")
    if not at or int(at[1]) > len(lines):
        return words
    line = lines[int(at[1]) - 1].strip()
    meant = plain_number(line.partition("=")[2].partition("#")[0])
    reason = words[: at.start()]  # it may repeat a key, however long
    cut = (
        reason if len(reason) <= 2 * LONGEST_VALUE else f"{reason[: 2 * LONGEST_VALUE]}..."
    )
    return f"{cut}{at[0]}: {shown(line)}" + (f"; write {meant}" if meant else "")


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items()]


def _value(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            # JSON's escapes are TOML's, but for the delete character
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case Mapping():
            return f"{{ {', '.join(_pairs(value))} }}"
        case list():
            return f"[{', '.join(_value(item) for item in value)}]"
    return repr(value)
