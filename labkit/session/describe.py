"""A session in a line, and as a table for notebooks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path

from labkit.session.frame import Frame
from labkit.types import FRAME_KINDS

FEW = 6
"""So many ranges are listed; of more the first and the last."""


def in_words(frames: Sequence[Frame]) -> str:
    """Return the number of photographs of each kind, and their ranges."""
    counts = Counter(frame.kind for frame in frames)
    kinds = ", ".join(f"{counts[kind]} {kind}" for kind in FRAME_KINDS if counts[kind])
    ranges_mm = sorted({frame.range_mm for frame in frames if frame.range_mm is not None})
    if not frames:
        return "no photographs"
    if not ranges_mm:
        return f"{kinds}; no ranges"
    if len(ranges_mm) <= FEW:
        return f"{kinds}; at {', '.join(f'{mm:g}' for mm in ranges_mm)} mm"
    return f"{kinds}; at {len(ranges_mm)} ranges, {ranges_mm[0]:g} to {ranges_mm[-1]:g} mm"


def as_html(folder: Path, frames: Sequence[Frame]) -> str:
    """Return a table of photographs: a row for each range, a column for each kind."""
    counts = Counter((frame.range_mm, frame.kind) for frame in frames)
    kinds = [kind for kind in FRAME_KINDS if any(frame.kind == kind for frame in frames)]
    heading = "".join(f"<th>{cell}</th>" for cell in ("range", *kinds))
    rows = []
    for range_mm in sorted(
        {frame.range_mm for frame in frames}, key=lambda mm: (mm is not None, mm or 0.0)
    ):
        where = "none" if range_mm is None else f"{range_mm:g} mm"
        cells = "".join(f"<td>{counts[range_mm, kind] or ''}</td>" for kind in kinds)
        rows.append(f"<tr><th>{where}</th>{cells}</tr>")
    return (
        f"<table><caption>Session {escape(str(folder))}: {len(frames)} photographs</caption>"
        f"<thead><tr>{heading}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )
