"""Search for the target in photographs, in several processes where there are several photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.errors import InputError, LostTasksError, TargetError
from labkit.finder.find_target import find_target
from labkit.finder.lattice import find_tiles
from labkit.finder.picture import Picture
from labkit.finder.preview import jpeg
from labkit.finder.registration import surround_share
from labkit.jobs.execute import Run
from labkit.jobs.sharing import Shared, share
from labkit.key import Tile
from labkit.optics.lens import ThinLens, ground_sample_mm
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.session.frame import Frame
from labkit.session.session import PREFLIGHT_FOLDER
from labkit.storage.files import write_atomically
from labkit.target.grid import open_grid, whole_target
from labkit.target.target import Target
from labkit.types import Floats, Progress

Corners = Mapping[Tile | None, Floats]
"""Corners (4, 2) in pixels of every tile found in a photograph. A whole target has one tile, its place or None."""

MOST_OF_SURROUND = 0.9
"""Share of what is beside a target that contradicts the stated surround: a room beside a narrow rim is not as even."""

SURROUND_LEVELS = {"black": 0.0, "white": 1.0}
"""How light a surround is, by the plan's name of it."""


@dataclass(frozen=True)
class _Search:
    """The search of one photograph as a task; attributes as of `Frame`, which does not travel."""

    path: Path
    range_mm: float | None
    plan: Plan
    target: Shared[Target]


def locate_all(
    frames: Sequence[Frame], plan: Plan, target: Target, run: Run, progress: Progress
) -> dict[str, Corners]:
    """Return the corners in each photograph by its file; none where the plan states them.

    Photographs whose process was killed are left out: where memory is short, one at a time has room.

    Parameters
    ----------
    frames : the photographs
    plan : lens and sensor
    target : the target of the plan
    run : maps searches over processes that read the session's files
    progress : called with the step under way

    Raises
    ------
    TargetError : the first photograph that does not show the target
    RawError : a photograph cannot be read
    """
    if plan.target.corners_px is not None:
        return {}
    shared = share(target)
    tasks = [_Search(one.path, one.range_mm, plan, shared) for one in frames]
    ends = dict[int, Corners | TargetError]()
    with suppress(LostTasksError):
        for index, end in run(_searched, tasks):
            ends[index] = end
            progress(len(ends), len(frames), "finding the target")
    corners = dict[str, Corners]()
    for index, end in sorted(ends.items()):
        if isinstance(end, TargetError):
            raise end
        corners[frames[index].file] = end
    return corners


def _searched(search: _Search) -> Corners | TargetError:
    """Return the corners in a photograph, or the reason why there are none: which is the first is not known yet."""
    photograph = read_photograph(search.path, search.plan.sensor)
    try:
        return locate(
            photograph, search.path, search.range_mm, search.plan, search.target.value
        )
    except TargetError as error:
        return error


def locate(
    photograph: Photograph,
    path: Path,
    range_mm: float | None,
    plan: Plan,
    target: Target,
) -> Corners:
    """Return the corners in a photograph: as the plan states them, or as they are found.

    Where none is found, a picture of what was looked at is written into the session.

    Parameters
    ----------
    photograph : decoded
    path : its file in a session
    range_mm : of the target, None if unknown
    plan : lens and sensor
    target : the target of the plan

    Raises
    ------
    TargetError : the photograph does not show the target
    """
    if plan.target.corners_px is not None:
        return {None: np.array(plan.target.corners_px, float)}
    picture = Picture.of(photograph)
    scale = _stated_scale(range_mm, plan)
    try:
        if (grid := open_grid(plan.target)) is not None:
            return dict(find_tiles(picture, grid, mm_per_pixel=scale).items())
        corners = find_target(picture, whole_target(plan.target), mm_per_pixel=scale)
        _refuse_other_surround(picture, corners, plan)
    except TargetError as error:
        seen = _write_picture(photograph, path, error)
        raise TargetError(f"{path.name}: {error}{seen}", error.likely_px) from error
    return {None: corners}


def _write_picture(photograph: Photograph, path: Path, error: TargetError) -> str:
    """Write a picture of the places looked at beside the session's test photographs; return where it is."""
    seen = path.parents[1] / PREFLIGHT_FOLDER / f"{path.stem}_seen.jpg"
    try:
        seen.parent.mkdir(exist_ok=True)
        write_atomically(seen, jpeg(photograph, likely_px=error.likely_px))
    except (OSError, InputError):  # a session may be on a medium that nobody can write to
        return ""
    return f", see {seen}"


def _refuse_other_surround(picture: Picture, corners: Floats, plan: Plan) -> None:
    """Raise TargetError where black is around the target and the plan states white, or the other way round."""
    if plan.target.surround not in SURROUND_LEVELS:
        return
    (other,) = SURROUND_LEVELS.keys() - {plan.target.surround}
    if surround_share(picture, corners, SURROUND_LEVELS[other]) > MOST_OF_SURROUND:
        raise TargetError(
            f"the target's surround is {other} in it, but the plan has target.surround = "
            f'"{plan.target.surround}": write "{other}"',
            [corners],
        )


def _stated_scale(range_mm: float | None, plan: Plan) -> float | None:
    """Return the size of a pixel on the target, mm, by plan and range; None if not stated."""
    if range_mm is None or range_mm <= plan.lens.focal_length_mm:
        return None
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    return float(ground_sample_mm(lens, range_mm, plan.sensor.pixel_pitch_um))
