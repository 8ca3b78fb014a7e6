"""Make a session of photographs taken elsewhere, listed in a CSV."""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from sys import maxsize
from typing import Any

import numpy as np

from labkit.errors import DataError, InputError, RawError, TargetError, shown
from labkit.finder.cut import cut_around
from labkit.finder.lattice import find_targets
from labkit.findings.findings import Finding
from labkit.photographs.alterations import Alterations, alterations
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import difference, exposure_problem
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.plan.fields import LONGEST_PATH, joined
from labkit.plan.sensor import MONO
from labkit.plan.text import numbers_meant
from labkit.session.making import made_beside, refuse_existing
from labkit.session.session import Session
from labkit.session.stated import contradictions
from labkit.session.stored_plan import plan_source
from labkit.storage.reading import read_text
from labkit.target.target import open_target
from labkit.types import FRAME_KINDS, FrameKind, Progress, no_progress

COLUMNS = ("file", "kind", "range_mm")


MOST_LINES, MOST_COLUMNS, LONGEST_LIST = 20_000, 200, 2**22
"""Limits of a list: each photograph is decoded, so that a list in use has some hundred lines."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the CSV: a photograph, and the further columns unchanged."""

    line: int
    file: str
    path: Path
    kind: FrameKind
    range_mm: float | None
    further: dict[str, str]


QUOTED = re.compile(r"""'[^']*'|"[^"]*"|; write .*|of \d+ characters""")
"""Quoted cell in a message: messages that differ only in this quotation are of one kind."""


@dataclass(frozen=True, slots=True)
class _Checked:
    """Properties of a usable photograph; notes: on its numbers; altered: changes made by a program."""

    exposure_s: float | None
    iso: int | None
    notes: tuple[Finding, ...]
    altered: tuple[str, ...]


def import_frames(
    csv_path: Path | str,
    plan: Plan | Path | str,
    session_folder: Path | str,
    progress: Progress = no_progress,
) -> Session:
    """Make a session of the photographs listed in `csv_path`; all are checked first.

    Parameters
    ----------
    csv_path : columns file, kind, range_mm
    plan : or its path
    session_folder : to make
    progress : called with each step

    Returns
    -------
    The session, open to read; its `warnings` name contradictions between files and plan,
    and changes to processed pictures

    Raises
    ------
    DataError
        every fault of the CSV and its photographs in one line; nothing has been made
    PlanError, TargetError, SessionError
        as their names say; nothing has been made

    >>> session = labkit.import_frames("frames.csv", "plan.toml", "night-3")
    """
    if Path(csv_path).suffix == ".toml" and Path(str(plan)).suffix == ".csv":
        raise DataError(f"{csv_path} is the plan, {plan} the list: give the list first")
    csv_path = Path(csv_path)
    session_folder = Path(session_folder)
    source = plan_source(plan)
    open_target(source.plan.target)
    refuse_existing(session_folder)
    rows = read_rows(csv_path, source.plan)
    checked = _check_photographs(csv_path, rows, source.plan, progress)
    with (
        made_beside(session_folder, "import") as beside,
        Session.create(beside, source.text, source.folder) as session,
    ):
        names = _names(rows)
        for done, (row, name, found) in enumerate(zip(rows, names, checked, strict=True)):
            progress(len(rows) + done, 2 * len(rows), f"copying {row.file}")
            meta: dict[str, Any] = {
                "exposure_s": found.exposure_s,
                "iso": found.iso,
                "origin": row.file,
            }
            if found.altered:
                meta["altered"] = list(found.altered)
            if row.further:
                meta["columns"] = row.further
            session.add_frame(row.path, name, row.kind, row.range_mm, **meta)
    made = Session.open(session_folder)
    stated = contradictions(((row.file, row.kind, row.path) for row in rows), source.plan)
    notes = [note for found in checked for note in (*found.notes, *found.altered)]
    made.warnings = tuple(dict.fromkeys([*made.warnings, *map(str, [*stated, *notes])]))
    return made


def read_rows(csv_path: Path, plan: Plan) -> list[Row]:
    """Return the rows of a CSV, checked against the plan. Raises DataError with all faults in one line."""
    header, lines = _read_cells(csv_path)
    folder = csv_path.parent.resolve()
    rows = list[Row]()
    problems = list[tuple[str, str]]()
    for line, cells in lines:
        try:
            rows.append(_row(folder, line, header, cells, plan))
        except InputError as error:
            problems.append((f"line {line}: {error}", QUOTED.sub("", str(error))))
    first_line: dict[Path, int] = {}
    for row in rows:
        if (first := first_line.setdefault(row.path, row.line)) != row.line:
            words = f"line {row.line}: {row.file} stands in line {first} already"
            problems.append((words, "already"))
    if not problems and not _targets(rows) and not _photon_transfer(rows):
        words = "no photograph of kind target: at least one is needed, or flats and darks for labkit noise"
        problems.append((words, words))
    _refuse(csv_path, _each_once(problems, "lines"))
    return rows


def _targets(rows: Sequence[Row]) -> bool:
    return any(row.kind == "target" for row in rows)


def _photon_transfer(rows: Sequence[Row]) -> bool:
    """Return whether the list is a photon-transfer series, whose flats may be as dark or as bright as any."""
    kinds = Counter(row.kind for row in rows)
    return not _targets(rows) and min(kinds["flat"], kinds["dark"]) > 1


def _refuse(csv_path: Path, problems: list[str]) -> None:
    """Raise DataError with all faults in one line; do nothing without faults."""
    if problems:
        raise DataError(f"{csv_path}: {joined(problems)}")


def _read_cells(csv_path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header, and number and cells of each line that is not empty.

    Cells are separated by commas, or else by semicolons.
    """
    try:
        text = read_text(csv_path, 4 * LONGEST_LIST, follow_link=True)
    except OSError as error:
        raise DataError(f"{csv_path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{csv_path}: not UTF-8 at byte {error.start}") from error
    if len(text) > LONGEST_LIST:
        raise DataError(_too_long(csv_path, f"{LONGEST_LIST} characters"))
    first = text.partition("\n")[0]
    reader = csv.reader(
        io.StringIO(text, newline=""),
        delimiter=";" if "," not in first else ",",
        strict=True,
    )
    lines: list[tuple[int, list[str]]] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        if len(header) > MOST_COLUMNS:
            raise DataError(
                f"{csv_path}: the header has {len(header)} columns; allowed are {MOST_COLUMNS}"
            )
        for cells in reader:
            if reader.line_num > MOST_LINES:
                raise DataError(_too_long(csv_path, f"{MOST_LINES} lines"))
            lines.append((reader.line_num, [cell.strip() for cell in cells]))
    except csv.Error as error:
        raise DataError(f"{csv_path}: line {reader.line_num}: not CSV: {error}") from error
    if missing := [name for name in COLUMNS if name not in header]:
        words = f"it must hold {','.join(COLUMNS)}, with commas or semicolons between"
        raise DataError(f"{csv_path}: the header lacks {', '.join(missing)}; {words}")
    if twice := [name for name, times in Counter(header).items() if times > 1 and name]:
        raise DataError(
            f"{csv_path}: a column stands twice in the header: {shown(twice[0])}"
        )
    return header, [(line, cells) for line, cells in lines if any(cells)]


def _too_long(csv_path: Path, limit: str) -> str:
    return f"{csv_path}: has more than {limit}; make several lists and sessions of it"


def _row(folder: Path, line: int, header: list[str], cells: list[str], plan: Plan) -> Row:
    if any(cells[len(header) :]):
        raise DataError(
            f"{len(cells)} cells, but the header has {len(header)}: put quotes around text with a separator"
        )
    cell = dict(zip_longest(header, cells[: len(header)], fillvalue=""))
    kind = cell["kind"]
    if kind not in FRAME_KINDS:
        raise DataError(f"kind {shown(kind)}: allowed is {', '.join(FRAME_KINDS)}")
    return Row(
        line=line,
        file=cell["file"],
        path=_inside(folder, cell["file"]),
        kind=kind,
        range_mm=_range(cell["range_mm"], plan),
        further={name: text for name, text in cell.items() if name and name not in COLUMNS},
    )


def _inside(folder: Path, file: str) -> Path:
    """Return the real path of a file that must be in the folder, whose path is real; links are followed."""
    if not file:
        raise DataError("file is empty")
    if len(file) > LONGEST_PATH:
        raise DataError(
            f"file {shown(file)}: a path of {len(file)} characters; allowed are {LONGEST_PATH}"
        )
    try:
        path = (folder / file).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"file {shown(file)} is no usable path ({error})") from error
    if not path.is_relative_to(folder):
        raise DataError(
            f"file {shown(file)} lies outside the CSV's folder; move it into {folder}"
        )
    return path


def _range(text: str, plan: Plan) -> float | None:
    if not text:
        return None
    focal_mm = plan.lens.focal_length_mm
    try:
        range_mm = float(text)
    except ValueError:
        range_mm = math.nan
    if not (math.isfinite(range_mm) and range_mm > focal_mm):
        words = f"allowed is nothing, or a number of mm, not of m, above the focal length, {focal_mm:g} mm"
        raise DataError(f"range_mm {shown(text)}: {words}{_advice(text, focal_mm)}")
    return range_mm


def _advice(text: str, focal_mm: float) -> str:
    """Return what to write for a range in another notation or in metres, if allowed; else nothing."""
    readings = numbers_meant(text, "mm")
    if allowed := [one for one in readings if float(one) > focal_mm]:
        return f"; write {' or '.join(allowed)}"
    in_metres = [one for one in readings if 1000 * float(one) > focal_mm]
    return (
        f"; write {1000 * float(in_metres[0]):.10g} for {in_metres[0]} m"
        if in_metres
        else ""
    )


def _check_photographs(
    csv_path: Path, rows: list[Row], plan: Plan, progress: Progress
) -> list[_Checked]:
    """Decode every photograph. Raises DataError with all faults in one line."""
    checked: list[_Checked] = []
    problems: list[tuple[str, str]] = []
    first: Photograph | None = None
    series = _photon_transfer(rows)
    places = _Places(rows, plan)
    for done, row in enumerate(rows):
        progress(done, 2 * len(rows), f"checking {row.file}")
        try:
            mosaic = read_photograph(row.path, plan.sensor)
        except RawError as error:
            problems.append((str(error), str(error).replace(str(row.path), "")))
            continue
        if first is None:
            first = mosaic.cropped((slice(0, 0), slice(0, 0)))  # its pixels are in the way
            if wrong := _channel_problem(mosaic, plan):
                raise DataError(f"{csv_path}: {row.file}: {wrong}")
        lit = row.kind == "target" or (row.kind == "flat" and not series)
        altered = alterations(mosaic) if lit else Alterations()
        problem = difference(mosaic, first)
        if not (series and row.kind == "flat"):
            problem = problem or _light_problem(mosaic, row, places)
        if problem := problem or altered.refusal:
            problems.append((f"{row.file} {problem}", problem))
        checked.append(_Checked(mosaic.exposure_s, mosaic.iso, mosaic.notes, altered.notes))
    _refuse(csv_path, _each_once(problems, "files"))
    return checked


@dataclass(frozen=True)
class _Places:
    """Places of the target in the frame, by range, each searched for when a photograph needs it."""

    rows: list[Row]
    plan: Plan
    known: dict[float | None, Cut] = field(default_factory=dict)

    def of(self, row: Row) -> Cut:
        """Return rows and columns around the target at a row's range, or at the first; all where it is not found."""
        targets = [one for one in self.rows if one.kind == "target"]
        here = [one for one in targets if one.range_mm == row.range_mm] or targets
        if not here:
            return WHOLE
        if here[0].range_mm not in self.known:
            self.known[here[0].range_mm] = self._searched(here[0])
        return self.known[here[0].range_mm]

    def _searched(self, row: Row) -> Cut:
        if (given := self.plan.target.corners_px) is not None:
            return cut_around([np.array(given, float)], (maxsize, maxsize))
        try:
            mosaic = read_photograph(row.path, self.plan.sensor)
            return cut_around(list(find_targets(mosaic, self.plan.target)), mosaic.shape)
        except (RawError, TargetError):
            return WHOLE


def _light_problem(mosaic: Photograph, row: Row, places: _Places) -> str | None:
    """Return a fault of the light: in the whole frame and on the target, for a window beside it may be overexposed."""
    names = [channel.name for channel in places.plan.channel]
    problem = exposure_problem(mosaic, row.kind, names)
    if problem is None or row.kind not in ("target", "flat"):
        return problem
    return exposure_problem(mosaic, row.kind, names, places.of(row))


def _each_once(problems: Sequence[tuple[str, str]], of: str) -> list[str]:
    """Return messages without repetitions, given with their text apart from file and line."""
    times = Counter(what for _, what in problems)
    firsts = dict[str, str]()
    for words, what in problems:
        firsts.setdefault(what, words)
    return [
        words + (f" (and {times[what] - 1} more {of} like it)" if times[what] > 1 else "")
        for what, words in firsts.items()
    ]


def _channel_problem(mosaic: Photograph, plan: Plan) -> str | None:
    names = [channel.name for channel in plan.channel]
    if mosaic.pattern == MONO:
        return (
            None
            if len(names) == 1
            else f"is mono, but the plan has {len(names)} [[channel]] tables: allowed is one"
        )
    unknown = [name for name in names if name not in mosaic.cfa]
    return (
        f"has no channel {', '.join(unknown)}: its filter array is {mosaic.cfa}"
        if unknown
        else None
    )


def _names(rows: list[Row]) -> list[str]:
    """Return a name in frames/ for each row: its file's name if possible, safe and unique."""
    names: list[str] = []
    taken: set[str] = set()
    for row in rows:
        name = (
            re.sub(r"[^A-Za-z0-9._-]", "_", row.path.name)[-160:].lstrip("._-") or "frame"
        )
        if name.lower() in taken:
            name = f"{row.line}_{name}"
        while name.lower() in taken:
            name = f"x{name}"
        taken.add(name.lower())
        names.append(name)
    return names
