"""Grids of carpets found: in a golden session's photographs, and in pictures drawn without labkit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.errors import TargetError
from labkit.finder.find_target import grey_image
from labkit.finder.lattice import find_tiles
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.target import CellTarget
from labkit.target_grid import TargetGrid, open_grid
from labkit.types import Floats
from tests.grid_scenes import Place, camera, corners_px, kron_carpet, kron_sheet, picture

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"

SHAPE = (480, 640)
EVERY = {(row, col) for row in range(3) for col in range(4)}


def three_by_four(grid: Place = (3, 4)) -> TargetGrid:
    """Carpets of 27 cells of 1 mm, 14 mm apart."""
    return TargetGrid(CellTarget(kron_carpet(3), (27.0, 27.0)), grid, 41.0)


def worst_px(found: dict[Place, Floats], view: Floats, first: Place = (0, 0)) -> float:
    """Largest distance of a corner from its true place; the carpet at `first` was found as (0, 0)."""
    return max(
        float(np.max(np.abs(corners - corners_px((row + first[0], col + first[1]), view))))
        for (row, col), corners in found.items()
    )


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden sessions are not here")
@pytest.mark.parametrize("range_mm", [1180, 1220, 1260])
def test_the_golden_grid_is_found_where_the_truth_has_it(range_mm: int) -> None:
    plan = Plan.load(GOLDEN / "field-open" / "plan.toml")
    truth = json.loads((GOLDEN / "truth-field-open.json").read_text())
    frame = read_photograph(GOLDEN / "field-open" / f"target_{range_mm}.dng", plan.sensor)
    grid = open_grid(plan.target)
    assert grid is not None
    found = find_tiles(grey_image(frame.counts, ("RG", "GB")), grid)
    centres = {
        tuple(tile["tile"]): tile["centre_px"]
        for tile in truth["tiles"]
        if tile["range_mm"] == range_mm and tile["channel"] == "G"
    }
    assert set(found) == set(centres)
    # the mean of the corners is not the centre's image: distortion and perspective move it by 0.1 px
    for place, corners in found.items():
        assert corners.mean(axis=0) == pytest.approx(centres[place], abs=0.5)
    assert grid.tile.size_mm == (29.751, 29.751)


VIEWS: dict[str, dict[str, Any]] = {
    "upright": {},
    "rolled": {"roll_deg": 20.0, "scale": 2.4},
    "rolled the other way": {"roll_deg": -35.0, "scale": 2.1},
    "in perspective": {"tilt": (0.12, -0.15)},
    "small": {"scale": 1.3, "shift_px": (30.0, -60.0)},
}


@pytest.mark.parametrize("name", VIEWS)
def test_a_whole_grid_is_found_and_counted_from_the_upper_left(name: str) -> None:
    sheet = kron_sheet((3, 4))
    view = camera(SHAPE, **{"scale": 3.1, "sheet": sheet.shape, **VIEWS[name]})
    found = find_tiles(picture(sheet, view, SHAPE), three_by_four())
    assert set(found) == EVERY
    assert worst_px(found, view) < 0.5


@pytest.mark.parametrize("blur_px", [0.3, 3.0, 6.0])
def test_a_grid_out_of_focus_is_found(blur_px: float) -> None:
    sheet = kron_sheet((3, 4))
    view = camera(SHAPE, 3.1, sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE, blur_px=blur_px), three_by_four())
    assert set(found) == EVERY
    assert worst_px(found, view) < 1.0


def test_a_missing_carpet_is_absent_and_all_others_keep_their_places() -> None:
    sheet = kron_sheet((3, 4), without=[(0, 0), (1, 2)])
    view = camera(SHAPE, 3.1, roll_deg=4.0, sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE), three_by_four())
    assert set(found) == EVERY - {(0, 0), (1, 2)}
    assert worst_px(found, view) < 0.5


@pytest.mark.parametrize(
    ("shift_px", "absent"),
    [
        ((0.0, 150.0), {(row, 3) for row in range(3)}),
        ((0.0, -150.0), {(row, 0) for row in range(3)}),
        ((-120.0, 0.0), {(0, col) for col in range(4)}),
    ],
)
def test_a_grid_cut_on_one_side_is_counted_from_the_other(
    shift_px: tuple[float, float], absent: set[Place]
) -> None:
    sheet = kron_sheet((3, 4))
    view = camera(SHAPE, 3.1, shift_px=shift_px, sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE), three_by_four())
    assert set(found) == EVERY - absent
    assert worst_px(found, view) < 0.5


@pytest.mark.parametrize(
    ("shown", "scale", "words"),
    [
        ((2, 4), 3.1, "only 2 of the grid's 3 rows"),
        ((3, 2), 3.1, "only 2 of the grid's 4 columns"),
        ((4, 3), 2.7, r"4 rows and 3 columns .* write grid = \[4, 3\]"),
        ((4, 4), 2.7, r"4 rows and 4 columns of targets are found"),
        ((3, 4), 6.0, "cuts the grid on both sides"),
    ],
)
def test_a_grid_that_contradicts_the_plan_is_refused(
    shown: Place, scale: float, words: str
) -> None:
    sheet = kron_sheet(shown)
    view = camera(SHAPE, scale, sheet=sheet.shape)
    with pytest.raises(TargetError, match=words):
        find_tiles(picture(sheet, view, SHAPE), three_by_four())


def test_a_picture_without_carpets_is_refused() -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(TargetError, match="no target found"):
        find_tiles(rng.standard_normal((120, 160)), three_by_four())
