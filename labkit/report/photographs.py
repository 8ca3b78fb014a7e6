"""Statements of files and journal on the fitted photographs, and the target's place in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.errors import LabkitError
from labkit.report.table import UNKNOWN, Column, Row, Table, bare, fixed, when
from labkit.results import Results, Wavefront
from labkit.session.frame import Frame, in_words
from labkit.session.session import Session
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.photographs.exif import Exif

# What decodes photographs is imported where one is at hand.

MOST_EXIF = 40  # files whose EXIF is read: of hundreds a few say as much
REPORT_PREVIEW_PX = 640
FILES = "as the photographs' files state it"
JOURNAL_NOTE = "as the journal has it"
CORNERS_NOTE = "corners are fitted to hundredths of a pixel; their errors are not kept"


@dataclass(frozen=True, slots=True)
class Photographs:
    """Facts on the photographs besides the fits; empty without the session's folder.

    rows: name, value, and where it comes from. taken: when, in words. preview: (rows,
    columns) 0..1, averaged over
    blocks of preview_px pixels; size_px: (rows, columns) of the frame.
    """

    rows: tuple[tuple[str, str, str], ...] = ()
    camera: str = ""
    taken: str = ""
    preview: Floats | None = field(default=None, repr=False)
    preview_px: int = 1
    size_px: tuple[int, int] | None = None


def photographs_of(results: Results, nearest: Wavefront) -> Photographs:
    """Return the photographs of the session that holds the results.

    nearest: its photograph is shown
    """
    folder = results.folder
    if folder is None:
        return Photographs()
    try:
        session = Session.open(folder.resolve().parents[1])
        frames = {frame.file: frame for frame in session.frames}
    except (LabkitError, OSError, IndexError):
        return Photographs()
    used = sorted({name for w in results for name in w.frames if name in frames})
    exifs = [
        exif for name in used[:MOST_EXIF] if (exif := _exif(frames[name].path)) is not None
    ]
    events = {
        event["event"]: event
        for event in session.events
        if event["event"] in ("camera", "began", "preflight")
    }
    body = events.get("camera", {})
    camera = _one(exifs, lambda e: e.camera) or str(body.get("model", ""))
    taken = sorted(e.taken for e in exifs if e.taken)
    times = sorted(frames[name].time for name in used)
    rows = [
        ("Camera", camera, FILES),
        _either(
            "Camera's serial number",
            _one(exifs, lambda e: e.camera_serial),
            str(body.get("serial", "")),
        ),
        ("Lens", _one(exifs, lambda e: e.lens), FILES),
        ("Lens's serial number", _one(exifs, lambda e: e.lens_serial), FILES),
        (
            "Focal length set",
            _one(exifs, lambda e: e.focal_length_mm and f"{e.focal_length_mm:g} mm"),
            FILES,
        ),
        ("Aperture set", _one(exifs, lambda e: e.f_number and f"f/{e.f_number:g}"), FILES),
        _either(
            "Exposure",
            _one(exifs, lambda e: e.exposure_s and _seconds(e.exposure_s)),
            _journal_s(frames, used),
        ),
        ("ISO", _one(exifs, lambda e: e.iso and str(e.iso)), FILES),
        ("Taken", _span([_exif_time(t) for t in taken]), FILES),
        ("Added to the session", _span([when(t) for t in times]), JOURNAL_NOTE),
        ("Photographs", in_words(session.frames), JOURNAL_NOTE),
        (
            "Target as drawn",
            _drawn(events.get("began", {}), results.plan.target.size_mm),
            JOURNAL_NOTE,
        ),
    ]
    known = tuple((name, value, why) for name, value, why in rows if value)
    shown = next((frames[name].path for name in nearest.frames if name in frames), None)
    first = (
        f"photographed {_day(_exif_time(taken[0]))}"
        if taken
        else f"imported {_day(when(times[0]))}"
        if times
        else ""
    )
    return Photographs(known, camera, first, **_preview(shown, results))


def _exif(path: Path) -> Exif | None:
    from labkit.photographs.exif import read_exif

    with suppress(OSError):
        return read_exif(path)
    return None


def _one(exifs: Sequence[Exif], value_of: Callable[[Exif], object]) -> str:
    """Return the value stated by all files, or the different values."""
    values = dict.fromkeys(str(value) for exif in exifs if (value := value_of(exif)))
    return ", ".join(values)


def _seconds(exposure_s: float) -> str:
    return f"1/{1 / exposure_s:.0f} s" if exposure_s < 0.3 else f"{exposure_s:g} s"


def _journal_s(frames: dict[str, Frame], used: Sequence[str]) -> str:
    seconds = dict.fromkeys(frames[name].exposure_s for name in used)
    return ", ".join(_seconds(s) for s in seconds if s)


def _exif_time(text: str) -> str:
    """EXIF's 2026:11:22 09:08:07 in words: by the camera's own clock, of no zone."""
    day, _, clock = text.partition(" ")
    return when(f"{day.replace(':', '-')}T{clock}")


def _day(time: str) -> str:
    """Return the day of a time in words."""
    return time.partition(",")[0]


def _span(times: Sequence[str]) -> str:
    if not times:
        return ""
    first, last = times[0], times[-1]
    return first if last == first else f"{first} to {last.removeprefix(f'{_day(first)}, ')}"


def _drawn(began: dict[str, Any], fitted_mm: float) -> str:
    """Return the size drawn by a display, in whole pixels."""
    size = began.get("shown_size_mm")
    if not isinstance(size, list | tuple):
        return ""
    return f"{' × '.join(f'{float(side):.3f}' for side in size)} mm, in whole pixels; fitted as {fitted_mm:.5g} mm"


def _either(name: str, in_files: str, in_journal: str) -> tuple[str, str, str]:
    """Return the files' statement, or else the journal's."""
    return (name, in_files, FILES) if in_files else (name, in_journal, JOURNAL_NOTE)


def _preview(path: Path | None, results: Results) -> dict[str, Any]:
    """Return a small photograph, averaged over its filter array; empty if unreadable."""
    if path is None:
        return {}
    from labkit.photographs.decoding import read_photograph

    try:
        mosaic = read_photograph(path, results.plan.sensor)
    except (LabkitError, OSError):
        return {}
    rows, cols = mosaic.shape
    block = max(2, 2 * -(-max(rows, cols) // (2 * REPORT_PREVIEW_PX)))
    down, across = rows // block, cols // block
    wide = mosaic.counts.shape[1] // cols * block
    cut = mosaic.counts[: down * block, : across * wide]
    small = cut.reshape(down, block, across, wide).mean(axis=(1, 3), dtype=np.float32)
    low, high = np.quantile(small, [0.002, 0.998])
    shown = np.clip((small - low) / max(high - low, 1e-9), 0, 1) ** (1 / 2.2)
    return {"preview": shown, "preview_px": block, "size_px": (rows, cols)}


def off_centre(
    results: Results, photographs: Photographs
) -> tuple[list[float], list[float]] | None:
    """Return how far the target's middle was from the frame's, in mm on the sensor and per cent of the half diagonal.

    A number for each fit, by its first photograph; None where the frame's size is not known.
    """
    placed = [w.placement for w in results if w.placement is not None]
    if photographs.size_px is None or not placed:
        return None
    away = [
        _off_centre_px(placement.corners_px[0].mean(axis=0), photographs.size_px)
        for placement in placed
    ]
    pitch_mm = results.plan.sensor.pixel_pitch_um * 1e-3
    return [pitch_mm * px for px, _ in away], [100 * share for _, share in away]


def _off_centre_px(centre: Floats, size_px: tuple[int, int]) -> tuple[float, float]:
    """Return how far a place (row, column) is from the frame's centre, in pixels and in half diagonals."""
    middle = (np.array(size_px) - 1) / 2
    px = float(np.hypot(*(centre - middle)))
    return px, px / float(np.hypot(*size_px) / 2)


def photograph_table(photographs: Photographs) -> Table:
    """Camera, lens, settings, dates."""
    columns = (Column("", text=True), Column("", text=True))
    return Table(
        columns, tuple(Row((name, value), why=why) for name, value, why in photographs.rows)
    )


def place_table(results: Results, photographs: Photographs) -> Table:
    """Return the target's place and size at each range, in the first channel's first photograph."""
    pitch_mm = results.plan.sensor.pixel_pitch_um * 1e-3
    columns = (
        Column("range", "mm", exact=True),
        Column("centre, row", "px", why=CORNERS_NOTE),
        Column("column", "px", why=CORNERS_NOTE),
        Column("side", "px", why=CORNERS_NOTE),
        Column("turned by", "degrees", why=CORNERS_NOTE),
        Column("from the frame's centre", "mm on the sensor", why=CORNERS_NOTE),
        Column("of the half diagonal", "%", why=CORNERS_NOTE),
    )
    rows = []
    for range_mm in results.ranges_mm:
        placed = [
            w.placement for w in results.at_range(range_mm) if w.placement is not None
        ]
        if not placed:
            continue
        corners = placed[0].corners_px[0]
        centre = corners.mean(axis=0)
        side = corners - np.roll(corners, 1, axis=0)
        top = corners[1] - corners[0]
        away = ["frame not at hand", UNKNOWN]
        if photographs.size_px is not None:
            px, share = _off_centre_px(centre, photographs.size_px)
            away = [fixed(px * pitch_mm, 2), fixed(100 * share, 1)]
        turned = float(np.degrees(np.arctan2(top[0], top[1])))
        cells = (
            *(fixed(float(x), 1) for x in (*centre, median(np.hypot(*side.T)))),
            fixed(turned, 1),
        )
        rows.append(Row((bare(range_mm), *cells, *away)))
    return Table(columns, tuple(rows))
