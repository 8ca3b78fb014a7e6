"""A single target by the marks beyond its corners: drawn, shown, printed, and found in drawn rooms."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from labkit.errors import TargetError
from labkit.finder.cut import cut_around
from labkit.finder.find_target import find_target
from labkit.finder.lattice import find_targets
from labkit.finder.mark_search import places_by_marks
from labkit.finder.picture import Picture
from labkit.panel import PanelInfo
from labkit.panel.picture import panel_picture
from labkit.plan import TargetSpec
from labkit.target.grid import TargetGrid, mark_cells, open_grid, whole_target
from labkit.target.rendering import render_target
from labkit.target.target import CellTarget, on_dots, open_target
from labkit.types import Floats
from tests.rooms import Pose, as_counts, draw_target, random_room

TABLE = {"kind": "sierpinski", "order": 3, "size_mm": 27.0}
SPEC = TargetSpec.from_tables({**TABLE, "marks": True})
ALONE = open_target(SPEC)
SIDE_DOTS, CLEAR_DOTS = 135, 27
ALL_DOTS = 297  # with the marks
SIDES = ALL_DOTS / SIDE_DOTS


def marked(surround: str = "black") -> TargetGrid:
    made = whole_target(SPEC.model_copy(update={"surround": surround}))
    assert isinstance(made, TargetGrid)
    return made


def dots() -> Floats:
    tile = on_dots(ALONE, (SIDE_DOTS, SIDE_DOTS))
    return marked().in_dots(tile, 27.0 / SIDE_DOTS).radiance_of_dots()


def photograph(
    poses: dict[Pose, bool], *, room: int = 4, shape: tuple[int, int] = (900, 1400)
) -> Picture:
    """Return a picture of a room with carpets, each with marks or without; a pose is that of the carpet alone."""
    rng = np.random.default_rng(room)
    frame = random_room(shape, rng)
    for pose, has_marks in poses.items():
        shown = (
            dots()
            if has_marks
            else np.pad(on_dots(ALONE, (SIDE_DOTS, SIDE_DOTS)), (ALL_DOTS - SIDE_DOTS) // 2)
        )
        draw_target(
            frame,
            shown,
            with_marks(pose),
            black=0.02,
            white=0.6,
            blur_px=1.0,
            surround=1.1,
            bezel=1.2,
        )
    return Picture(as_counts(frame, rng), ("RG", "GB"), 600.0)


def with_marks(pose: Pose) -> Pose:
    """Return the pose of all marks of a target's."""
    return replace(pose, side_px=SIDES * pose.side_px)


def off_px(corners: Floats, pose: Pose) -> float:
    """Return the largest distance of corners from those of the target that `photograph` draws, in any order."""
    true = with_marks(pose).corners(1 / SIDES)
    return min(float(np.abs(np.roll(corners, k, axis=0) - true).max()) for k in range(4))


def test_the_fit_takes_the_target_and_a_display_the_marks_too() -> None:
    assert open_grid(SPEC) is None
    assert ALONE.size_mm == (27.0, 27.0)
    assert marked().size_mm == pytest.approx((27 * SIDES, 27 * SIDES))
    assert dots().shape == (ALL_DOTS, ALL_DOTS)
    middle = slice(
        (ALL_DOTS - SIDE_DOTS) // 2 - CLEAR_DOTS, (ALL_DOTS + SIDE_DOTS) // 2 + CLEAR_DOTS
    )
    clear = dots()[middle, middle]
    np.testing.assert_array_equal(
        clear, np.pad(on_dots(ALONE, (SIDE_DOTS, SIDE_DOTS)), CLEAR_DOTS)
    )


@pytest.mark.parametrize("roll_deg", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("side_px", [63.0, 250.0])
def test_marks_are_beyond_the_surround_that_a_fit_uses(
    roll_deg: float, side_px: float
) -> None:
    pose = Pose(side_px, (400.0, 400.0), roll_deg, 20.0)
    rows, cols = cut_around([pose.corners()], (800, 800))
    inner = marked().mark_centres_mm() / 27.0
    inner = (np.abs(inner) - marked().mark_mm / 27.0 / 2) * np.sign(inner)
    corners = Pose(2 * side_px * inner[3, 0], (400.0, 400.0), roll_deg, 20.0).corners()
    for row, col in corners:
        assert min(row - rows.start, rows.stop - row, col - cols.start, cols.stop - col) < 0


def test_four_marks_differ_in_five_bits_however_turned() -> None:
    numbers = marked().mark_numbers
    assert min(numbers) > 900  # a grid counts its marks from 0
    bits = [mark_cells(number, on_dark=False)[1:-1, 1:-1] for number in numbers]
    for one, other in combinations(bits, 2):
        for turns in range(4):
            assert np.count_nonzero(one != np.rot90(other, turns)) >= 5


@pytest.mark.parametrize("roll_deg", [0.0, 30.0, 77.0, 135.0, 250.0])
def test_a_tilted_target_is_found_by_its_marks(roll_deg: float) -> None:
    pose = Pose(130.0, (430.0, 690.0), roll_deg, 14.0, -14.0)
    picture = photograph({pose: True})
    (first, *_) = (places for places in places_by_marks(picture, marked()) if places)
    # measured: 0.63 px by the marks alone, 0.025 px after registration
    assert off_px(first[0], pose) < 1.0
    assert off_px(find_targets(picture, SPEC)[0], pose) < 0.05


def test_a_small_target_in_a_large_frame_is_found_by_its_marks() -> None:
    pose = Pose(90.0, (1460.0, 3010.0), 20.0, 10.0)
    picture = photograph({pose: True}, shape=(3000, 4500))
    (first, *_) = (places for places in places_by_marks(picture, marked()) if places)
    assert off_px(first[0], pose) < 0.9  # measured: 0.46
    assert off_px(find_target(picture, marked()), pose) < 0.05


def test_of_two_carpets_the_marked_one_is_meant() -> None:
    meant, other = Pose(150.0, (450.0, 400.0), 5.0), Pose(160.0, (450.0, 1000.0), 3.0)
    picture = photograph({meant: True, other: False})
    with pytest.raises(TargetError, match="2 targets are in the frame"):
        find_target(picture, ALONE)
    assert off_px(find_target(picture, marked()), meant) < 0.05


def test_two_marked_carpets_stay_ambiguous() -> None:
    poses = Pose(120.0, (450.0, 400.0), 5.0), Pose(130.0, (450.0, 1000.0), 3.0)
    picture = photograph(dict.fromkeys(poses, True))
    with pytest.raises(TargetError, match="2 targets are in the frame"):
        find_target(picture, marked())


def test_without_marks_in_the_frame_the_usual_search_goes_on() -> None:
    pose = Pose(150.0, (450.0, 700.0), 5.0)
    picture = photograph({pose: False})
    assert not any(places_by_marks(picture, marked()))
    assert off_px(find_target(picture, marked()), pose) < 0.05


def test_a_white_surround_has_dark_marks() -> None:
    drawn = marked("white")
    y, x = (np.arange(-side / 2 - 5, side / 2 + 5, 0.25) for side in drawn.size_mm)
    light = drawn.radiance(y[:, None], x)
    picture = Picture(cv2.GaussianBlur(light, (0, 0), 1.0))
    (first, *_) = (places for places in places_by_marks(picture, drawn) if places)
    middle = (np.array(light.shape) - 1) / 2
    true = middle + 4 * 27.0 * np.array(
        [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]]
    )
    assert first[0] == pytest.approx(true, abs=1.0)


def test_a_panel_and_a_print_show_the_marks_in_whole_dots(tmp_path: Path) -> None:
    shown = panel_picture(marked(), PanelInfo((600, 800), 0.1))
    assert shown.size_mm == (27.0, 27.0)
    assert shown.pitch_mm is None
    # two pixels for each of `dots`
    np.testing.assert_array_equal(
        shown.grey, 255 * np.kron(dots(), np.ones((2, 2), np.uint8))
    )
    made = render_target(
        "sierpinski:order=3,size_mm=27,marks=true", tmp_path / "t.png", pixels=ALL_DOTS
    )
    with Image.open(made.path) as picture:
        np.testing.assert_array_equal(np.asarray(picture), 255 * dots())
    assert made.size_mm == pytest.approx((59.4, 59.4))
    assert not any("pitch_mm" in note for note in made.notes)


def test_a_panel_too_small_for_the_marks_says_so() -> None:
    with pytest.raises(TargetError, match="smaller target, or leave out marks"):
        panel_picture(marked(), PanelInfo((500, 700), 0.1))


def test_a_wide_target_has_marks_at_equal_distances() -> None:
    tile = CellTarget(np.ones((1, 1)), (40.0, 80.0))
    drawn = TargetGrid(tile, (1, 1), 144.0, marks=True).in_dots(np.ones((40, 80)), 1.0)
    assert drawn.pitch_mm == 80 + 60
    light = drawn.radiance_of_dots()
    assert light.shape == (170, 170)
    assert light[65:105, 45:125].all()
    assert light.sum() == 40 * 80 + sum(drawn.mark(k).cells.sum() * 25 for k in range(4))
