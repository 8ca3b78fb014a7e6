"""Compare statements of the photographs' files on lens and settings with the plan and with each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from labkit.findings.findings import Finding, found
from labkit.photographs.exif import Exif, read_exif
from labkit.plan import Plan
from labkit.types import FrameKind

FOCAL_LENGTH_TOLERANCE = 0.03
"""Relative: engravings and EXIF are both rounded."""

STOPS_TOLERANCE = 1 / 3
"""Tolerance of the f-number: cameras round to thirds of a stop."""

SAME_SETTING = 0.01
"""Relative difference up to which settings of two photographs are equal."""

Stated = tuple[str, Exif]
"""A photograph's name, and what its file states."""


def contradictions(
    photographs: Iterable[tuple[str, FrameKind, Path]], plan: Plan
) -> list[Finding]:
    """Return contradictions between files and plan or among files; each finding names both and the remedy.

    photographs: name, kind and file. Darks say nothing about a lens; files without
    statements contradict nothing.
    """
    stated: list[Stated] = []
    for name, kind, path in photographs:
        if kind in ("target", "flat"):
            with suppress(OSError):  # others report what is missing
                stated.append((name, read_exif(path)))
    return [*_against_plan(stated, plan), *_among_each_other(stated)]


def stops_between(one: float, other: float) -> float:
    """Return the exposure steps between two f-numbers."""
    return abs(2 * math.log2(one / other))


def _against_plan(stated: Sequence[Stated], plan: Plan) -> Iterator[Finding]:
    focal_mm = plan.lens.focal_length_mm
    for name, exif in stated:
        if (
            exif.focal_length_mm
            and abs(exif.focal_length_mm / focal_mm - 1) > FOCAL_LENGTH_TOLERANCE
        ):
            yield found(
                "exif-focal-length",
                file=name,
                focal_length_mm=exif.focal_length_mm,
                planned_mm=focal_mm,
            )
            break
    key = "lens.f_number"
    f_number = plan.lens.f_number
    if plan.camera is not None and plan.camera.f_number is not None:
        key = "camera.f_number"
        f_number = plan.camera.f_number
    for name, exif in stated:
        if exif.f_number and stops_between(exif.f_number, f_number) > STOPS_TOLERANCE:
            yield found(
                "exif-f-number",
                file=name,
                f_number=exif.f_number,
                plan_key=key,
                planned=f_number,
            )
            break


def _among_each_other(stated: Sequence[Stated]) -> Iterator[Finding]:
    yield from _differ(stated, "focal length", lambda exif: exif.focal_length_mm, "{:g} mm")
    yield from _differ(stated, "f-number", lambda exif: exif.f_number, "f/{:g}")
    yield from _differ(stated, "lens", lambda exif: exif.lens or None, "{}")
    yield from _differ(
        stated, "lens's serial number", lambda exif: exif.lens_serial or None, "{}"
    )
    yield from _differ(
        stated, "camera's serial number", lambda exif: exif.camera_serial or None, "{}"
    )


def _differ(
    stated: Sequence[Stated],
    what: str,
    value_of: Callable[[Exif], float | str | None],
    words: str,
) -> Iterator[Finding]:
    """Yield a finding for the first photograph whose statement differs from its predecessor's."""
    values = [
        (name, value) for name, exif in stated if (value := value_of(exif)) is not None
    ]
    for name, value in values[1:]:
        first_name, first = values[0]
        if not _same(value, first):
            yield found(
                "settings-differ",
                None,
                {"first": words.format(first), "other": words.format(value)},
                setting=what,
                first_file=first_name,
                first=first,
                file=name,
                other=value,
            )
            return


def _same(one: float | str, other: float | str) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one / other - 1) <= SAME_SETTING
    return one == other
