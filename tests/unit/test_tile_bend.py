"""Distortion within the tiles of a large target: by the places of all tiles, against the map that made them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from labkit.analysis.target_tiles import TargetPart, target_parts
from labkit.analysis.tile_registration import bends_of_parts
from labkit.drivers.simulated.field import Distortion
from labkit.field.tile_bend import Straight, bend_of
from labkit.field.tile_fit import linear_homography
from labkit.imaging import spline
from labkit.imaging.warp import CORNER_X, CORNER_Y, Pose
from labkit.plan import FieldSettings
from labkit.target.target import CellTarget
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats

FRAME = (4000, 6000)
MIDDLE = (np.array(FRAME) - 1) / 2
CARPET = CellTarget(carpet_cells(5), (120.0, 120.0))
CORNERS = MIDDLE + 1850 * np.stack([CORNER_Y, CORNER_X], axis=1)
WITHIN = np.random.default_rng(1).uniform(-1, 1, (400, 2))


def lens(percent: float) -> Distortion:
    """A lens with a distortion in the frame's corners."""
    k1 = percent / 100 / float(MIDDLE @ MIDDLE)
    return Distortion(k1, (float(MIDDLE[1]), float(MIDDLE[0])))


def undone(of: Distortion) -> Straight:
    """Places without the lens's distortion."""
    return lambda places: np.stack(of.straight(places[:, 1], places[:, 0])[::-1], axis=1)


def tiles() -> list[TargetPart]:
    return target_parts([CORNERS], FieldSettings(), CARPET, FRAME)


def nearest(of: Distortion, pose: Pose) -> Pose:
    """The homography nearest to the image of a tile whose pose without distortion is given."""
    ideal = pose.to_pixels(*WITHIN.T)
    seen = np.stack(of.distorted(ideal[:, 1], ideal[:, 0])[::-1], axis=1)
    matrix = np.append(linear_homography(WITHIN, seen), 1.0).reshape(3, 3)
    return Pose.from_matrix(matrix, pose.half_size_mm, pose.centre_mm)


def bent(bend: Floats, at: Floats) -> Floats:
    """Displacements (n, 2) of places on a tile, halves of its sides."""
    y, x = at.T
    powers = [(i, j) for i in range(4) for j in range(4)]
    return np.asarray(sum(bend[:, i, j] * (y**i * x**j)[:, None] for i, j in powers))


@pytest.mark.parametrize("percent", [-0.8, -5.0, 5.0])
def test_a_bent_pose_shows_the_place_that_a_distorting_lens_shows(percent: float) -> None:
    of = lens(percent)
    straight = undone(of)
    whole = Pose.from_corners(CORNERS, CARPET.size_mm)
    for tile in (tiles()[0], tiles()[2], tiles()[-1]):
        ideal = tile.of(whole)
        pose = nearest(of, ideal)
        shown = WITHIN - bent(bend_of(pose, straight), WITHIN)
        truth = np.stack(ideal.to_target(*straight(pose.to_pixels(*WITHIN.T)).T), axis=1)
        by_plane = np.append(linear_homography(truth, shown), 1.0).reshape(3, 3)
        there = np.column_stack([truth, np.ones(len(truth))]) @ by_plane.T
        # the homography is the fit's to find; measured: 2.6e-5 pixels, of bends of 0.014 to 0.09
        left_px = 100 * (there[:, :2] / there[:, 2:] - shown)
        assert np.abs(left_px).max() < 4e-5


def registered(percent: float) -> dict[TargetPart, list[Floats]]:
    """The target's corners by each tile, with errors of 0.04 pixels, as `register_part` has them."""
    rng = np.random.default_rng(2)
    found = dict[TargetPart, list[Floats]]()
    for tile in tiles():
        whole = Pose.from_corners(CORNERS, CARPET.size_mm)
        pose = nearest(lens(percent), tile.of(whole))
        corners = pose.corners_px()
        middle = corners.mean(axis=0)
        turned = (corners - middle) @ (np.eye(2) + rng.normal(0, 4e-4, (2, 2)))
        moved = turned + middle + rng.normal(0, 0.04, 2)
        size = (2 * pose.half_size_mm[0], 2 * pose.half_size_mm[1])
        own = Pose.from_corners(moved, size)
        placed = Pose(own.v, own.half_size_mm, pose.centre_mm)
        found[tile] = [placed.of_target(CARPET.size_mm).corners_px()]
    return found


def test_registered_tiles_tell_the_bend_of_each() -> None:
    of = lens(-0.8)
    whole = Pose.from_corners(CORNERS, CARPET.size_mm)
    bends = bends_of_parts(FRAME, CARPET.size_mm, registered(-0.8))
    assert len(bends) == len(tiles()) == 24

    for tile, bend in bends.items():
        true = bend_of(nearest(of, tile.of(whole)), undone(of))
        # measured: 0.00014 pixels, of 0.014 in the corners
        assert np.abs(100 * bent(bend - true, WITHIN)).max() < 2e-4


def test_tiles_of_a_lens_without_distortion_are_not_bent() -> None:
    assert bends_of_parts(FRAME, CARPET.size_mm, registered(0.0)) == {}


def test_one_tile_alone_tells_no_distortion() -> None:
    (first, corners), *_ = registered(-5.0).items()
    assert bends_of_parts(FRAME, CARPET.size_mm, {first: corners}) == {}


def test_a_bent_grid_reads_the_spline_at_the_bent_places() -> None:
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(60, 70)).astype(np.float32)
    bend = rng.normal(size=(2, 4, 4)) * 0.3 / 60.0 ** np.add.outer(range(4), range(4))
    onto = np.array([[1.0, 0.02, 4.0], [0.03, 1.0, 4.0], [1e-4, 2e-4, 1.0]])
    i, j = np.mgrid[:45, :50].astype(float)
    places = np.tensordot(onto, np.stack([i, j, np.ones_like(i)]), 1)
    places = (places[:2] / places[2]).reshape(2, -1).T
    at = (places - bent(bend, places)).T
    expected = map_coordinates(samples.astype(float), at, order=5, prefilter=False)
    values = spline.read(samples, onto, i.shape, bend)
    # single precision
    np.testing.assert_allclose(values.ravel(), expected, atol=1e-6)
