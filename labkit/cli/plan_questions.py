"""`labkit plan --interactive`: a plan by questions, each answer checked as the plan is."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from labkit.devices.registry import installed
from labkit.errors import LabkitError, PlanError, shown
from labkit.panel.panels import PANELS, panel_info
from labkit.panel.picture import panel_picture
from labkit.plan import DisplaySettings, Plan
from labkit.plan.tables import BY_HAND, NEEDED_BY_KIND
from labkit.plan.text import message, numbers_meant, write_tables
from labkit.session.draft_plan import FILL_IN, Row, draft_tables
from labkit.spectra import COLOURS, LIGHT_KINDS
from labkit.target.grid import whole_target

Ask = Callable[[str, Callable[[str], Any], str], Any]
"""Puts a question with how to read its answer and a default; gives what was read."""

WORDS = {
    "lens.focal_length_mm": "Focal length as engraved, mm",
    "lens.f_number": "f-number as set on the lens",
    "sensor.pixel_pitch_um": "Pixel pitch, µm (sensor's width over pixels)",
    "sensor.cfa_pattern": "Filter array: RGGB and the like, mono, or RGB where every pixel has all colours",
    "sensor.black_level": "Count of no light",
    "sensor.white_level": "Count of saturation",
    "sensor.tone_curve": "How the numbers stand to light: linear or sRGB",
    "channel.wavelength_nm": "Wavelength of channel {name}, nm",
    "target.kind": "Kind of target: {kinds}",
    "target.order": "Order of the carpet, or octaves of the tri-bar target",
    "target.cells": "Cells along a side",
    "target.file": "Picture of the target, a file beside the plan",
    "target.grid": "Disks: rows, columns",
    "target.diameter_mm": "Diameter of a disk, mm",
    "target.size_mm": "Side of the whole target, mm",
    "target.surround": "What lies around the target: black, white or unknown",
    "camera.address": "Camera: gphoto2: for the one on USB (labkit devices lists all), gphoto2:ptpip:ADDRESS on a network",
    "camera.exposure_s": "Exposure, s (1/50 is fine)",
    "camera.iso": "ISO",
    "camera.frames_per_range": "Photographs of the target at each range",
    "camera.flats_per_range": "Photographs of white at each range",
    "camera.darks": "Photographs with the cap on",
    "rail.address": "Rail: manual: for one that you set by hand, or such as grbl:/dev/ttyUSB0",
    "rail.ranges_mm": "Ranges from the target to the lens, mm, with commas",
    "rail.range_at_zero_mm": "Range where the rail stands at 0, mm (labkit rail calibrate measures it)",
    "rail.direction": "Direction: 1 where a larger rail position is a longer range, else -1",
    "display.address": "Display: web://0.0.0.0:8642 for a tablet or browser, manual: for paper",
    "display.panel": "Panel: {panels}",
}
"""Questions by key; keys without a question keep the draft's value."""

CHANNEL = "[[channel]]"
UNKNOWN_LIGHT = "unknown"
LIGHT = (
    f"Light on the target, or of the panel: {', '.join(LIGHT_KINDS)}, or {UNKNOWN_LIGHT}"
)

EXAMPLES: Mapping[str, tuple[str, str]] = {
    "order": ("5", "of the carpet"),
    "cells": ("8", "along a side"),
    "file": ('"pattern.pgm"', "relative to this plan"),
    "grid": ("[7, 9]", "rows, columns"),
    "diameter_mm": ("2.0", "of a disk"),
}
"""Of what only some targets need: a value as TOML, and its comment."""

CAMERA_ROWS: tuple[Row, ...] = (
    ("address", '"gphoto2:"', "labkit devices lists what is connected"),
    ("exposure_s", "0.02", "so that white is two thirds of full: labkit camera test"),
    ("iso", "100", ""),
    ("frames_per_range", "4", "of the target"),
    ("flats_per_range", "8", "of white"),
    ("darks", "8", "with the cap on; 0 for none"),
)
RAIL: tuple[Row, ...] = (
    ("address", '"manual:"', "or such as grbl:/dev/ttyUSB0"),
    ("ranges_mm", "", "from the target to the lens"),
    (
        "range_at_zero_mm",
        "",
        f"{FILL_IN}range where the rail stands at 0: labkit rail calibrate",
    ),
    ("direction", "1", "1: a larger rail position is a longer range"),
)
DISPLAY: tuple[Row, ...] = (
    ("address", '"web://0.0.0.0:8642"', "its page is opened on the display"),
    ("panel", '"ipad-9.7-retina"', "or pixel_pitch_mm and pixels"),
)
RANGES = (1.0, 1.05, 1.1)
"""Of a first range, which is so many focal lengths or the target's sides away that the target fills a third of a frame."""


def plan_by_questions(
    ask: Ask, folder: Path, image: Path | None = None
) -> tuple[str, tuple[str, ...]]:
    """Return the text of a valid plan, and remarks on the plan.

    folder: of the future plan; image: gives defaults. Raises the errors of `ask`, and
    RawError for a file that is no photograph.
    """
    mono = (
        image is None
        and ask("Does the sensor have a colour filter array? yes or no", _yes_or_no, "yes")
        is False
    )
    heading, tables = draft_tables(image, mono)
    answers = _Answers(ask, folder)
    answers.blocks.append([*(heading or ["# Made by labkit plan --interactive."])])
    of_colours = len([name for name, _ in tables if name == CHANNEL]) == len(COLOURS)
    light = None
    for name, rows in tables:
        if name == CHANNEL and of_colours:
            light = light or ask(f"{LIGHT} (channel.light)", _kind_of_light, UNKNOWN_LIGHT)
            rows = _of_light(light, rows)
        answers.table(name, _of_kind(answers, rows) if name == "[target]" else iter(rows))
    if ask(
        "Will labkit take the photographs itself (camera, rail, display)? yes or no",
        _yes_or_no,
        "no",
    ):
        answers.table("[camera]", iter(CAMERA_ROWS))
        answers.table("[rail]", _with_ranges(answers))
        answers.table("[display]", _shown(answers))
    text = "\n\n".join("\n".join(block) for block in answers.blocks) + "\n"
    return text, tuple(_notes(Plan.parse(text, folder)))


class _Answers:
    """The answers so far, as tables and as lines. Each answer is checked together with all before."""

    def __init__(self, ask: Ask, folder: Path) -> None:
        self.blocks: list[list[str]] = []
        self.tables: dict[str, Any] = {}
        self._ask = ask
        self._folder = folder

    def table(self, name: str, rows: Iterator[Row]) -> None:
        """Ask for a table, row by row; a row may depend on earlier answers."""
        plain = name.strip("[]")
        block = [name]
        here: dict[str, Any] = {}
        if name.startswith("[["):
            self.tables.setdefault(plain, []).append(here)
        else:
            self.tables[plain] = here
        self.blocks.append(block)
        for key, default, why in rows:
            value = self._value(plain, here, key, default, known=FILL_IN not in why)
            here[key] = value
            why = why.removeprefix(FILL_IN)
            (line,) = write_tables({"t": {key: value}}).splitlines()[1:]
            block.append(line + (f"  # {why}" if why else ""))

    def _value(
        self, table: str, here: dict[str, Any], key: str, value: str, *, known: bool
    ) -> Any:
        """Ask for a value. A known value is the default; any other is only an example."""
        given = tomllib.loads(f"x = {value}")["x"] if value else ""
        words = WORDS.get(f"{table}.{key}")
        if words is None:
            return given
        words = words.format(
            name=here.get("name", ""),
            kinds=", ".join(_kinds()),
            panels=", ".join(sorted(PANELS)),
        )
        as_typed = (
            ", ".join(f"{x:g}" for x in given) if isinstance(given, list) else str(given)
        )

        def read(text: str) -> Any:
            if not text:
                raise PlanError(
                    f"{table}.{key} has no default: give it, such as {as_typed}"
                )
            value = _parsed(_without_unit(text, key), given)
            self._check(table, here, key, value)
            return value

        question = f"{words} ({table}.{key})"
        if known:
            return self._ask(question, read, as_typed)
        return self._ask(f"{question}, such as {as_typed}", read, "")

    def _check(self, table: str, here: dict[str, Any], key: str, value: Any) -> None:
        """Raise PlanError for an answer that the plan so far would reject."""
        if table == "target" and key == "kind" and value not in _kinds():
            raise PlanError(
                f"target.kind = {shown(value)}: allowed is {', '.join(_kinds())}"
            )
        if key == "address":
            scheme = str(value).partition(":")[0]
            if scheme not in installed(table):
                known = ", ".join(f"{name}:" for name in installed(table))
                raise PlanError(
                    f"{table}.address = {shown(value)}: allowed is one of {known} and where"
                )
        if key == "panel":
            panel_info(DisplaySettings.from_tables({**here, key: value}))
        tables = {**PLACEHOLDERS, **self.tables}
        filled = {**_stand_in(table, {**here, key: value}), **here, key: value}
        tables[table] = (
            [*self.tables[table][:-1], filled]
            if isinstance(tables.get(table), list)
            else filled
        )
        context = {"folder": self._folder, "files_needed": key == "file"}
        try:
            Plan.model_validate(tables, context=context)
        except ValidationError as error:
            raise PlanError(message(error, Plan, tables)) from None


PLACEHOLDERS: Mapping[str, Any] = {
    "lens": {"focal_length_mm": 50.0, "f_number": 2.8},
    "sensor": {"pixel_pitch_um": 4.0},
    "channel": [{"name": "G", "wavelength_nm": 550.0}],
    "target": {"kind": "sierpinski", "order": 5, "size_mm": 50.0},
}
"""In place of the tables that were not asked for yet."""


def _stand_in(table: str, here: Mapping[str, Any]) -> dict[str, Any]:
    """Return placeholders for the unanswered keys of a table."""
    if table == "target":
        needed = NEEDED_BY_KIND.get(str(here.get("kind")), ())
        return {
            "size_mm": 50.0,
            **{key: tomllib.loads(f"x = {EXAMPLES[key][0]}")["x"] for key in needed},
        }
    if table == "display" and here.get("address") == BY_HAND:
        return {}
    rows = {"camera": CAMERA_ROWS, "display": DISPLAY}.get(table, ())
    filled = {key: tomllib.loads(f"x = {value}")["x"] for key, value, _ in rows if value}
    if table == "rail":
        filled = {"ranges_mm": [9e5], "range_at_zero_mm": 0.0}
    if table == "channel":
        filled = {"wavelength_nm": 550.0}
    return {**dict(PLACEHOLDERS.get(table, {})), **filled} if table != "channel" else filled


def _of_kind(answers: _Answers, rows: list[Row]) -> Iterator[Row]:
    """Yield the target's rows: the kind, the keys of this kind, and the rest."""
    for key, value, why in rows:
        if key != "order":
            yield key, value, why
        if key == "kind":
            for needed in NEEDED_BY_KIND.get(answers.tables["target"]["kind"], ()):
                value, why = EXAMPLES[needed]
                yield needed, value, f"{FILL_IN}{why}"


def _with_ranges(answers: _Answers) -> Iterator[Row]:
    """Yield the rail's rows, with ranges at which the target fills a good part of a small frame."""
    lens = answers.tables["lens"]
    target = answers.tables["target"]
    first = float(
        f"{max(60 * float(target['size_mm']), 2 * float(lens['focal_length_mm'])):.1g}"
    )
    for key, value, why in RAIL:
        if key == "ranges_mm":
            value = f"[{', '.join(f'{first * step:.10g}' for step in RANGES)}]"
        if key == "range_at_zero_mm":
            value = f"{min(answers.tables['rail']['ranges_mm']) - 50:.10g}"
        yield key, value, why


def _shown(answers: _Answers) -> Iterator[Row]:
    address, panel = DISPLAY
    yield address
    if answers.tables["display"]["address"] != BY_HAND:
        yield panel


def _notes(plan: Plan) -> Iterator[str]:
    """Yield remarks on obstacles to a capture."""
    try:
        target = whole_target(plan.target)
        if plan.display is not None and not plan.display.by_hand:
            panel_picture(target, panel_info(plan.display))
    except LabkitError as error:
        yield str(error)


def _kinds() -> list[str]:
    return sorted(entry_points(group="labkit.targets").names)


def _of_light(light: str, rows: list[Row]) -> list[Row]:
    """A channel's rows, with the light in place of its wavelength where it is known."""
    if light == UNKNOWN_LIGHT:
        return rows
    named = ("light", f'"{light}"', "times the filters of the body, by labkit's tables")
    return [row for row in rows if not row[0].startswith("wavelength")] + [named]


def _kind_of_light(text: str) -> str:
    if text not in (*LIGHT_KINDS, UNKNOWN_LIGHT):
        raise PlanError(
            f"channel.light = {shown(text)}: allowed is one of {', '.join(LIGHT_KINDS)}, or {UNKNOWN_LIGHT}"
        )
    return text


def _yes_or_no(text: str) -> bool:
    if text.lower() not in ("yes", "y", "no", "n"):
        raise PlanError(f"{shown(text)}: allowed is yes or no")
    return text.lower().startswith("y")


UNIT_PATTERNS = {"_mm": "mm", "_um": "(?:[uµμ]m|microns?)", "_nm": "nm", "_s": "s"}
"""How people write the unit that a key ends in, as a regular expression."""


def _without_unit(text: str, key: str) -> str:
    """Return an answer without the unit of its key: people write "50 mm"."""
    for end, unit in UNIT_PATTERNS.items():
        if key.endswith(end):
            return re.sub(rf"(?<=[\d.,])\s*{unit}(?![a-z])", "", text)
    return text


def _parsed(text: str, like: Any) -> Any:
    """Return an answer in the type of its default.

    Text that is no number stays text, for the check to report.
    """
    if isinstance(like, list):
        return [_number(part) for part in re.split(r"[,;\s]+", text.strip("[] ")) if part]
    return _number(text) if isinstance(like, int | float) else text


def _number(text: str) -> Any:
    meant = numbers_meant(text)
    plain = meant[0] if len(meant) == 1 else text  # what is open is refused, with both
    for kind in (int, float):
        try:
            return kind(plain)
        except ValueError:
            continue
    return text
