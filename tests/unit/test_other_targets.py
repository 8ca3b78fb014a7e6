"""Carpets of another order, negatives and surrounds are told from the photograph, and never in place of the right one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from labkit.errors import TargetError
from labkit.finder.find_target import find_target
from labkit.finder.other_targets import carpet_order
from labkit.photographs.photograph import Photograph
from labkit.target.target import CellTarget
from labkit.targets.noise import noise_cells
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats, Floats32
from tests.rooms import Pose, as_counts, draw_target

MIDDLE = (135.3, 141.8)
POSE = Pose(230.0, MIDDLE, 7.0, 3.0)
SHARP = np.ones((1, 1), np.float32)


def carpet(order: int) -> CellTarget:
    return CellTarget(carpet_cells(order), (30.0, 30.0))


def disc(radius_px: float) -> Floats32:
    """Light of a point far out of focus; its edge is as sharp as a geometric image's."""
    y, x = np.mgrid[-20:21, -20:21]
    return np.asarray(np.clip(radius_px + 0.5 - np.hypot(y, x), 0, 1), np.float32)


def line(length_px: int) -> Floats32:
    """Light of a shaken camera: along a diagonal."""
    return np.eye(length_px, dtype=np.float32)


def shot(cells: Floats, kernel: Floats32 = SHARP, pose: Pose = POSE) -> Photograph:
    """A mosaic of cells in a dark room, through a kernel, with noise."""
    room = np.full((270, 280), 0.02, np.float32)
    draw_target(room, cells, pose, black=0.02, white=0.8, blur_px=0.4, bezel=0)
    room = np.asarray(cv2.filter2D(room, -1, kernel / kernel.sum()), np.float32)
    counts = as_counts(room, np.random.default_rng(4))
    return Photograph(counts, np.full((2, 2), 600.0), 16383.0, ("RG", "GB"))


@pytest.mark.parametrize(("stated", "shown"), [(4, 5), (3, 5), (5, 4), (5, 3), (3, 4)])
def test_another_order_is_told(stated: int, shown: int) -> None:
    words = rf"shows order {shown}, \[target\] order = {stated}: write order = {shown}$"
    with pytest.raises(TargetError, match=words):
        find_target(shot(carpet_cells(shown)), carpet(stated))


KERNELS = [SHARP, *map(disc, (1.5, 2.5, 4.0, 6.0, 9.0)), *map(line, (2, 3, 5))]


@pytest.mark.parametrize("kernel", KERNELS, ids=range(len(KERNELS)))
@pytest.mark.parametrize("order", [3, 4, 5])
def test_the_right_order_is_never_doubted(order: int, kernel: Floats32) -> None:
    found = find_target(shot(carpet_cells(order), kernel), carpet(order))
    assert np.abs(found.mean(axis=0) - MIDDLE).max() < 1.0  # measured: 0.50 at most


def test_an_order_that_the_lens_does_not_resolve_is_not_told() -> None:
    # the finest squares of 0.9 pixels, 2.8 pixels apart, are even grey through a disc of 12 pixels
    for order in (4, 6):
        found = find_target(shot(carpet_cells(5), disc(6.0)), carpet(order))
        assert np.abs(found.mean(axis=0) - MIDDLE).max() < 1.0  # measured: 0.50 at most


@pytest.mark.parametrize("order", [3, 5])
def test_the_negative_of_a_carpet_is_told(order: int) -> None:
    with pytest.raises(TargetError, match="shows the negative of the target: exchange"):
        find_target(shot(1 - carpet_cells(order)), carpet(order))


def test_the_negative_of_a_picture_is_told() -> None:
    target = CellTarget(noise_cells(24, 3), (20.0, 20.0), None)
    with pytest.raises(TargetError, match="shows the negative of the target"):
        find_target(shot(1 - target.cells), target)
    negative = replace(carpet(5), cells=1 - carpet_cells(5))
    with pytest.raises(TargetError, match="shows the negative of the target"):
        find_target(shot(carpet_cells(5)), negative)


def test_a_black_surround_is_told_where_the_frame_ends_beside_the_target() -> None:
    pose = Pose(230.0, (135.3, 141.8), 0.3)
    seen = shot(carpet_cells(5), pose=pose)
    # as in the golden sessions, too little of the surround is in the frame to be looked at apart
    low = np.floor(pose.corners().min(axis=0)).astype(int) // 2 * 2 - 8
    high = np.ceil(pose.corners().max(axis=0)).astype(int) // 2 * 2 + 10
    cut = replace(seen, counts=seen.counts[low[0] : high[0], low[1] : high[1]])
    with pytest.raises(TargetError, match=r'black surround.* write surround = "black"'):
        find_target(cut, replace(carpet(5), surround=1.0))


def test_the_order_of_a_carpet_is_read_from_its_cells() -> None:
    assert [carpet_order(carpet(n)) for n in (1, 2, 5)] == [1, 2, 5]
    assert carpet_order(CellTarget(1 - carpet_cells(3), (9.0, 9.0))) is None
    assert carpet_order(CellTarget(noise_cells(27, 1), (9.0, 9.0))) is None
