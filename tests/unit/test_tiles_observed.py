"""Which parts of a photograph are fitted: a small target as a whole, tiles of a large one where it has detail."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.analysis.observe import _cut_up
from labkit.analysis.target_tiles import (
    LARGEST_WHOLE_PX,
    TILE_PX,
    TargetPart,
    cut_finding,
    middle_part,
    target_parts,
)
from labkit.analysis.tile_registration import register_part
from labkit.errors import PlanError
from labkit.imaging.warp import Pose
from labkit.plan import FieldSettings
from labkit.target.target import CellTarget
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats

CORNERS = np.array([[20.0, 30.0], [20.0, 150.0], [80.0, 150.0], [80.0, 30.0]])
SHAPE = (100, 200)
CARPET = CellTarget(carpet_cells(5), (30.0, 30.0))
SQUARE = np.array([[-1.0, -1], [-1, 1], [1, 1], [1, -1]])


def carpet_corners(side_px: float) -> Floats:
    """A carpet 100 pixels from the frame's edges, turned by a degree."""
    cos, sin = np.cos(0.02), np.sin(0.02)
    turned = side_px / 2 * SQUARE @ np.array([[cos, -sin], [sin, cos]])
    return np.asarray(turned + side_px / 2 + 100)


def carpet_tiles(side_px: float, **settings: object) -> list[TargetPart]:
    field = FieldSettings.from_tables(settings)
    shape = (int(side_px) + 200,) * 2
    return target_parts([carpet_corners(side_px)], field, CARPET, shape)


def cuts(**settings: object) -> dict[tuple[int, ...], tuple[int, int, int, int]]:
    field = FieldSettings.from_tables(settings)
    found = dict[tuple[int, ...], tuple[int, int, int, int]]()
    parts = target_parts([CORNERS], field, CARPET, SHAPE)
    for region in _cut_up([CORNERS], parts, SHAPE):
        rows, columns = region.cut
        found[region.tile or ()] = (rows.start, rows.stop, columns.start, columns.stop)
    return found


def test_a_single_target_is_fitted_whole_with_what_surrounds_it() -> None:
    assert cuts() == {(): (10, 90, 20, 160)}


def test_tiles_are_equal_parts_of_the_target() -> None:
    found = cuts(tiles=[2, 3])
    assert sorted(found) == [(r, c) for r in range(2) for c in range(3)]
    # even starts and sizes, so that colour filters keep their places
    for (row, column), (top, bottom, left, right) in found.items():
        assert (top, left) == (20 + 30 * row, 30 + 40 * column)
        assert {(bottom - top) % 2, (right - left) % 2} == {0}
        assert 30 <= bottom - top <= 32
        assert 40 <= right - left <= 42


@pytest.mark.parametrize(("pitch_px", "tiles"), [(30, 8), (20, 18), (64, 2), (1000, 1)])
def test_a_pitch_makes_tiles_of_about_its_size(pitch_px: float, tiles: int) -> None:
    assert len(cuts(pitch_px=pitch_px)) == tiles


def test_a_tile_follows_its_part_of_the_target_from_photograph_to_photograph() -> None:
    both = [CORNERS, CORNERS + 6]
    parts = target_parts(both, FieldSettings(tiles=(2, 2)), CARPET, SHAPE)
    *_, region = _cut_up(both, parts, SHAPE)
    assert region.tile == (1, 1)
    rows, columns = region.cut
    assert (rows.start, columns.start) == (50, 90)
    assert rows.stop >= 86
    assert columns.stop >= 156


@pytest.mark.parametrize(
    ("side_px", "most"), [(360, 0), (500, 4), (1000, 9), (3000, 25), (9000, 25)]
)
def test_tiles_of_a_large_target_are_of_bounded_size_and_number(
    side_px: float, most: int
) -> None:
    tiles = carpet_tiles(side_px)
    assert len(tiles) <= most
    assert len(tiles) >= 0.8 * most  # the middle of a carpet is even
    for tile in tiles:
        side = np.diff([tile.y, tile.x])[:, 0] * side_px / 2
        assert np.all(side < 1.01 * TILE_PX)
        assert side[0] == pytest.approx(side[1])


@pytest.mark.parametrize("side_px", [400, 1000, 3000])
def test_tiles_overlap_nowhere_and_end_within_the_target(side_px: float) -> None:
    tiles = carpet_tiles(side_px)
    seen = np.zeros((1000, 1000), int)
    for tile in tiles:
        ends = np.round((np.array([tile.y, tile.x]) + 1) * 500).astype(int)
        assert ends.min() >= 0
        assert ends.max() <= 1000
        seen[slice(*ends[0]), slice(*ends[1])] += 1
    assert seen.max() == 1
    assert len({tile.tile for tile in tiles}) == len(tiles)
    # the four corners of the target are fitted
    assert {(0, 0), max(tile.tile or (0, 0) for tile in tiles)} <= {t.tile for t in tiles}


def test_no_tile_is_in_the_even_middle_of_a_carpet() -> None:
    tiles = carpet_tiles(3000)
    assert (2, 2) not in {tile.tile for tile in tiles}
    for tile in tiles:
        y, x = (np.linspace(*ends, 60) * 15 for ends in (tile.y, tile.x))
        # an even part is all white or all black
        assert 0.05 < CARPET.radiance(y[:, None], x[None]).mean() < 0.95


def test_a_target_beyond_the_frame_has_tiles_within_it() -> None:
    corners = carpet_corners(1000) - 400
    tiles = target_parts([corners], FieldSettings(), CARPET, (900, 900))
    assert len(tiles) >= 3
    for tile in tiles:
        at = tile.corners(Pose.from_corners(corners, CARPET.size_mm))
        assert at.min() > -TILE_PX / 10
        assert at.max() < 900


def test_a_plan_may_fit_a_large_target_whole_or_a_part_of_it() -> None:
    assert carpet_tiles(1000, tiles=[1, 1]) == []
    (part,) = carpet_tiles(1000, part_px=[[300, 400], [500, 700]])
    assert part.tile is None
    at = part.corners(Pose.from_corners(carpet_corners(1000), (2.0, 2.0)))
    # a degree of turn makes the part up to 2 % of its sides larger
    assert at.min(axis=0) == pytest.approx([300, 400], abs=6)
    assert at.max(axis=0) == pytest.approx([500, 700], abs=6)
    with pytest.raises(PlanError, match="part_px"):
        FieldSettings.from_tables({"part_px": [[10, 10], [30, 60]]})
    with pytest.raises(PlanError, match="fitted alone"):
        FieldSettings.from_tables({"part_px": [[10, 10], [60, 60]], "tiles": [2, 2]})


def test_a_finding_says_how_much_of_a_large_target_is_fitted() -> None:
    corners = carpet_corners(1000)
    tiles = carpet_tiles(1000)
    (finding,) = cut_finding(tiles, corners, FieldSettings())
    assert finding.numbers["count"] == len(tiles) == 8
    assert finding.numbers["used"] == pytest.approx(8 * (TILE_PX / 1000) ** 2, rel=0.01)
    assert "tiles = [1, 1]" in finding.text
    assert cut_finding(tiles, corners, FieldSettings(pitch_px=200)) == []
    assert cut_finding(carpet_tiles(LARGEST_WHOLE_PX), corners, FieldSettings()) == []


@pytest.mark.parametrize("period", [1, 2])
@pytest.mark.parametrize("grown", [1.0, 1.01])
def test_a_tile_is_registered_where_distortion_moved_it(period: int, grown: float) -> None:
    corners = carpet_corners(600)
    part = middle_part(carpet_tiles(600))
    pose = Pose.from_corners(corners, CARPET.size_mm)
    y, x = pose.to_target(np.arange(800.0)[:, None], np.arange(800.0)[None])
    shown = CARPET.radiance(15 * y, 15 * x)
    counts = np.random.default_rng(1).normal(200 + 800 * shown, 10)
    at = part.corners(pose)
    wrong = (corners - at.mean(axis=0)) * grown + at.mean(axis=0) + [6.3, -4.4]
    found = part.corners(
        Pose.from_corners(
            register_part(counts, period, CARPET, part, wrong), CARPET.size_mm
        )
    )
    # measured: 0.033 to 0.039 pixels, of cells of 2.5
    assert np.abs(found - at).max() < 0.07


def test_even_pixels_leave_the_corners_of_a_tile() -> None:
    corners = carpet_corners(600)
    part = middle_part(carpet_tiles(600))
    counts = np.random.default_rng(1).normal(500, 10, (800, 800))
    assert np.array_equal(register_part(counts, 1, CARPET, part, corners), corners)
