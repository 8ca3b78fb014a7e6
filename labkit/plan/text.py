"""Read plans in TOML, write them so that they read back the same, and describe their faults in one line."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from labkit.errors import LONGEST_VALUE, PlanError, shown
from labkit.plan.fields import MOST_PROBLEMS, joined, what_it_takes
from labkit.storage import reading

DEEPEST_TABLE = 6
"""Deepest nesting of tables and lists: corners are nested three deep."""

TOO_DEEP = "not TOML that can be read: lists or tables too deep in one another"

MOST_DOTS = 16
"""Number of dots of a dotted key: tomllib's time and memory grow with the square of the parts."""

QUOTED_OR_COMMENT = re.compile(
    r""""{3}(?:[^"\\]++|\\.|"(?!""))*+"{0,5}|"(?:[^"\\\n]++|\\.)*+"?"""
    r"""|'{3}(?:[^']++|'(?!''))*+'{0,5}|'[^'\n]*+'?|\#[^\n]*+""",
    re.DOTALL,
)
"""A string or a comment, or one that the text ends in: a match is never tried twice, so that a search is linear."""

BETWEEN_KEYS = re.compile(r"[=,\[\]{}\n]")

MOST_CHARACTERS = 2**18
"""Longest plan read: plans in use have some thousand characters."""

MOST_PLAN_BYTES = 4 * MOST_CHARACTERS
"""Of a plan's file: a character takes up to four bytes."""

Step = int | str

FOLLOWS = "default_factory_not_called"
"""Type of the error for a missing key whose default depends on a wrong key."""


def read_text(path: Path, *, follow_link: bool = True) -> str:
    """Return a plan's text without a byte order mark. Raises PlanError for a missing file or one not in UTF-8.

    follow_link : whether the file may be a link, as one that the user names may
    """
    try:
        return reading.read_text(path, MOST_PLAN_BYTES, follow_link=follow_link)
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
    """Return the tables in TOML. Raises PlanError naming the line."""
    text = text.removeprefix("\ufeff")
    if len(text) > MOST_CHARACTERS:
        raise PlanError(f"has more than {MOST_CHARACTERS} characters: no plan is as long")
    keys = BETWEEN_KEYS.split(QUOTED_OR_COMMENT.sub("", text))
    if max(key.count(".") for key in keys) > MOST_DOTS:
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
    key, _, value = line.partition("=")
    reason = words[: at.start()]  # it may repeat a key, however long
    cut = (
        reason if len(reason) <= 2 * LONGEST_VALUE else f"{reason[: 2 * LONGEST_VALUE]}..."
    )
    return f"{cut}{at[0]}: {shown(line)}{_advice(value.partition('#')[0], key.strip())}"


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


def message(
    error: ValidationError, model: type[BaseModel], tables: Mapping[str, Any]
) -> str:
    """Describe in one line all faults of `tables` as a `model`, unknown keys first.

    A misspelt key is often missing as well: the wrong name is more helpful. Pydantic calls
    a list too short if its values are wrong.
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
    return joined([*problems], len(details) - len(named))


SEPARATORS = str.maketrans(
    {
        "\u2212": "-",
        "\u066b": ".",
        "\u066c": ",",
        "\u02bc": "'",
        "\u2018": "'",
        "\u2019": "'",
        "\u00b4": "'",
        "`": "'",
        "_": "'",
    }
)
"""Minus, Arabic separators and apostrophes of any kind, as they are on a keyboard."""

DIGITS_WITH_MARKS = re.compile(r"([+-]?)(\d[\d., ']{0,40})")
GROUPED = re.compile(r"\d{1,3}(?:[., ']\d{2,3})*[., ']\d{3}")

LENGTHS_MM = {
    "nm": 1e-6,
    "um": 1e-3,
    "\u03bcm": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "dm": 100.0,
    "m": 1000.0,
    "in": 25.4,
    "inch": 25.4,
    '"': 25.4,
    "ft": 304.8,
}


def numbers_meant(text: str, unit: str = "") -> tuple[str, ...]:
    """Return what a number in another notation may mean, the likeliest first; empty for other text.

    Understood are fractions, engraved f-numbers, decimal commas, thousands that are set apart, digits of any script, and units.
    "1,500" may be 1.500 or 1500.

    Parameters
    ----------
    text : as somebody wrote it
    unit : of the numbers returned; lengths in other units are converted
    """
    if len(text) > LONGEST_VALUE:
        return ()
    text = unicodedata.normalize("NFKC", text).translate(SEPARATORS).strip()
    text = "".join(str(unicodedata.decimal(c)) if c.isdecimal() else c for c in text)
    if fraction := re.fullmatch(
        r"(\d{1,9}(?:\.\d{1,9})?)\s*/\s*(\d{1,9}(?:\.\d{1,9})?)\s*s?", text
    ):
        over = float(fraction[1])
        under = float(fraction[2])
        return (f"{over / under:.6g}",) if under else ()
    text = re.sub(r"^[fF]\s*[/:]?\s*(?=\d)", "", text)
    stated = re.search(r"(?<=[\d.,])\s*([^\W\d_]+|\")$", text)
    if stated is None:
        return _readings(text)
    readings = _readings(text[: stated.start()])
    if stated[1] == unit:
        return readings
    if stated[1] not in LENGTHS_MM or unit not in LENGTHS_MM:
        return ()
    times = LENGTHS_MM[stated[1]] / LENGTHS_MM[unit]
    return tuple(f"{float(one) * times:.10g}" for one in readings)


def _readings(text: str) -> tuple[str, ...]:
    """Return the numbers that digits with points, commas, spaces and apostrophes between them may mean."""
    number = DIGITS_WITH_MARKS.fullmatch(text.strip())
    if number is None:
        return ()
    sign, body = number.groups()
    whole, mark, decimals = body, "", ""
    if last := re.search(r"[.,](?=\d*$)", body):
        whole, mark, decimals = body[: last.start()], last[0], body[last.end() :]
    readings = list[str]()
    apart = mark == "" or mark not in whole
    if apart and (whole.isdecimal() or GROUPED.fullmatch(whole)):
        # of a number that is grouped with points a comma is decimal, and the other way round
        digits = re.sub(r"\D", "", whole)
        readings.append(f"{digits}.{decimals}" if decimals else digits)
    if (
        mark
        and GROUPED.fullmatch(body)
        and len({*re.sub(r"\d", "", body)}) == 1
        and body[0] != "0"
    ):
        readings.append(re.sub(r"\D", "", body))
    return tuple(sign.removeprefix("+") + one for one in readings)


def _advice(text: str, key: str) -> str:
    """Return "; write NUMBER" for a number written in another notation or unit than its key's, else nothing."""
    meant = numbers_meant(text, key.rpartition("_")[2])
    return f"; write {' or '.join(meant)}" if meant else ""


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
    advice = _advice(value, where) if isinstance(value, str) else ""
    return f"{where} = {shown(value)}: {reason}{advice}"


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
