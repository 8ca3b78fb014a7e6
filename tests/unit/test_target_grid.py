"""Grids of targets: their radiance against tiles drawn one by one, and the plan's keys for them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from labkit.errors import PlanError, TargetError
from labkit.finder.cut import sees_no_neighbour
from labkit.imaging.warp import Pose
from labkit.panel import PanelInfo
from labkit.panel.picture import panel_picture
from labkit.plan import Plan, TargetSpec
from labkit.target.grid import TargetGrid, open_grid, whole_target
from labkit.target.rendering import render_target
from labkit.target.target import CellTarget, open_target
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
    assert whole_target(spec).size_mm == (68.0, 109.0)
    assert grid.centre_mm((0, 0)) == (-20.5, -41.0)
    alone = TargetSpec.from_tables({"kind": "sierpinski", "order": 3, "size_mm": 27.0})
    assert open_grid(alone) is None
    assert whole_target(alone).size_mm == (27.0, 27.0)


def test_disks_keep_their_own_grid() -> None:
    spec = TargetSpec.from_tables(
        {"kind": "disks", "size_mm": 8.0, "grid": [2, 3], "diameter_mm": 2.5}
    )
    assert open_grid(spec) is None
    assert whole_target(spec).size_mm == (8.0, 12.0)


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
        ({"target": {**GRID, "grid": [101, 100]}}, "allowed are up to 10000 targets"),
        ({"target": {**GRID, "grid": [1, 1], "marks": True}}, r"grid = \[1, 1\]: marks of a single"),
        ({"target": {**GRID, "marks": 1}}, "target.marks = 1: allowed is"),
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
        ({"field": {"order": 9}}, "field.order = 9: allowed is a whole number, 1 to 8"),
        ({"field": {"order": 0}}, "field.order = 0: allowed is a whole number, 1 to 8"),
        ({"limits": {"corner_mtf50": "40 cycles/mm"}}, "limits.corner_mtf50 = '40 cycles/mm'"),
        ({"limits": {"corner_mtf50": True}}, "limits.corner_mtf50 = True: allowed is a number"),
        ({"limits": {"tilt": 3.0}}, "limits.tilt is no known key; did you mean tilt_um"),
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


def test_marks_are_read_by_opencvs_own_detector() -> None:
    target = TargetGrid(CellTarget(kron_carpet(3), (27.0, 27.0)), (3, 4), 51.0, marks=True)
    y, x = (np.arange(-side / 2 - 5, side / 2 + 5, 0.25) for side in target.size_mm)
    drawn = target.radiance(y[:, None], x)
    parameters = cv2.aruco.DetectorParameters()
    parameters.detectInvertedMarker = True
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    corners, numbers, _ = detector.detectMarkers((255 * drawn).astype(np.uint8))
    assert sorted(numbers.ravel()) == list(range(6))
    for number, quad in zip(numbers.ravel(), corners, strict=True):
        row, col = divmod(int(number), 3)
        middle = np.array([y[0], x[0]]) + quad[0].mean(axis=0)[::-1] * 0.25
        assert middle == pytest.approx([(row - 0.5) * 51, (col - 1) * 51], abs=0.3)
        # the first corner is a mark's upper left
        assert np.all(quad[0][0] < quad[0][2])


def test_marks_are_filtered_like_cells() -> None:
    target = TargetGrid(CellTarget(kron_carpet(2), (9.0, 9.0)), (2, 2), 21.0, marks=True)
    y, x = (np.arange(-20.0, 20.0, 0.25) + 0.125,) * 2
    cells = CellTarget(target.radiance(y[:, None], x), (40.0, 40.0))
    at = np.linspace(-18.0, 18.0, 80)
    np.testing.assert_allclose(
        target.sample(at, at, 0.8), cells.sample(at, at, 0.8), atol=1e-9
    )


def test_marks_need_numbers() -> None:
    with pytest.raises(TargetError, match=r"marks: grid = .* has no room for 1 to 1000"):
        TargetGrid(CellTarget(np.ones((1, 1)), (1.0, 1.0)), (40, 40), 2.0, marks=True)


PANEL = PanelInfo((300, 400), 0.1)


def test_a_panel_shows_a_grid_in_whole_pixels() -> None:
    tile = CellTarget(kron_carpet(2), (9.09, 9.09))
    shown = panel_picture(TargetGrid(tile, (2, 3), 13.52), PANEL)
    sheet = np.kron(kron_sheet((2, 3), order=2, gap=0), np.ones((10, 10)))
    tiles = sheet.reshape(2, 90, 3, 90)
    drawn = np.zeros((225, 360))
    for row, col in np.ndindex(2, 3):
        drawn[135 * row :, 135 * col :][:90, :90] = tiles[row, :, col]
    np.testing.assert_array_equal(shown.grey, 255 * drawn)
    assert shown.size_mm == pytest.approx((9.0, 9.0))
    assert shown.pitch_mm == pytest.approx(13.5)


@pytest.mark.parametrize(
    ("pitch_mm", "words"),
    [
        (13.5, r"the panel has 300 × 400: it holds grid = \[2, 3\] of them"),
        (9.9, "marks: the gaps between the targets are 9 pixels, and marks take 24"),
    ],
)
def test_a_grid_that_a_panel_cannot_show_is_refused(pitch_mm: float, words: str) -> None:
    tile = CellTarget(kron_carpet(2), (9.0, 9.0))
    with pytest.raises(TargetError, match=words):
        panel_picture(TargetGrid(tile, (3, 4), pitch_mm, marks=True), PANEL)


def test_a_print_has_whole_dots_and_tells_the_pitch(tmp_path: Path) -> None:
    text = "sierpinski:order=2,size_mm=9,grid=2x3,pitch_mm=13.13"
    made = render_target(text, tmp_path / "grid.png", dpi=254)
    with Image.open(made.path) as picture:
        dots = np.asarray(picture) / 255
    assert dots.shape == made.pixels == (221, 352)
    assert made.size_mm == pytest.approx((22.1, 35.2))
    np.testing.assert_array_equal(
        dots[131:, 262:], np.kron(kron_carpet(2), np.ones((10, 10)))
    )
    assert "state pitch_mm = 13.1 in the plan" in made.notes[0]


def test_marks_are_printed_too(tmp_path: Path) -> None:
    text = "sierpinski:order=2,size_mm=9,grid=2x2,pitch_mm=21,marks=true"
    made = render_target(text, tmp_path / "grid.png", dpi=254)
    with Image.open(made.path) as picture:
        between = np.asarray(picture)[90:210, 90:210]
    assert np.argwhere(between).min(axis=0).tolist() == [30, 30]
    assert np.argwhere(between).max(axis=0).tolist() == [89, 89]


@pytest.mark.parametrize("marks", [False, True])
def test_a_fit_leaves_out_the_light_of_marks_and_neighbours(marks: bool) -> None:
    grid = TargetGrid(CellTarget(np.ones((1, 1)), (64.0, 64.0)), (3, 3), 97.0, marks)
    y, x = (np.arange(-78.0, 79.0),) * 2
    light = grid.radiance(y[:, None], x)
    corners = 78 + np.array([[-32.0, -32.0], [-32.0, 32.0], [32.0, 32.0], [32.0, -32.0]])
    pose = Pose.from_corners(corners, (64.0, 64.0))
    used = sees_no_neighbour(pose, grid.clear_mm, (64.0, 64.0), light.shape)
    own = np.maximum(np.abs(y)[:, None], np.abs(x)) <= 32
    assert used[own].all()
    assert not light[used & ~own].any()
    # a pixel on either side of 33 mm between targets, or of half of the 8.25 mm before a mark
    wide = 4.125 if marks else 16.5
    assert used.sum() == pytest.approx((64 + 2 * wide) ** 2, rel=2 / 64)
