"""A photograph of a session, and the events of the journal that a session requires."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

from labkit.errors import SessionError
from labkit.findings.findings import Finding, found
from labkit.session.journal import Event
from labkit.storage.files import is_name
from labkit.types import FRAME_KINDS, FrameKind

FRAMES_FOLDER = "frames"


@dataclass(frozen=True, slots=True)
class Frame:
    """A photograph of the session. range_mm is None if unknown or without meaning."""

    file: str
    kind: FrameKind
    range_mm: float | None
    sha256: str
    exposure_s: float | None
    time: str
    path: Path
    meta: Mapping[str, Any] = field(default_factory=dict, hash=False)


def frame_of(event: Event, folder: Path) -> Frame:
    """Return the photograph of a "frame" event, checked by `event_problem`, in a session's folder."""
    named = ("file", "kind", "range_mm", "sha256", "time")
    return Frame(
        **{key: event[key] for key in named},
        exposure_s=event.get("exposure_s"),
        path=folder / FRAMES_FOLDER / event["file"],
        meta=MappingProxyType(
            {key: event[key] for key in event if key not in (*named, "event", "exposure_s")}
        ),
    )


def event_problem(event: Event) -> str | None:
    """Describe missing or impossible values of an event; None if there are none."""
    name = event["event"]
    needed = NEEDED_IN_EVENT.get(name, ())
    if absent := [key for key in ("time", *needed) if key not in event]:
        return f'"{name}" without {", ".join(absent)}'
    if name in READ_AGAIN:
        for key, allowed in ALLOWED_IN_EVENT.items():
            if key in event and not allowed(event[key]):
                return f'"{name}" with {key} = {_short(event[key])}'
    return None


def doubled(events: Sequence[Event], journal: Path) -> tuple[str, ...]:
    """Describe lines that commit a photograph again, which counts once; only old journals have such lines.

    Raises SessionError if such a line contradicts the first.
    """
    first: dict[str, tuple[int, Event]] = {}
    again = []
    for number, event in enumerate(events, start=1):
        if event["event"] == "frame":
            at, before = first.setdefault(event["file"], (number, event))
            if [event[key] for key in PHOTOGRAPH] != [before[key] for key in PHOTOGRAPH]:
                raise SessionError(
                    f"{journal}: lines {at} and {number} contradict each other about {event['file']}"
                )
            if at != number:
                again.append(
                    f"{journal}: line {number} is of {event['file']} again, as line {at}: it counts once"
                )
    return tuple(again)


def distinct(
    frames: Sequence[Frame], is_constant: Callable[[Frame], bool]
) -> tuple[tuple[Frame, ...], tuple[Finding, ...]]:
    """Return each photograph once, whatever the names of its files, and the files left out.

    Noise never repeats, so equal files are one photograph and count once in every error; unless they show no noise.

    Parameters
    ----------
    frames : of a session
    is_constant : whether all pixels of a photograph are equal; asked of equal files only

    Raises
    ------
    SessionError : a photograph has two ranges or two kinds, or lit photographs are clipped
    """
    first: dict[str, Frame] = {}
    constant = set[str]()
    again = []
    for frame in frames:
        kept = first.setdefault(frame.sha256, frame)
        if kept is frame:
            continue
        if frame.sha256 in constant or is_constant(frame):
            if frame.kind in ("target", "flat"):
                raise SessionError(
                    f"{kept.file} and {frame.file} are clipped: all their pixels are equal; take them anew with less light"
                )
            constant.add(frame.sha256)
            continue
        if (kept.kind, kept.range_mm) != (frame.kind, frame.range_mm):
            raise SessionError(
                f"{kept.file} and {frame.file} are the same photograph: it is {_said(kept)} or {_said(frame)}, not both; "
                "import the session anew with the right one"
            )
        again.append(found("same-photograph", file=frame.file, same_as=kept.file))
    copies = {finding.numbers["file"] for finding in again}
    return tuple(one for one in frames if one.file not in copies), tuple(again)


def _said(frame: Frame) -> str:
    return f"a {frame.kind}" + (
        "" if frame.range_mm is None else f" at {frame.range_mm:g} mm"
    )


def pending(events: Sequence[Event]) -> Event | None:
    """Return the unfinished "adding" event, if any: only the last can be unfinished."""
    last = None
    for event in events:
        if event["event"] == "adding":
            last = event
        elif event["event"] in ("frame", "discarded"):
            last = None
    return last


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max  # not nan, and no integer beyond floats
    )


def _is_size(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(_is_number(side) and side > 0 for side in value)
    )


def _is_number_or_none(value: Any) -> bool:
    return value is None or _is_number(value)


ALLOWED_IN_EVENT: Mapping[str, Callable[[Any], bool]] = {
    "time": _is_text,
    "file": is_name,
    "kind": lambda value: value in FRAME_KINDS,
    "range_mm": _is_number_or_none,
    "measured_range_mm": _is_number,
    "homing": lambda value: isinstance(value, int) and value is not True and value > 0,
    "exposure_s": _is_number_or_none,
    "shown_size_mm": _is_size,
    "shown_pitch_mm": lambda value: _is_number(value) and value > 0,
    "altered": lambda value: isinstance(value, list) and all(map(_is_text, value)),
    "sha256": _is_text,
    "plan_sha256": _is_text,
    "target_file": is_name,
    "target_sha256": _is_text,
}

PHOTOGRAPH = ("file", "kind", "range_mm", "sha256")

NEEDED_IN_EVENT: Mapping[str, tuple[str, ...]] = {
    "created": ("plan_sha256",),
    "replanned": ("plan_sha256",),
    "adding": PHOTOGRAPH,
    "frame": PHOTOGRAPH,
    "discarded": ("file",),
    "dropped": (),
}
"""Required keys of the session's own events; other events are the capture's."""

READ_AGAIN = (*NEEDED_IN_EVENT, "began")
"""Events whose values are used."""


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


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
