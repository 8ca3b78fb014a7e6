"""Targets found, and missed, in whole frames: rooms of sample pictures with a target drawn into them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.errors import TargetError
from labkit.finder.find_target import find_target
from labkit.finder.picture import Picture
from labkit.finder.preview import ORANGE, jpeg
from labkit.photographs.photograph import Photograph
from labkit.target.target import CellTarget
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats
from tests.rooms import Pose, as_counts, draw_target, random_poses, random_room

CELLS = carpet_cells(5)
CARPET = CellTarget(CELLS, (30.0, 30.0))
SIX, TWENTY_FOUR = (2000, 3000), (4000, 6000)


def photograph(counts: NDArray[np.uint16]) -> Photograph:
    return Photograph(counts, np.full((2, 2), 600.0), 16383.0, ("RG", "GB"))


def error_px(found: Floats, pose: Pose) -> float:
    """Largest distance of corners, whichever of the carpet's eight poses is returned."""
    true = pose.corners()
    ways = [np.roll(way, k, axis=0) for way in (true, true[::-1]) for k in range(4)]
    return min(float(np.abs(found - way).max()) for way in ways)


def room_with(
    seed: int,
    shape: tuple[int, int],
    *poses: Pose,
    light: float = 0.5,
    blur_px: float = 0.8,
) -> Photograph:
    """A room with carpets at some poses; a dark one for a negative seed."""
    rng = np.random.default_rng(abs(seed))
    room = random_room(shape, rng) if seed >= 0 else np.zeros(shape, np.float32)
    for pose in poses:
        draw_target(room, CELLS, pose, black=0.02 * light, white=light, blur_px=blur_px)
    return photograph(as_counts(room, rng))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(16))
def test_a_carpet_is_found_anywhere_in_a_room(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    shape = TWENTY_FOUR if seed % 8 == 0 else SIX
    pose, light = next(random_poses(shape, rng)), float(rng.uniform(0.05, 1.0))
    blur_px = float(rng.choice([0.6, 1.0, 0.03 * pose.side_px]))
    seen = room_with(
        -seed if seed % 5 == 4 else seed, shape, pose, light=light, blur_px=blur_px
    )
    # in 150 rooms the corners were off by 0.25 px, by a twelfth of the blur, or by 1 / 1400 of the side
    limit = max(0.5, blur_px / 6, pose.side_px / 700)
    assert error_px(find_target(seen, CARPET), pose) < limit


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_a_room_without_a_carpet_shows_none(seed: int) -> None:
    shape = TWENTY_FOUR if seed == 0 else SIX if seed < 4 else (600, 900)
    with pytest.raises(TargetError, match="no target found in the frame") as caught:
        find_target(room_with(seed + 100, shape), CARPET)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("pose", [Pose(700, (300, 450), 12.0), Pose(400, (250, 20), 5.0)])
def test_a_part_of_a_carpet_is_no_smaller_carpet(pose: Pose) -> None:
    words = r"larger than the frame|only a part of the target|out of the frame"
    with pytest.raises(TargetError, match=words):
        find_target(room_with(3, (600, 900), pose), CARPET)


def test_of_two_carpets_the_one_of_the_stated_scale_is_meant() -> None:
    near, far = Pose(160, (300, 250), 8.0), Pose(110, (330, 650), -20.0)
    seen = room_with(5, (600, 900), near, far)
    with pytest.raises(
        TargetError, match=r"2 targets are in the frame.*corners_px"
    ) as caught:
        find_target(seen, CARPET)
    assert len(caught.value.likely_px) == 2
    for pose in (near, far):
        found = find_target(seen, CARPET, mm_per_pixel=30.0 / pose.side_px)
        assert error_px(found, pose) < 0.5


def test_a_dim_reflection_is_not_a_second_target() -> None:
    pose, reflected = Pose(160, (300, 250), 8.0), Pose(120, (300, 650), -8.0)
    rng = np.random.default_rng(7)
    room = random_room((600, 900), rng)
    draw_target(room, CELLS, pose, black=0.01, white=0.8)
    draw_target(room, CELLS, reflected, black=0.01, white=0.15, bezel=1.0)
    found = find_target(photograph(as_counts(room, rng)), CARPET)
    assert error_px(found, pose) < 0.5


def test_a_carpet_of_24_pixels_is_too_small() -> None:
    with pytest.raises(TargetError, match=r"spans 2\d pixels: a fit wants 60") as caught:
        find_target(room_with(-1, (600, 900), Pose(24, (200, 500), 10.0)), CARPET)
    assert len(caught.value.likely_px) == 1


def noise(seed: int) -> CellTarget:
    cells = (np.random.default_rng(seed).random((24, 24)) < 0.5).astype(np.float64)
    return CellTarget(cells, (20.0, 20.0), None)


@pytest.mark.slow
def test_another_kind_and_a_mirrored_target_are_told_apart() -> None:
    target, pose = noise(3), Pose(120, (150, 200), 4.0)
    for shown, words in (
        (target.cells[:, ::-1], "shows the target mirrored"),
        (CELLS, "shows a Sierpinski carpet"),
        (noise(4).cells, "the likeliest place correlates"),
    ):
        room = np.zeros((300, 400), np.float32)
        draw_target(room, shown, pose, black=0.02, white=0.8)
        seen = photograph(as_counts(room, np.random.default_rng(8)))
        with pytest.raises(TargetError, match=words):
            find_target(seen, target)


def test_where_nothing_is_found_a_picture_shows_the_likeliest_places() -> None:
    seen = room_with(101, (600, 900))
    with pytest.raises(TargetError) as caught:
        find_target(seen, CARPET)
    assert len(caught.value.likely_px) > 1
    written = jpeg(seen, likely_px=caught.value.likely_px)
    picture = np.asarray(cv2.imdecode(np.frombuffer(written, np.uint8), cv2.IMREAD_COLOR))
    assert (np.abs(picture.astype(int) - ORANGE).max(axis=2) < 60).any()


@pytest.mark.parametrize("pattern", [("M",), ("RG", "GB"), ("RGB",)])
def test_coarse_copies_keep_places(pattern: tuple[str, ...]) -> None:
    rows, columns = np.mgrid[:64, :96].astype(np.float64)
    counts = np.repeat(
        rows + 2 * columns, len(pattern[0]) if pattern == ("RGB",) else 1, axis=1
    )
    picture = Picture(counts, pattern)
    small = picture.scaled(0.25)
    # a plane at the middles of blocks of four by four
    assert small == pytest.approx(picture.part((0, 0), (64, 96), 4), abs=1e-4)
    assert small[3, 5] == pytest.approx(4 * 3 + 1.5 + 2 * (4 * 5 + 1.5), abs=1e-4)
