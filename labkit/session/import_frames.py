"""A session made of photographs taken elsewhere: a CSV says what each one is."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labkit.errors import DataError, InputError, RawError
from labkit.files import sync_folder
from labkit.plan import Plan, load_plan
from labkit.raw.decode import read_raw
from labkit.raw.frame_quality import difference, exposure_problem
from labkit.raw.mosaic import MONO, Mosaic
from labkit.session.session import Session, refuse_existing
from labkit.target import open_target
from labkit.types import FRAME_KINDS, FrameKind, Progress

COLUMNS = ("file", "kind", "range_mm")


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the CSV: a photograph, and the further columns as they were."""

    line: int
    file: str
    path: Path
    kind: FrameKind
    range_mm: float | None
    further: dict[str, str]


def import_frames(
    csv_path: Path, plan_path: Path, session_folder: Path, progress: Progress = lambda done, total, step: None
) -> Session:
    """Make a session of the photographs that `csv_path` lists. Everything is checked first; then it is made whole.

    Returns the session, open to read.
    Raises PlanError, TargetError, SessionError, or DataError with every problem of the CSV and its photographs in one
    line; then nothing has been made.
    """
    plan = load_plan(plan_path)
    open_target(plan.target)
    refuse_existing(session_folder)
    rows = read_rows(csv_path, plan)
    mosaics = _check_photographs(csv_path, rows, plan, progress)
    beside = session_folder.parent / f".{session_folder.name}.{os.getpid()}.import"
    try:
        with Session.create(beside, plan_path.read_text(encoding="utf-8"), plan_path.parent) as session:
            names = _names(rows)
            for done, (row, name, (exposure_s, iso)) in enumerate(zip(rows, names, mosaics, strict=True)):
                progress(len(rows) + done, 2 * len(rows), f"copying {row.file}")
                meta: dict[str, Any] = {"exposure_s": exposure_s, "iso": iso, "origin": row.file}
                if row.further:
                    meta["columns"] = row.further
                session.add_frame(row.path, name, row.kind, row.range_mm, **meta)
        beside.rename(session_folder)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    sync_folder(session_folder.parent)
    return Session.open(session_folder)


def read_rows(csv_path: Path, plan: Plan) -> list[Row]:
    """The rows of a CSV, checked against the plan. Raises DataError with every problem in one line."""
    rows, problems = [], []
    for line, cells in _read_cells(csv_path):
        try:
            rows.append(_row(csv_path.parent, line, cells, plan))
        except InputError as error:
            problems.append(f"line {line}: {error}")
    first_line: dict[Path, int] = {}
    for row in rows:
        if (first := first_line.setdefault(row.path, row.line)) != row.line:
            problems.append(f"line {row.line}: {row.file} stands in line {first} already")
    if not problems and not any(row.kind == "target" for row in rows):
        problems.append("no photograph of kind target: at least one is needed")
    if problems:
        raise DataError(f"{csv_path}: {'; '.join(problems)}")
    return rows


def _read_cells(csv_path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    try:
        text = csv_path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DataError(f"{csv_path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{csv_path}: not UTF-8 at byte {error.start}") from error
    reader = csv.reader(io.StringIO(text, newline=""))
    header = [name.strip() for name in next(reader, [])]
    if missing := [name for name in COLUMNS if name not in header]:
        raise DataError(f"{csv_path}: the header lacks {', '.join(missing)}; it must hold {','.join(COLUMNS)}")
    if len(set(header)) < len(header):
        raise DataError(f"{csv_path}: a column stands twice in the header: {','.join(header)}")
    for cells in reader:
        if any(cell.strip() for cell in cells):
            padded = [*cells, *[""] * (len(header) - len(cells))]
            yield reader.line_num, dict(zip(header, (cell.strip() for cell in padded), strict=False))


def _row(folder: Path, line: int, cells: dict[str, str], plan: Plan) -> Row:
    kind = cells["kind"]
    if kind not in FRAME_KINDS:
        raise DataError(f"kind {kind!r}: allowed is {', '.join(FRAME_KINDS)}")
    return Row(
        line=line,
        file=cells["file"],
        path=_inside(folder, cells["file"]),
        kind=kind,
        range_mm=_range(cells["range_mm"], plan),
        further={name: cell for name, cell in cells.items() if name not in COLUMNS},
    )


def _inside(folder: Path, file: str) -> Path:
    """The real path of a file that must lie in the folder, links followed."""
    if not file:
        raise DataError("file is empty")
    try:
        path = (folder / file).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"file {file!r} is no usable path ({error})") from error
    if not path.is_relative_to(folder.resolve()):
        raise DataError(f"file {file!r} lies outside the CSV's folder; move it into {folder.resolve()}")
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
        words = f"allowed is nothing, or a number above the focal length, {focal_mm:g} mm"
        raise DataError(f"range_mm {text!r}: {words}")
    return range_mm


def _check_photographs(
    csv_path: Path, rows: list[Row], plan: Plan, progress: Progress
) -> list[tuple[float | None, int | None]]:
    """Decode every photograph; (exposure_s, iso) of each. Raises DataError with every problem in one line."""
    found: list[tuple[float | None, int | None]] = []
    problems = []
    first: Mosaic | None = None
    for done, row in enumerate(rows):
        progress(done, 2 * len(rows), f"checking {row.file}")
        try:
            mosaic = read_raw(row.path, plan.sensor)
        except RawError as error:
            problems.append(str(error))
            continue
        if first is None:
            first = mosaic
            if wrong := _channel_problem(mosaic, plan):
                raise DataError(f"{csv_path}: {row.file}: {wrong}")
        problem = difference(mosaic, first) or exposure_problem(mosaic, row.kind, (c.name for c in plan.channel))
        if problem:
            problems.append(f"{row.file} {problem}")
        found.append((mosaic.exposure_s, mosaic.iso))
    if problems:
        raise DataError(f"{csv_path}: {'; '.join(problems)}")
    return found


def _channel_problem(mosaic: Mosaic, plan: Plan) -> str | None:
    names = [channel.name for channel in plan.channel]
    if mosaic.pattern == MONO:
        return None if len(names) == 1 else f"is mono, but the plan has {len(names)} [[channel]] tables: allowed is one"
    unknown = [name for name in names if name not in mosaic.cfa]
    return f"has no channel {', '.join(unknown)}: its filter array is {mosaic.cfa}" if unknown else None


def _names(rows: list[Row]) -> list[str]:
    """A name in frames/ for each row: its file's own where possible, safe and different from all others."""
    names: list[str] = []
    taken: set[str] = set()
    for row in rows:
        name = re.sub(r"[^A-Za-z0-9._-]", "_", row.path.name)[-160:].lstrip("._-") or "frame"
        if name.lower() in taken:
            name = f"{row.line}_{name}"
        while name.lower() in taken:
            name = f"x{name}"
        taken.add(name.lower())
        names.append(name)
    return names
