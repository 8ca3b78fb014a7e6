"""Targets found in pictures drawn cell by cell at four times the resolution, blurred by scipy and shaded by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from labkit.errors import TargetError
from labkit.experiments.conditions import carpet, draw_trial
from labkit.finder.find_target import find_target
from labkit.finder.picture import Picture, grey_image
from labkit.target.target import CellTarget
from labkit.targets.image import read_radiance
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats

SHARED = Path(__file__).parents[2].parent / "shared"
PICTURES: Any = data  # scikit-image's own, which come without types
UNIT = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Shot:
    """How a synthetic picture is taken."""

    shape: tuple[int, int] = (240, 260)
    side: float = 150.0
    centre: tuple[float, float] = (119.3, 130.8)
    roll_deg: float = 0.0
    tilt_deg: float = 0.0
    pan_deg: float = 0.0
    blur_px: float = 1.0
    shading: float = 0.0
    noise: float = 0.01
    surround: float = 0.0


def corners_of(shot: Shot, aspect: float = 1.0) -> Floats:
    """True corners (row, col): a square turned in space, seen from ten sides away."""
    plane = (UNIT - 0.5) * [1.0, aspect]
    points = np.column_stack((plane[:, 1], plane[:, 0], np.zeros(4)))
    for axis, degrees in (("z", shot.roll_deg), ("x", shot.tilt_deg), ("y", shot.pan_deg)):
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        i, j = {"z": (0, 1), "x": (1, 2), "y": (2, 0)}[axis]
        points[:, [i, j]] = points[:, [i, j]] @ np.array([[c, s], [-s, c]])
    seen = points[:, :2] / (1 + points[:, 2:] / 10) * shot.side
    return np.asarray(seen[:, ::-1] + np.array(shot.centre))


def photograph(
    cells: Floats, shot: Shot, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """(picture, true corners): cells looked up at four times the resolution, averaged, blurred, shaded, noisy."""
    corners, fine = corners_of(shot, cells.shape[1] / cells.shape[0]), 4
    source = UNIT[:, ::-1] * [cells.shape[1], cells.shape[0]] - 0.5
    fine_corners = (corners[:, ::-1] + 0.5) * fine - 0.5
    found = cv2.getPerspectiveTransform(
        fine_corners.astype(np.float32), source.astype(np.float32)
    )
    y, x = np.mgrid[: shot.shape[0] * fine, : shot.shape[1] * fine]
    u, v, w = np.tensordot(found, np.stack((x, y, np.ones_like(x))), axes=1)
    row, col = np.rint(v / w).astype(int), np.rint(u / w).astype(int)
    inside = (row >= 0) & (row < cells.shape[0]) & (col >= 0) & (col < cells.shape[1])
    picture = np.where(inside, cells[row * inside, col * inside], shot.surround)
    picture = picture.reshape(shot.shape[0], fine, shot.shape[1], fine).mean(axis=(1, 3))
    picture = ndimage.gaussian_filter(picture, shot.blur_px)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shot.shape), indexing="ij")
    picture = 600 + 9000 * (0.02 + picture) * (
        1 + shot.shading * (0.5 * x - 0.3 * y - 0.2 * (x * x + y * y))
    )
    return picture + 9000 * shot.noise * rng.standard_normal(shot.shape), corners


def worst(found: Floats, true: Floats) -> float:
    return float(np.max(np.linalg.norm(found - true, axis=1)))


CARPETS = {
    "upright": Shot(),
    "rolled left": Shot(roll_deg=-40.0),
    "rolled and tilted": Shot(roll_deg=30.0, tilt_deg=15.0),
    "tilted and panned": Shot(tilt_deg=-12.0, pan_deg=15.0, blur_px=0.4),
    "out of focus": Shot(blur_px=5.0, roll_deg=5.0),
    "far out of focus": Shot(blur_px=9.0, roll_deg=-3.0, noise=0.005),
    "aliased": Shot(blur_px=0.2, roll_deg=3.0),
    "unevenly lit": Shot(shading=0.9, roll_deg=8.0),
    "noisy": Shot(noise=0.15, roll_deg=-12.0),
    "small": Shot(side=60.0, blur_px=0.7),
    "filling the frame": Shot(side=236.0),
    "on white": Shot(surround=1.0, roll_deg=6.0, blur_px=2.0),
    "off centre": Shot(side=80.0, centre=(45.0, 210.0), roll_deg=2.0),
    "large": Shot(
        shape=(900, 1400), side=760.0, centre=(440.0, 700.0), roll_deg=4.0, blur_px=6.0
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CARPETS)
def test_a_carpet_is_found_within_half_a_pixel(name: str) -> None:
    shot = CARPETS[name]
    picture, true = photograph(carpet_cells(4), shot, np.random.default_rng(3))
    target = CellTarget(carpet_cells(4), (30.0, 30.0), surround=shot.surround)
    # a small picture to half a pixel, a large one to a thousandth of the side, a blurred one to a tenth of the blur
    assert worst(find_target(picture, target), true) < max(
        0.5, shot.side / 1000, shot.blur_px / 10
    )


def test_a_carpet_is_found_where_its_surround_is_not_known_and_cluttered() -> None:
    rng = np.random.default_rng(4)
    picture, true = photograph(carpet_cells(5), Shot(side=110.0, roll_deg=5.0), rng)
    outside = (
        cv2.fillConvexPoly(
            np.ones(picture.shape), np.rint(true[:, ::-1]).astype(np.int32), 0.0
        )
        > 0
    )
    clutter = ndimage.gaussian_filter(rng.standard_normal(picture.shape), 6.0)
    picture[outside] += 40000 * np.abs(clutter[outside])
    assert (
        worst(find_target(picture, CellTarget(carpet_cells(5), (30.0, 30.0), None)), true)
        < 0.5
    )


def test_a_carpet_that_could_stand_eight_ways_is_given_its_least_rotation() -> None:
    rng = np.random.default_rng(5)
    target = CellTarget(carpet_cells(4), (30.0, 30.0))
    for roll in (100.0, 185.0, -85.0):
        picture, true = photograph(carpet_cells(4), Shot(roll_deg=roll), rng)
        turns = round(roll / 90)
        assert worst(find_target(picture, target), np.roll(true, turns, axis=0)) < 0.5


@pytest.mark.parametrize("roll_deg", [0.0, 93.0, 178.0, -80.0])
def test_a_noise_pattern_is_found_whichever_way_it_is_turned(roll_deg: float) -> None:
    rng = np.random.default_rng(6)
    cells = (rng.random((128, 128)) < 0.5).astype(np.float64)
    shot = Shot(side=90.0, roll_deg=roll_deg, tilt_deg=6.0, blur_px=0.6)
    picture, true = photograph(cells, shot, rng)
    target = CellTarget(cells, (20.0, 20.0), None)
    assert worst(find_target(picture, target, mm_per_pixel=20.0 / 90 * 1.1), true) < 0.5


@pytest.mark.slow
def test_an_oblong_picture_is_found_without_its_scale() -> None:
    cells = PICTURES.camera()[100:400:2, 50:450:2] / 255.0
    picture, true = photograph(
        cells, Shot(side=100.0, roll_deg=7.0, shading=0.3), np.random.default_rng(7)
    )
    target = CellTarget(cells, (15.0, 20.0), None)
    assert worst(find_target(picture, target), true) < 0.7


NOTHING: dict[str, Callable[[np.random.Generator], Floats]] = {
    "black": lambda rng: np.full((200, 260), 600.0),
    "noise": lambda rng: 600 + rng.standard_normal((200, 260)),
    "flat": lambda rng: (
        (1000 + 5 * np.arange(260.0)) * np.ones((200, 1))
        + 20 * rng.standard_normal((200, 260))
    ),
    "hot pixels": lambda rng: np.where(
        rng.random((200, 260)) < 1e-3, 16000.0, 600 + rng.standard_normal((200, 260))
    ),
    "people": lambda rng: PICTURES.camera().astype(np.float64),
    "coins": lambda rng: PICTURES.coins().astype(np.float64),
    "text": lambda rng: PICTURES.page().astype(np.float64),
    "checkers": lambda rng: PICTURES.checkerboard().astype(np.float64),
    "a white square": lambda rng: (
        np.pad(np.full((50, 50), 900.0), 75) + rng.standard_normal((200, 200))
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTHING)
@pytest.mark.parametrize("mm_per_pixel", [None, 0.2])
def test_a_picture_without_the_target_is_refused_in_one_line(
    name: str, mm_per_pixel: float | None
) -> None:
    picture = NOTHING[name](np.random.default_rng(8))
    with pytest.raises(TargetError, match="no target found in the frame") as caught:
        find_target(
            picture, CellTarget(carpet_cells(5), (30.0, 30.0)), mm_per_pixel=mm_per_pixel
        )
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    "centre", [(99.0, 240.0), (60.0, 130.0), (10.0, 20.0), (239.0, 130.0), (99.0, 0.0)]
)
def test_a_carpet_partly_out_of_the_frame_is_not_taken_for_a_smaller_one(
    centre: tuple[float, float],
) -> None:
    picture, _ = photograph(
        carpet_cells(5), Shot(side=180.0, centre=centre), np.random.default_rng(9)
    )
    with pytest.raises(TargetError, match="frame"):
        find_target(picture, CellTarget(carpet_cells(5), (30.0, 30.0)))


def test_the_grey_image_of_a_mosaic_stays_in_place_and_loses_the_mosaic() -> None:
    rng = np.random.default_rng(10)
    picture, true = photograph(carpet_cells(4), Shot(noise=0.0, roll_deg=3.0), rng)
    mosaic = picture - 600
    mosaic[0::2, 0::2] *= 0.4
    mosaic[1::2, 1::2] *= 0.6
    seen = Picture(mosaic + 512, ("RG", "GB"))
    assert worst(find_target(seen, CellTarget(carpet_cells(4), (30.0, 30.0))), true) < 0.3
    assert grey_image(picture, ("M",)) == pytest.approx(
        np.clip(grey_image(picture, ("M",)), -0.2, 1.2)
    )


@pytest.mark.parametrize("picture", [np.zeros((0, 4)), np.full((50, 50), np.nan)])
def test_what_is_no_picture_is_refused(picture: Floats) -> None:
    with pytest.raises(TargetError, match="no pixels"):
        find_target(picture, CellTarget(carpet_cells(2), (1.0, 1.0)))


@pytest.mark.skipif(
    not (SHARED / "real").is_dir(), reason="the shared photographs are not here"
)
def test_the_noise_target_is_found_in_a_real_photograph() -> None:
    picture = 255 * read_radiance(SHARED / "real/ipol/img_example.pgm")
    target = CellTarget(
        read_radiance(SHARED / "real/ipol/pattern_noise.pgm"), (10.0, 10.0), None
    )
    by_hand = np.array([(84.5, 114.5), (84.5, 205.5), (175.5, 207.0), (176.0, 116.0)])
    assert (
        worst(find_target(picture, target, mm_per_pixel=10.0 / 91), by_hand) < 3.0
    )  # they are "near" that


@pytest.mark.parametrize("fading", [0.0, 0.12])
def test_an_even_panel_whose_corners_fade_is_no_picture_of_a_target(fading: float) -> None:
    y, x = np.meshgrid(*2 * [np.linspace(-1, 1, 64)], indexing="ij")
    panel = 9000 * (1 - fading * (x**2 + y**2) / 2) + np.random.default_rng(3).normal(
        0, 70, (64, 64)
    )
    with pytest.raises(
        TargetError, match=r"nearly even, bright parts 1\.\d\d times as bright"
    ):
        grey_image(panel, ("RG", "GB"))
    with pytest.raises(TargetError, match="no target found in the frame"):
        find_target(Picture(panel, ("RG", "GB")), CellTarget(carpet_cells(5), (30.0, 30.0)))


def test_a_sliver_along_an_edge_is_not_taken_for_the_target() -> None:
    # a picture in which a quadrilateral of 6 x 1 pixels, stretched, correlated well enough; a fit wants about a pixel
    trial = draw_trial(np.random.default_rng([49, 50, 12, 25]), snr=50.0)
    assert worst(find_target(trial.frame.counts, carpet()), trial.pose.corners_px()) < 1.0
