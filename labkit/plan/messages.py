"""Describe faults of tables in one line: field, value, what is allowed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from labkit.errors import LONGEST_VALUE, shown
from labkit.plan.fields import what_it_takes

Step = int | str

FOLLOWS = "default_factory_not_called"
"""Of a key left out whose default depends on a key that is wrong."""

MOST_PROBLEMS = 20
"""That one line names."""


def message(
    error: ValidationError, model: type[BaseModel], tables: Mapping[str, Any]
) -> str:
    """Describe all faults of `tables` that are no `model` in one line, unknown keys first.

    A misspelt key is often missing as well: its name is more helpful. A list is called too
    short when its values are wrong.
    """
    details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    within = {
        detail["loc"][:end] for detail in details for end in range(len(detail["loc"]))
    }
    details = [
        detail
        for detail in details
        if (detail["type"] != "too_short" or detail["loc"] not in within)
        and detail["type"] != FOLLOWS
    ]
    named = details[:MOST_PROBLEMS]
    problems = dict.fromkeys(_problem(detail, model, tables) for detail in named)
    more = len(details) - len(named)
    return "; ".join([*problems, *([f"and {more} more problems"] if more else [])])


def plain_number(text: str) -> str | None:
    """Return the number meant by a fraction, an engraved f-number or a decimal comma; None for other text."""
    if fraction := re.fullmatch(
        r"\s*(\d{1,9}(?:\.\d{1,9})?)\s*/\s*(\d{1,9}(?:\.\d{1,9})?)\s*s?\s*", text
    ):
        over = float(fraction[1])
        under = float(fraction[2])
        return f"{over / under:.6g}" if under else None
    if engraved := re.fullmatch(r"\s*[fF]\s*[/:]?\s*(\d{1,9}(?:[.,]\d{1,9})?)\s*", text):
        return engraved[1].replace(",", ".")
    comma = re.fullmatch(r"\s*([+-]?\d{1,9}),(\d{1,9})\s*", text)
    return f"{comma[1]}.{comma[2]}" if comma else None


def dotted(steps: Iterable[Step]) -> str:
    """Return keys as TOML writes them, long keys shortened."""
    keys = [str(step) for step in steps]
    return ".".join(
        key if len(key) <= LONGEST_VALUE else f"{key[: LONGEST_VALUE - 3]}..."
        for key in keys
    )


def _problem(
    detail: ErrorDetails, model: type[BaseModel], tables: Mapping[str, Any]
) -> str:
    """Return one fault in words."""
    loc, value = _whole_field(detail["loc"], tables)
    where = _where(loc, tables)
    match detail["type"]:
        case "problem":
            return f"{where}.{detail['msg']}" if where else detail["msg"]
        case "extra_forbidden":
            return _unknown_key(loc, where, model)
        case "missing" if loc == detail["loc"]:
            needs = _needs(loc, model)
            return f"{where} is missing" + (f": needs {needs}" if needs else "")
        case "allowed":
            reason = detail["msg"]
        case "model_type":
            reason = "allowed is a table"
        case _:
            expected = detail["msg"].removeprefix("Input should be ")
            reason = f"allowed is {_needs(loc, model) or expected}"
    if loc == ("channel",) and isinstance(value, Mapping):
        return "[channel] is one table: write [[channel]], with double brackets, once for each channel"
    meant = plain_number(value) if isinstance(value, str) else None
    return f"{where} = {shown(value)}: {reason}" + (f"; write {meant}" if meant else "")


def _whole_field(
    loc: tuple[Step, ...], tables: Mapping[str, Any]
) -> tuple[tuple[Step, ...], Any]:
    """Return a location without indices into the field's list, and the field's value; None if missing."""
    value: Any = tables
    for depth, step in enumerate(loc):
        inner = value.get(step) if isinstance(value, Mapping) else None
        if isinstance(step, int):
            if loc[depth - 1 : depth] != ("channel",) or not isinstance(value, list):
                return loc[:depth], value
            inner = value[step]
        value = inner
    return loc, value


def _where(loc: tuple[Step, ...], tables: Mapping[str, Any]) -> str:
    """Return a location in the plan's words: a channel by its name, or by its number if the name is wrong."""
    if len(loc) < 2 or not isinstance(loc[1], int):
        return dotted(loc)
    channel = tables["channel"][loc[1]]
    name = channel.get("name") if isinstance(channel, Mapping) else None
    if loc[2:] == ("name",) and name is not None:
        return "channel.name"
    named = isinstance(name, str) and len(name) <= LONGEST_VALUE
    return dotted(
        [f'channel "{name}"' if named else f"[[channel]] number {loc[1] + 1}", *loc[2:]]
    )


def _model_at(loc: tuple[Step, ...], model: type[BaseModel]) -> type[BaseModel]:
    """Return the model of the table at a location."""
    for step in loc[:-1]:
        if isinstance(step, str) and step in model.model_fields:
            model = next(_models(model.model_fields[step].annotation), model)
    return model


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _unknown_key(loc: tuple[Step, ...], where: str, model: type[BaseModel]) -> str:
    known = list(_model_at(loc, model).model_fields)
    given = str(loc[-1])
    # a key without its unit, such as tilt for tilt_um_per_mm
    near = difflib.get_close_matches(given, known, n=1) or [
        name for name in known if name.startswith(f"{given}_")
    ]
    hint = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
    return f"{where} is no known key; {hint}"


def _needs(loc: tuple[Step, ...], model: type[BaseModel]) -> str:
    """Return in words which values a field takes; empty if the type says enough."""
    field = _model_at(loc, model).model_fields.get(str(loc[-1])) if loc else None
    return "" if field is None else what_it_takes(field)
