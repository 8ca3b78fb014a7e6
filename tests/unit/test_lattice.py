"""Grids of carpets found: in a golden session's photographs, and in pictures drawn without labkit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labkit.errors import TargetError
from labkit.finder.lattice import find_tiles
from labkit.finder.picture import Picture
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.target.grid import TargetGrid, open_grid
from labkit.target.target import CellTarget
from labkit.types import Floats
from tests.grid_scenes import (
    Place,
    camera,
    corners_px,
    kron_carpet,
    kron_sheet,
    mark_sheet,
    picture,
)

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"

SHAPE = (480, 640)
EVERY = {(row, col) for row in range(3) for col in range(4)}


def three_by_four(grid: Place = (3, 4)) -> TargetGrid:
    """Carpets of 27 cells of 1 mm, 14 mm apart."""
    return TargetGrid(CellTarget(kron_carpet(3), (27.0, 27.0)), grid, 41.0)


def worst_px(
    found: dict[Place, Floats], view: Floats, *, side: int = 27, gap: int = 14
) -> float:
    """Largest distance of a corner from its true place."""
    return max(
        float(np.max(np.abs(corners - corners_px(place, view, side=side, gap=gap))))
        for place, corners in found.items()
    )


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden sessions are not here")
@pytest.mark.parametrize("range_mm", [1180, 1220, 1260])
def test_the_golden_grid_is_found_where_the_truth_has_it(range_mm: int) -> None:
    plan = Plan.load(GOLDEN / "field-open" / "plan.toml")
    truth = json.loads((GOLDEN / "truth-field-open.json").read_text())
    frame = read_photograph(GOLDEN / "field-open" / f"target_{range_mm}.dng", plan.sensor)
    grid = open_grid(plan.target)
    assert grid is not None
    found = find_tiles(Picture(frame.counts, ("RG", "GB")), grid)
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


FINER = 2
"""Sheet's cells in a carpet's cell, where marks of seven carpet's cells have six modules."""


def marked(grid: Place = (3, 4)) -> tuple[Floats, TargetGrid]:
    """Carpets of 54 cells, 24 apart, with marks of 12, and the same for labkit."""
    carpets = np.kron(kron_sheet(grid, gap=12), np.ones((FINER, FINER)))
    sheet = carpets + mark_sheet(grid, side=54, gap=24, module=2)
    tile = CellTarget(kron_carpet(3), (54.0, 54.0))
    return sheet, TargetGrid(tile, grid, 78.0, marks=True)


def in_frame(grid: TargetGrid, view: Floats) -> set[Place]:
    """The carpets whose true corners are all in the frame."""
    return {
        (row, col)
        for row, col in np.ndindex(*grid.grid)
        if all(
            np.all((corner > -0.5) & (corner < np.array(SHAPE) - 0.5))
            for corner in corners_px((row, col), view, side=54, gap=24)
        )
    }


@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (90.0, 150.0)])
def test_marks_tell_the_rows_and_columns_of_a_grid_cut_on_all_sides(
    shift_px: tuple[float, float],
) -> None:
    sheet, grid = marked((6, 7))
    view = camera(SHAPE, 1.7, roll_deg=3.0, shift_px=shift_px, sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE), grid)
    assert set(found) == in_frame(grid, view)
    assert worst_px(found, view, side=54, gap=24) < 0.5


@pytest.mark.parametrize("blur_px", [0.5, 3.0, 5.0])
def test_marks_are_read_in_perspective_and_out_of_focus(blur_px: float) -> None:
    sheet, grid = marked((6, 7))
    view = camera(SHAPE, 2.4, roll_deg=-12.0, tilt=(0.2, 0.1), sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE, blur_px=blur_px), grid)
    # a mark's module spans 4.8 pixels
    assert worst_px(found, view, side=54, gap=24) < max(0.5, blur_px / 3)


@pytest.mark.parametrize(
    ("turned", "words"),
    [
        (lambda sheet: np.rot90(sheet), "turned by 90° to the left"),
        (lambda sheet: np.rot90(sheet, 2), "turned by 180°"),
        (lambda sheet: np.rot90(sheet, 3), "turned by 90° to the right"),
        (lambda sheet: sheet[:, ::-1], "mirrored"),
        (lambda sheet: sheet[::-1], "mirrored"),
    ],
)
def test_marks_tell_a_turned_or_mirrored_grid(
    turned: Callable[[Floats], Floats], words: str
) -> None:
    sheet, grid = marked()
    seen = np.ascontiguousarray(turned(sheet))
    view = camera(SHAPE, 1.4, sheet=seen.shape)
    with pytest.raises(TargetError, match=words):
        find_tiles(picture(seen, view, SHAPE), grid)


def test_marks_that_are_not_shown_are_not_made_up() -> None:
    sheet = np.kron(kron_sheet((6, 7), gap=12), np.ones((FINER, FINER)))
    view = camera(SHAPE, 2.0, sheet=sheet.shape)
    rng = np.random.default_rng(6)
    seen = picture(sheet + 0.2 * rng.random(sheet.shape), view, SHAPE)
    with pytest.raises(TargetError, match="on both sides, and no mark can be read"):
        find_tiles(seen, marked((6, 7))[1])


def test_marks_of_another_grid_are_told() -> None:
    sheet, _ = marked((3, 5))
    view = camera(SHAPE, 1.4, sheet=sheet.shape)
    with pytest.raises(TargetError, match=r"marks .* are those of another grid"):
        find_tiles(picture(sheet, view, SHAPE), marked((3, 6))[1])


def test_marks_stand_between_the_carpets_of_a_single_row() -> None:
    sheet, grid = marked((1, 9))
    view = camera(SHAPE, 2.0, sheet=sheet.shape)
    found = find_tiles(picture(sheet, view, SHAPE), grid)
    assert sorted(found) == [(0, col) for col in range(3, 6)]


def test_a_picture_without_carpets_is_refused() -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(TargetError, match="no target found"):
        find_tiles(rng.standard_normal((120, 160)), three_by_four())
