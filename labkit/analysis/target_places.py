"""A single target at several places of the frame: each place is a tile of the field.

The camera was turned, or the target moved, between photographs of a range. Rows and columns of
tiles are groups of the middles of the targets as they are found, over all ranges.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from labkit.findings.findings import Finding, found
from labkit.key import Tile
from labkit.session.frame import Frame
from labkit.types import Floats

SAME_PLACE = 0.5
"""Of the target's side: largest distance, along rows or columns, of the middles of targets at one place."""


Places = Mapping[str, Mapping[Tile | None, Floats]]
"""The tile of each photograph, None where there is one place alone, and the corners (4, 2) of its target, px."""


def places_in_frame(
    groups: Collection[Sequence[Frame]], corners: Mapping[str, Floats]
) -> tuple[Places, list[Finding]]:
    """Return the places of a single target by photograph, and a finding about several places.

    Parameters
    ----------
    groups : photographs of each range; there is one place where no range has several
    corners : (4, 2) of the target by photograph
    """
    if all(len(group) == 1 for group in groups):
        return {}, []
    tiles = tiles_by_place(corners, [[frame.file for frame in g] for g in groups])
    count = len(set(tiles.values()))
    places = {file: {tiles.get(file): at} for file, at in corners.items()}
    return places, [found("target-at-places", count=count)] if count else []


def of_one_place(group: Sequence[Frame], places: Places) -> list[list[Frame]]:
    """Split photographs of a range by the place of a single target in the frame."""
    by_place: dict[tuple[Tile | None, ...], list[Frame]] = {}
    for frame in group:
        by_place.setdefault(tuple(places.get(frame.file, ())), []).append(frame)
    return list(by_place.values())


def tiles_by_place(
    corners_px: Mapping[str, Floats], ranges: Iterable[Sequence[str]]
) -> dict[str, Tile]:
    """Return the tile of each photograph; empty where the photographs of each range show one place.

    Parameters
    ----------
    corners_px : (4, 2) of the target by photograph, [row, column]
    ranges : photographs of each range
    """
    middles = {name: corners.mean(axis=0) for name, corners in corners_px.items()}
    most_px = SAME_PLACE * float(np.median([_side_px(c) for c in corners_px.values()]))
    apart = (np.ptp([middles[name] for name in each], axis=0).max() for each in ranges)
    if not any(distance > most_px for distance in apart):
        return {}
    down, right = np.array(list(middles.values())).T
    rows, columns = _groups(down, most_px), _groups(right, most_px)
    return dict(zip(corners_px, zip(rows, columns, strict=True), strict=True))


def _side_px(corners: Floats) -> float:
    """Return the mean side of a target in a photograph."""
    return float(np.mean(np.hypot(*np.diff(corners[[0, 1, 2, 3, 0]], axis=0).T)))


def _groups(places: Floats, most: float) -> list[int]:
    """Return the number of each place's group, in order; groups are as long as `most` at the largest."""
    numbers = np.zeros(len(places), int)
    number, start = 0, float(np.min(places))
    for k in np.argsort(places, kind="stable"):
        if places[k] - start > most:
            number, start = number + 1, float(places[k])
        numbers[k] = number
    return numbers.tolist()
