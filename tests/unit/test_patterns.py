"""Charts found by their pattern, and nothing else: boards and squares as OpenCV projects them, and rooms without."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from labkit.charts.patterns import find_pattern
from labkit.types import Floats
from tests.rooms import as_counts, random_room, sample_pictures

SAMPLE_BOARD = 5  # scikit-image's checkerboard, among its sample pictures
OF_SCIKIT_IMAGE = 22


def projected(
    colours: Floats,
    shape: tuple[int, int],
    side_px: float,
    turn: tuple[float, float, float],
) -> tuple[Floats, Floats]:
    """Draw cells of colours as a camera with 5 % of barrel distortion sees them, tilted and turned.

    Returns the picture, and the places (m, 2) of all corners of cells within it, (row, column).
    """
    rows, columns = shape
    focal = 1.2 * columns
    camera = np.array([[focal, 0, columns / 2], [0, focal, rows / 2], [0, 0, 1]])
    bent = np.array([-0.25, 0.0, 0.0, 0.0])
    high, wide = colours.shape
    rotation = np.array(turn)
    shift = np.array([0.0, 0.0, focal / side_px])
    middle = np.array([wide / 2, high / 2, 0.0])
    y, x = np.mgrid[: 2 * rows, : 2 * columns] / 2 - 0.25
    rays = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), camera, bent)[:, 0]
    turned = cv2.Rodrigues(rotation)[0]
    # a ray meets the chart's plane where its third coordinate on the chart is 0
    through = np.column_stack([rays, np.ones(len(rays))]) @ turned
    start = -shift @ turned
    at = start + through * (-start[2] / through[:, 2])[:, None] + middle
    j, i = np.floor(at[:, :2]).astype(int).T
    inside = (i >= 0) & (i < high) & (j >= 0) & (j < wide)
    seen = np.where(inside, colours[i.clip(0, high - 1), j.clip(0, wide - 1)], 0.6)
    picture = cv2.resize(
        seen.reshape(y.shape), (columns, rows), interpolation=cv2.INTER_AREA
    )
    grid = np.argwhere(np.ones((high + 1, wide + 1), bool))[:, ::-1]
    corners = cv2.projectPoints(
        np.c_[grid, 0 * grid[:, 0]] - middle, rotation, shift, camera, bent
    )[0]
    blurred = np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.2), float)
    return blurred, np.asarray(corners[:, 0, ::-1], float)


def counts(picture: Floats, seed: int = 1) -> Floats:
    rng = np.random.default_rng(seed)
    return np.asarray(500 + 8000 * picture + rng.normal(0, 60, picture.shape))


def board(rows: int, columns: int) -> Floats:
    return np.asarray(np.indices((rows, columns)).sum(axis=0) % 2 * 0.8 + 0.1, float)


@pytest.mark.parametrize(
    ("size", "side_px", "turn"),
    [
        ((7, 10), 70.0, (0.1, -0.2, 0.3)),
        ((7, 10), 30.0, (-0.3, 0.2, 1.4)),
        ((12, 17), 100.0, (0.05, 0.1, 0.09)),  # larger than the frame
        ((5, 6), 130.0, (0.3, 0.3, -0.5)),
    ],
)
def test_a_checkerboards_corners_are_found(
    size: tuple[int, int], side_px: float, turn: tuple[float, float, float]
) -> None:
    shape = (800, 1200)
    picture, corners = projected(board(*size), shape, side_px, turn)
    found = find_pattern(counts(picture))
    assert found is not None
    assert found.kind == "checkerboard"
    away = np.linalg.norm(found.points[:, None] - corners[None], axis=2).min(axis=1)
    assert away.max() < 0.5  # 0.2 measured
    cells = np.argwhere(np.ones((size[0] + 1, size[1] + 1), bool))
    inner = np.all((cells > 0) & (cells < size), axis=1)
    inside = np.all((corners > side_px) & (corners < np.array(shape) - side_px), axis=1)
    whole = inner & inside
    assert len(found.points) >= 0.95 * whole.sum()


def test_squares_in_light_that_slopes_are_found() -> None:
    cells = np.full((9, 13), 0.9)
    cells[1::2, 1::2] = 0.15
    picture, _ = projected(cells, (800, 1200), 75.0, (0.1, -0.1, 0.09))
    light = np.geomspace(1, 0.25, 1200)
    found = find_pattern(counts(picture * light))
    assert found is not None
    assert found.kind == "slanted squares"
    assert len(found.cells) == 4 * 6
    assert len(found.sides) == 4 * 24


def test_samples_without_a_chart_have_none() -> None:
    for k, picture in enumerate(sample_pictures()[:OF_SCIKIT_IMAGE]):
        found = find_pattern(counts(picture.astype(float)))
        assert (found is not None) == (k == SAMPLE_BOARD), k


def test_rooms_without_a_chart_have_none() -> None:
    rng = np.random.default_rng(2)
    pictures = [
        of for k, of in enumerate(sample_pictures()[:OF_SCIKIT_IMAGE]) if k != SAMPLE_BOARD
    ]
    for _ in range(20):
        room = random_room((600, 900), rng, pictures)
        assert find_pattern(as_counts(room, rng).astype(float)) is None


def test_windows_of_a_house_are_no_squares() -> None:
    house = np.full((800, 1200), 0.7)
    for top in range(60, 700, 160):
        for left in range(80, 1100, 150):
            house[top : top + 90, left : left + 90] = 0.2
            house[top : top + 90, left + 42 : left + 48] = 0.8  # a cross of laths
            house[top + 42 : top + 48, left : left + 90] = 0.8
    seen = np.asarray(cv2.GaussianBlur(house, (0, 0), 1.2), float)
    assert find_pattern(counts(seen)) is None
