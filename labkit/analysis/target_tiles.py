"""Which parts of a single target are fitted: the whole of a small one, tiles of a large one, or the part around a place.

A wavefront is known after some 250 pixels; more of a target show how the wavefront changes over the frame. Tiles of a large
target have a bounded size and number, so that the time of a fit is bounded too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labkit.findings.findings import Finding, found
from labkit.imaging.warp import Pose
from labkit.key import Tile
from labkit.optics.lens import ThinLens, ground_sample_mm
from labkit.plan import FieldSettings, Plan
from labkit.target.target import Target
from labkit.types import Floats

LARGEST_WHOLE_PX = 360.0
"""Side of the largest target fitted whole unless the plan states tiles: one and a half tiles."""

TILE_PX = 200.0
"""Side of the tiles of a larger target: time grows with their area, and errors of a wavefront fall with the side alone."""

MOST_TILES_ALONG = 5
"""Along each side of the target: 25 places show an expansion of the fourth order over the field, with 15 terms."""

LEAST_DETAIL = 0.1
"""Of the finest tile's detail, in a tile fitted: errors are three times as large there, and the middle of a carpet is
even."""

LIKE_DETAIL = 0.8
"""Of the finest place's detail in its part of the target, at places that are as good: that nearest to an even grid is taken."""

TRIED_PLACES = 9
"""Places along each side at which a tile may be in its part of the target."""

MOST_SAMPLES = 1500
"""Of the target along a side, for its detail."""

Interval = tuple[float, float]


@dataclass(frozen=True)
class TargetPart:
    """A rectangle on the target fitted.

    Attributes
    ----------
    tile : (row, column); None for a part fitted alone
    y, x : ends of its rows and columns on the target, -1 to 1
    """

    tile: Tile | None
    y: Interval
    x: Interval

    @property
    def area(self) -> float:
        """Share of the target's area."""
        return float(np.diff(self.y)[0] * np.diff(self.x)[0]) / 4

    def corners(self, pose: Pose) -> Floats:
        """Return (4, 2) corners in pixels at a pose of the whole target."""
        (top, bottom), (left, right) = self.y, self.x
        y, x = np.array([top, top, bottom, bottom]), np.array([left, right, right, left])
        return pose.to_pixels(y, x)

    def of(self, pose: Pose) -> Pose:
        """Return a pose of the whole target in the coordinates of the part."""
        ends = np.array([self.y, self.x]) * np.array(pose.half_size_mm)[:, None]
        middle, half = ends.mean(axis=1).tolist(), (np.diff(ends)[:, 0] / 2).tolist()
        return pose.about((half[0], half[1]), (middle[0], middle[1]))


def target_parts(
    corners: Sequence[Floats], field: FieldSettings, target: Target, shape: tuple[int, ...]
) -> list[TargetPart]:
    """Return the parts of a single target fitted; none if the whole target is.

    Parameters
    ----------
    corners : (4, 2) of the target in each photograph
    field : tiles as the plan states them
    target : the target
    shape : (rows, columns, ...) of the photographs
    """
    pose = Pose.from_corners(corners[0], target.size_mm)
    down, across = (2 * half for half in pose.pixel_per_unit())
    if field.part_px is not None:
        return [_stated_part(field.part_px, pose)]
    if field.cuts:
        pitch = field.pitch_px or np.inf
        rows, columns = field.tiles or (round(down / pitch), round(across / pitch))
        if max(rows, columns) <= 1:
            return []
        edges = (np.linspace(-1, 1, max(1, n) + 1).tolist() for n in (rows, columns))
        y, x = (list(pairwise(each)) for each in edges)
        return [
            TargetPart(tile, y[tile[0]], x[tile[1]]) for tile in np.ndindex(len(y), len(x))
        ]
    if max(down, across) <= LARGEST_WHOLE_PX:
        return []
    return _detailed_tiles(corners, target, shape, (down, across))


def may_be_large(plan: Plan, range_mm: float | None) -> bool:
    """Return whether a single target may be fitted in tiles, by what is known before it is found."""
    if plan.field.cuts or plan.field.part_px or plan.target.of_many:
        return True
    if plan.target.corners_px is not None:
        side = float(np.ptp(plan.target.corners_px, axis=0).max())
    elif range_mm is not None and range_mm > plan.lens.focal_length_mm:
        lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
        pitch_um = plan.sensor.pixel_pitch_um
        side = plan.target.size_mm / float(ground_sample_mm(lens, range_mm, pitch_um))
    else:
        return True
    return side > LARGEST_WHOLE_PX


def middle_part(parts: Sequence[TargetPart]) -> TargetPart:
    """Return the part nearest to the middle of the target."""
    return min(parts, key=lambda part: float(np.hypot(np.mean(part.y), np.mean(part.x))))


def cut_finding(
    parts: Sequence[TargetPart], corners: Floats, field: FieldSettings
) -> list[Finding]:
    """Return the finding that a large target is fitted in parts that the plan does not state.

    corners : (4, 2) of the target in a photograph
    """
    if not parts or field.cuts or field.part_px is not None:
        return []
    sides_px = [
        2 * half for half in Pose.from_corners(corners, (2.0, 2.0)).pixel_per_unit()
    ]
    wide = (part.x[1] - part.x[0] for part in parts)
    return [
        found(
            "large-target",
            target_px=round(max(sides_px)),
            count=len(parts),
            tile_px=round(float(np.mean(list(wide))) / 2 * sides_px[1]),
            used=sum(part.area for part in parts),
        )
    ]


def _stated_part(
    part_px: tuple[tuple[float, float], tuple[float, float]], pose: Pose
) -> TargetPart:
    """Return the part of the target that a rectangle of the photograph shows."""
    (top, left), (bottom, right) = part_px
    at = pose.to_target(
        np.array([top, top, bottom, bottom]), np.array([left, right, right, left])
    )
    y, x = (np.clip([each.min(), each.max()], -1, 1).tolist() for each in at)
    return TargetPart(None, (y[0], y[1]), (x[0], x[1]))


def _detailed_tiles(
    corners: Sequence[Floats],
    target: Target,
    shape: tuple[int, ...],
    sides_px: tuple[float, float],
) -> list[TargetPart]:
    """Return tiles spread over the part of the target that all photographs show, each where it has detail."""
    shown = _shown(corners, shape)
    if shown is None:
        return []
    detail = _Detail.of(target, sides_px)
    spans = [
        _spans(ends, 2 * TILE_PX / side) for ends, side in zip(shown, sides_px, strict=True)
    ]
    chosen = list[TargetPart]()
    levels = list[float]()
    for row, rows in enumerate(spans[0]):
        for column, columns in enumerate(spans[1]):
            part, level = detail.finest((row, column), rows, columns)
            chosen.append(part)
            levels.append(level)
    least = LEAST_DETAIL * max(levels)
    return [p for p, level in zip(chosen, levels, strict=True) if level > least]


@dataclass(frozen=True)
class _Span:
    """Places of a tile along one side of the target: ends of its part, its side, and its place on an even grid."""

    low: float
    high: float
    side: float
    start: float

    @property
    def starts(self) -> Floats:
        """Places where the tile may begin."""
        return np.append(
            np.linspace(self.low, self.high - self.side, TRIED_PLACES), self.start
        )


def _count_along(tiles: float) -> tuple[int, float]:
    """Return the number of tiles along a length, in sides of a tile, and their side, pixels.

    The number grows as the square root of the length, so that time and the gaps between the tiles grow together.
    """
    count = int(np.clip(round((2 * tiles) ** 0.5), 1, MOST_TILES_ALONG))
    return count, TILE_PX * min(1.0, tiles / count)


def tiles_along(side_px: float) -> tuple[int, float]:
    """Return the number of tiles along a side of a target, and their side, pixels; (1, side_px) if it is fitted whole."""
    if side_px <= LARGEST_WHOLE_PX:
        return 1, side_px
    return _count_along(side_px / TILE_PX)


def _spans(ends: Interval, tile: float) -> list[_Span]:
    """Divide a side of the target. tile : side of a tile, halves of the target's side."""
    low, high = ends
    count, side = _count_along((high - low) / tile)
    side *= tile / TILE_PX
    starts = (
        np.linspace(low, high - side, count) if count > 1 else [(low + high - side) / 2]
    )
    edges = np.linspace(low, high, count + 1)
    return [
        _Span(float(a), float(b), side, float(start))
        for (a, b), start in zip(pairwise(edges), starts, strict=True)
    ]


def _shown(
    corners: Sequence[Floats], shape: tuple[int, ...]
) -> tuple[Interval, Interval] | None:
    """Return the ends of rows and columns of the target that are in all photographs; None if none are."""
    rows, columns = shape[0] - 1.0, shape[1] - 1.0
    low, high = np.full(2, -1.0), np.full(2, 1.0)
    for one in corners:
        pose = Pose.from_corners(one, (2.0, 2.0))
        y, x = pose.to_target(
            np.array([0.0, 0.0, rows, rows]), np.array([0.0, columns, columns, 0.0])
        )
        # of four corners the inner two: what a turned frame shows of the target in all rows
        for axis, each in enumerate((np.sort(y), np.sort(x))):
            low[axis] = max(low[axis], each[1])
            high[axis] = min(high[axis], each[2])
    if np.any(high <= low):
        return None
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


@dataclass(frozen=True, eq=False)
class _Detail:
    """Detail of a target by place: sums of its squared slopes (rows + 1, columns + 1), up to about a pixel's frequency."""

    sums: Floats

    @classmethod
    def of(cls, target: Target, sides_px: tuple[float, float]) -> _Detail:
        counts = [min(MOST_SAMPLES, int(np.ceil(side))) for side in sides_px]
        y_mm, x_mm = (
            ((np.arange(n) + 0.5) / n - 0.5) * side
            for n, side in zip(counts, target.size_mm, strict=True)
        )
        bandwidth = 0.4 * min(
            n / side for n, side in zip(counts, target.size_mm, strict=True)
        )
        seen = target.sample(y_mm, x_mm, bandwidth)
        squares = np.gradient(seen, axis=0) ** 2 + np.gradient(seen, axis=1) ** 2
        return cls(np.pad(squares.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0))))

    def within(self, y: Floats, x: Floats) -> Floats:
        """Return (rows, columns) detail of rectangles from y[:, 0] to y[:, 1] and x[:, 0] to x[:, 1]."""
        rows, columns = (
            np.clip(np.round((at + 1) / 2 * (n - 1)), 0, n - 1).astype(int)
            for at, n in zip((y, x), self.sums.shape, strict=True)
        )
        corners = [
            [self.sums[np.ix_(rows[:, a], columns[:, b])] for b in (0, 1)] for a in (0, 1)
        ]
        return np.asarray(corners[1][1] - corners[0][1] - corners[1][0] + corners[0][0])

    def finest(self, tile: Tile, rows: _Span, columns: _Span) -> tuple[TargetPart, float]:
        """Return the tile in a part of the target, and its detail for its area."""
        y, x = rows.starts, columns.starts
        sums = self.within(
            np.stack([y, y + rows.side], axis=1), np.stack([x, x + columns.side], axis=1)
        )
        away = np.hypot((y - rows.start)[:, None], x - columns.start)
        away[sums < LIKE_DETAIL * sums.max()] = np.inf
        i, j = np.unravel_index(int(np.argmin(away)), away.shape)
        part = TargetPart(
            tile,
            (float(y[i]), float(y[i]) + rows.side),
            (float(x[j]), float(x[j]) + columns.side),
        )
        return part, float(sums[i, j]) / (rows.side * columns.side)
