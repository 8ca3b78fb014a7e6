"""What the photographs' files state of lens and settings, beside the plan and beside each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from labkit.plan import Plan
from labkit.raw.exif import Exif, read_exif
from labkit.types import FrameKind

FOCAL_LENGTH_TOLERANCE = 0.03
"""Relative: engravings and EXIF are both rounded."""

STOPS_TOLERANCE = 1 / 3
"""Of the f-number: cameras round it to thirds of a stop."""

SAME = 0.01
"""Relative: settings of two photographs that are nearer are one."""

Stated = tuple[str, Exif]
"""A photograph's name, and what its file states."""


def contradictions(photographs: Iterable[tuple[str, FrameKind, Path]], plan: Plan) -> list[str]:
    """Where files contradict the plan or each other, a line each that names both and what to do.

    photographs: name, kind and file; darks say nothing about a lens. Files that state nothing contradict nothing.
    """
    stated: list[Stated] = []
    for name, kind, path in photographs:
        if kind in ("target", "flat"):
            with suppress(OSError):  # others report what is missing
                stated.append((name, read_exif(path)))
    return [*_against_plan(stated, plan), *_among_each_other(stated)]


def stops_between(one: float, other: float) -> float:
    """How many stops of light lie between two f-numbers."""
    return abs(2 * math.log2(one / other))


def _against_plan(stated: Sequence[Stated], plan: Plan) -> Iterator[str]:
    focal_mm = plan.lens.focal_length_mm
    for name, exif in stated:
        if exif.focal_length_mm and abs(exif.focal_length_mm / focal_mm - 1) > FOCAL_LENGTH_TOLERANCE:
            yield (
                f"{name} was taken at {exif.focal_length_mm:g} mm by its EXIF, but the plan has lens.focal_length_mm = "
                f"{focal_mm:g}: correct the plan, or take photographs of that lens"
            )
            break
    key, f_number = "lens.f_number", plan.lens.f_number
    if plan.camera is not None and plan.camera.f_number is not None:
        key, f_number = "camera.f_number", plan.camera.f_number
    for name, exif in stated:
        if exif.f_number and stops_between(exif.f_number, f_number) > STOPS_TOLERANCE:
            yield (
                f"{name} was taken at f/{exif.f_number:g} by its EXIF, but the plan has {key} = {f_number:g}: correct the "
                "plan, or take photographs of that aperture"
            )
            break


def _among_each_other(stated: Sequence[Stated]) -> Iterator[str]:
    yield from _differ(stated, "focal length", lambda exif: exif.focal_length_mm, "{:g} mm")
    yield from _differ(stated, "f-number", lambda exif: exif.f_number, "f/{:g}")
    yield from _differ(stated, "lens", lambda exif: exif.lens or None, "{}")
    yield from _differ(stated, "lens's serial number", lambda exif: exif.lens_serial or None, "{}")
    yield from _differ(stated, "camera's serial number", lambda exif: exif.camera_serial or None, "{}")


def _differ(
    stated: Sequence[Stated], what: str, value_of: Callable[[Exif], float | str | None], words: str
) -> Iterator[str]:
    """A line where two photographs do not state the same."""
    values = [(name, value) for name, exif in stated if (value := value_of(exif)) is not None]
    for name, value in values[1:]:
        first_name, first = values[0]
        if not _same(value, first):
            yield (
                f"the photographs differ in {what}: {first_name} has {words.format(first)}, {name} {words.format(value)} by "
                "their EXIF; a session is of one lens at one setting: make one of each"
            )
            return


def _same(one: float | str, other: float | str) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one / other - 1) <= SAME
    return one == other
