"""Which parts of a photograph are fitted: the targets of a grid, or the tiles of a single target."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.analysis.observe import _cut_up
from labkit.plan import FieldSettings

CORNERS = np.array([[20.0, 30.0], [20.0, 150.0], [80.0, 150.0], [80.0, 30.0]])
SHAPE = (100, 200)


def cuts(**settings: object) -> dict[tuple[int, ...], tuple[int, int, int, int]]:
    field = FieldSettings.from_tables(settings)
    found = dict[tuple[int, ...], tuple[int, int, int, int]]()
    for region in _cut_up([CORNERS], field, SHAPE):
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
    (region,) = (
        one
        for one in _cut_up(
            [CORNERS, CORNERS + 6], FieldSettings.from_tables({"tiles": [2, 2]}), SHAPE
        )
        if one.tile == (1, 1)
    )
    rows, columns = region.cut
    assert (rows.start, columns.start) == (50, 90)
    assert rows.stop >= 86
    assert columns.stop >= 156
