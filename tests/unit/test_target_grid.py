"""Grids of targets: their radiance against tiles drawn one by one, and the plan's keys for them."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.errors import PlanError, TargetError
from labkit.plan import Plan, TargetSpec
from labkit.target import CellTarget, open_target
from labkit.target_grid import TargetGrid, open_grid, shown_target
from tests.grid_scenes import kron_carpet, kron_sheet
from tests.plans import SMALL, plan_text

GRID = {"kind": "sierpinski", "order": 3, "size_mm": 27.0, "grid": [2, 3], "pitch_mm": 41.0}


@pytest.mark.parametrize(("surround", "around"), [(0.0, 0.0), (1.0, 1.0), (None, 0.0)])
def test_points_are_those_of_a_drawn_sheet(surround: float | None, around: float) -> None:
    target = TargetGrid(CellTarget(kron_carpet(3), (27.0, 27.0), surround), (2, 3), 41.0)
    assert target.size_mm == (68.0, 109.0)
    sheet = kron_sheet((2, 3))
    gaps = np.ones_like(sheet)
    for row, col in np.ndindex(2, 3):
        gaps[14 + 41 * row : 41 + 41 * row, 14 + 41 * col : 41 + 41 * col] = 0.0
    y, x = (np.arange(count) - (count - 1) / 2 for count in sheet.shape)
    np.testing.assert_array_equal(
        target.radiance(y[:, None], x), np.where(gaps, around, sheet)
    )


def test_the_filter_is_that_of_all_cells_together() -> None:
    # one table of cells, 1 mm each, holds the grid and its surround
    whole = CellTarget(kron_sheet((2, 3)), (96.0, 137.0))
    grid = TargetGrid(CellTarget(kron_carpet(3), (27.0, 27.0)), (2, 3), 41.0)
    y, x = np.linspace(-40.0, 40.0, 70), np.linspace(-60.0, 60.0, 90)
    np.testing.assert_allclose(grid.sample(y, x, 0.6), whole.sample(y, x, 0.6), atol=1e-9)


def test_a_fit_takes_one_target_and_a_display_all_of_them() -> None:
    spec = TargetSpec.from_tables(GRID)
    grid = open_grid(spec)
    assert grid is not None
    assert (grid.grid, grid.pitch_mm, grid.tile.size_mm) == ((2, 3), 41.0, (27.0, 27.0))
    assert open_target(spec).size_mm == (27.0, 27.0)
    assert shown_target(spec).size_mm == (68.0, 109.0)
    assert grid.centre_mm((0, 0)) == (-20.5, -41.0)
    alone = TargetSpec.from_tables({"kind": "sierpinski", "order": 3, "size_mm": 27.0})
    assert open_grid(alone) is None
    assert shown_target(alone).size_mm == (27.0, 27.0)


def test_disks_keep_their_own_grid() -> None:
    spec = TargetSpec.from_tables(
        {"kind": "disks", "size_mm": 8.0, "grid": [2, 3], "diameter_mm": 2.5}
    )
    assert open_grid(spec) is None
    assert shown_target(spec).size_mm == (8.0, 12.0)


def test_targets_that_overlap_are_refused() -> None:
    with pytest.raises(
        TargetError, match=r"pitch_mm = 30: allowed is more than .* 20 × 40 mm"
    ):
        TargetGrid(CellTarget(np.ones((2, 4)), (20.0, 40.0)), (2, 2), 30.0)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"target": {**GRID, "pitch_mm": None}}, "target.pitch_mm is missing"),
        ({"target": {**GRID, "pitch_mm": 27}}, "pitch_mm = 27: allowed is more than size_mm = 27"),
        ({"target": {**GRID, "grid": None}}, "pitch_mm = 41: only a grid of targets has a pitch"),
        ({"target": {**GRID, "grid": [0, 3]}}, r"target.grid = \[0, 3\]: allowed is a whole number, 1 to"),
        ({"target": {**GRID, "grid": [2]}}, r"target.grid = \[2\]: allowed is \[rows, columns\]"),
        (
            {"target": {**GRID, "corners_px": [[0, 0], [0, 9], [9, 9], [9, 0]]}},
            "corners_px are of a single target",
        ),
        (
            {"target": {**GRID, "kind": "disks", "diameter_mm": 2.0}},
            "disks are size_mm / rows apart",
        ),
        ({"target": GRID, "field": {"tiles": [3, 2]}}, "leave out field.tiles"),
        ({"target": GRID, "field": {"pitch_px": 64}}, "leave out field.pitch_px"),
        ({"field": {"tiles": [3, 2], "pitch_px": 64}}, "tiles and pitch_px exclude each other"),
        ({"field": {"tiles": [0, 2]}}, r"field.tiles = \[0, 2\]: allowed is a whole number, 1 to"),
        ({"field": {"pitch_px": 2}}, "field.pitch_px = 2: allowed is a number, 16 to"),
        ({"field": {"order": 9}}, "field.order = 9: allowed is a whole number, 0 to 8"),
        ({"limits": {"corner_mtf50": "40 cycles/mm"}}, "limits.corner_mtf50 = '40 cycles/mm'"),
        ({"limits": {"corner_mtf50": True}}, "limits.corner_mtf50 = True: allowed is a number"),
        ({"limits": {"tilt": 3.0}}, "limits.tilt is no known key; did you mean tilt_um_per_mm?"),
        ({"limits": {"sharpness": 3.0}}, "limits.sharpness is no known key; known here: "),
        ({"mount": {"screws_mm": [[0, 0], [9, 0]]}}, "three or four places"),
        ({"mount": {"screws_mm": [[0, 0], [9, 9], [20, 20]]}}, "not all on one line"),
        ({"mount": {"screws_mm": [[0, 0], [9], [20, 20]]}}, "three or four places"),
        ({"mount": {"screw_pitch_mm": 0.5}}, "screws_mm is missing"),
        ({"mount": {"clockwise": "away"}}, "screws_mm is missing: clockwise alone"),
    ],
)  # fmt: skip
def test_a_wrong_key_of_the_field_is_one_line(
    tables: dict[str, dict[str, object]], words: str
) -> None:
    with pytest.raises(PlanError, match=words) as caught:
        Plan.parse(plan_text(SMALL, tables))
    assert str(caught.value).isprintable()


def test_the_field_keys_are_read_and_written() -> None:
    tables = {
        "target": GRID,
        "field": {"tiles": [2, 3], "order": 2},
        "limits": {"corner_mtf50": 40.0, "tilt_um_per_mm": 1},
        "mount": {"screws_mm": [[0, 30], [26.0, -15], [-26, -15]], "screw_pitch_mm": 0.5},
    }
    plan = Plan.parse(plan_text(SMALL, tables))
    assert plan.limits.stated == {"corner_mtf50": 40.0, "tilt_um_per_mm": 1.0}
    assert plan.mount.screws_mm == ((0.0, 30.0), (26.0, -15.0), (-26.0, -15.0))
    assert Plan.parse(plan.to_toml()) == plan
    silent = Plan.parse(plan_text(SMALL))
    assert (silent.field.tiles, silent.field.pitch_px, silent.field.order) == (None,) * 3
    assert (silent.limits.stated, silent.mount.screws_mm) == ({}, None)
