"""Rooms around a target: scikit-image's and, where Debian's opencv-doc is installed, OpenCV's sample pictures, with things that
a room has: a window, lamps, another screen. And targets drawn into them at any place, size, turn and tilt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

from labkit.types import Floats

OPENCV_SAMPLES = Path("/usr/share/doc/opencv-doc/examples/data")
SAMPLES = (
    "astronaut brick camera cat cell checkerboard clock coffee coins colorwheel grass gravel horse hubble_deep_field "
    "immunohistochemistry logo moon page retina rocket shepp_logan_phantom text"
)
UNIT = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
FINE = 4  # samples of a drawn target along a pixel

Singles = NDArray[np.float32]


@cache
def sample_pictures() -> tuple[Singles, ...]:
    """Return all sample pictures, grey from 0 to 1."""
    modules: Any = data
    pictures = [np.asarray(getattr(modules, name)()) for name in SAMPLES.split()]
    for path in sorted(OPENCV_SAMPLES.glob("*.[jp]*g")):
        read = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if read is not None and min(read.shape[:2]) >= 100:
            pictures.append(np.asarray(read))
    return tuple(_grey(picture) for picture in pictures)


def _grey(picture: NDArray[Any]) -> Singles:
    grey = picture[..., :3].mean(axis=2) if picture.ndim == 3 else picture
    grey = grey.astype(np.float32)
    return np.asarray((grey - grey.min()) / max(float(np.ptp(grey)), 1e-9), np.float32)


def random_room(
    shape: tuple[int, int],
    rng: np.random.Generator,
    pictures: Sequence[Singles] | None = None,
) -> Singles:
    """Return a room (rows, cols), 0 to 1: a part of a sample picture with a window, a lamp and another screen in it."""
    every = sample_pictures() if pictures is None else tuple(pictures)
    room = _part(every[int(rng.integers(len(every)))], shape, rng) ** rng.uniform(0.5, 2.5)
    room *= rng.uniform(0.2, 1.0)
    for _ in range(rng.integers(0, 3)):  # windows and lamps
        corners = _anywhere(shape, rng.uniform(0.05, 0.4) * min(shape), rng)
        cv2.fillConvexPoly(
            room, np.rint(corners[:, ::-1]).astype(np.int32), rng.uniform(0.5, 1.0)
        )
    if rng.random() < 0.5:
        size = (
            int(rng.uniform(0.1, 0.4) * shape[0]),
            int(rng.uniform(0.1, 0.4) * shape[1]),
        )
        top, left = (int(rng.integers(0, n - s)) for n, s in zip(shape, size, strict=True))
        room[top : top + size[0], left : left + size[1]] = 0.02
        rim = max(2, min(size) // 20)
        inside = (size[0] - 2 * rim, size[1] - 2 * rim)
        room[top + rim : top + rim + inside[0], left + rim : left + rim + inside[1]] = (
            _part(every[int(rng.integers(len(every)))], inside, rng)
        )
    return room


def _part(picture: Singles, shape: tuple[int, int], rng: np.random.Generator) -> Singles:
    """Return a part of a picture, turned by quarters, stretched to a shape."""
    picture = np.rot90(picture, int(rng.integers(4)))
    rows, cols = (max(60, int(n * rng.uniform(0.4, 1.0))) for n in picture.shape)
    top, left = (
        int(rng.integers(0, max(1, n - s)))
        for n, s in zip(picture.shape, (rows, cols), strict=True)
    )
    part = np.ascontiguousarray(picture[top : top + rows, left : left + cols])
    return np.asarray(
        cv2.resize(part, shape[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 1)
    )


def _anywhere(shape: tuple[int, int], side: float, rng: np.random.Generator) -> Floats:
    centre = rng.uniform(0, 1, 2) * shape
    return Pose(side, (float(centre[0]), float(centre[1])), rng.uniform(0, 360)).corners()


@dataclass(frozen=True)
class Pose:
    """Where a target is in a frame: its side and its centre (row, column) in pixels, and how it is turned in space, degrees."""

    side_px: float
    centre_px: tuple[float, float]
    roll_deg: float = 0.0
    tilt_deg: float = 0.0
    pan_deg: float = 0.0

    def corners(self, size: float = 1.0) -> Floats:
        """Return the corners (4, 2) of a square of a size, in the target's sides, seen from ten sides away."""
        points = np.column_stack((size * UNIT[:, ::-1], np.zeros(4)))
        turns = (("z", self.roll_deg), ("x", self.tilt_deg), ("y", self.pan_deg))
        for axis, degrees in turns:
            c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
            i, j = {"z": (0, 1), "x": (1, 2), "y": (2, 0)}[axis]
            points[:, [i, j]] = points[:, [i, j]] @ np.array([[c, s], [-s, c]])
        seen = points[:, :2] / (1 + points[:, 2:] / 10) * self.side_px
        return np.asarray(seen[:, ::-1] + np.array(self.centre_px))


def draw_target(
    frame: Singles,
    cells: Floats,
    pose: Pose,
    *,
    black: float,
    white: float,
    blur_px: float = 0.7,
    surround: float = 1.2,
    bezel: float = 1.35,
) -> None:
    """Draw cells of 0 and 1 into a frame, on a black square of `surround` sides, in a grey bezel of `bezel` sides."""
    if bezel > surround:
        shape = np.rint(pose.corners(bezel)[:, ::-1]).astype(np.int32)
        cv2.fillConvexPoly(frame, shape, 0.5 * (black + white))
    reach = pose.corners(surround)
    low = np.maximum(np.floor(reach.min(axis=0) - 4 * blur_px), 0).astype(int)
    high = np.minimum(np.ceil(reach.max(axis=0) + 4 * blur_px) + 1, frame.shape).astype(int)
    if (high <= low).any():
        return
    rows, cols = high - low
    fine = (rows * FINE, cols * FINE)
    rim = (surround - 1) / 2
    border = int(np.ceil(rim * len(cells)))
    drawn = np.pad(cells.astype(np.float32), border)
    grown = 1 + 2 * border / len(cells)
    source = ((UNIT + 0.5) * len(drawn) - 0.5)[:, ::-1].astype(np.float32)
    at = ((pose.corners(grown) - low + 0.5) * FINE - 0.5)[:, ::-1].astype(np.float32)
    map_ = cv2.getPerspectiveTransform(source, at)
    lit = cv2.warpPerspective(drawn, map_, fine[::-1], flags=cv2.INTER_NEAREST)
    covered = np.zeros(fine, np.float32)
    cv2.fillConvexPoly(
        covered,
        np.rint((reach - low + 0.5) * FINE - 0.5)[:, ::-1].astype(np.int32),
        1.0,
    )
    small = tuple(int(n) for n in (cols, rows))
    lit, covered = (
        cv2.resize(x, small, interpolation=cv2.INTER_AREA) for x in (lit, covered)
    )
    part = frame[low[0] : high[0], low[1] : high[1]]
    drawn = part * (1 - covered) + covered * (black + (white - black) * lit)
    frame[low[0] : high[0], low[1] : high[1]] = cv2.GaussianBlur(drawn, (0, 0), blur_px)


def as_counts(
    frame: Singles, rng: np.random.Generator, *, full: float = 12000.0, black: float = 600.0
) -> NDArray[np.uint16]:
    """Return a mosaic's counts of a frame from 0 to 1, with the gains of a colour filter array, photon and read noise."""
    gains = np.tile(
        np.array([[0.55, 1.0], [1.0, 0.7]], np.float32),
        (frame.shape[0] // 2 + 1, frame.shape[1] // 2 + 1),
    )
    light = (
        frame.clip(0, None) * gains[: frame.shape[0], : frame.shape[1]] * np.float32(full)
    )
    noise = rng.standard_normal(frame.shape, dtype=np.float32) * np.sqrt(0.4 * light + 9)
    return np.asarray(np.clip(np.rint(black + light + noise), 0, 16383), np.uint16)


def random_poses(
    shape: tuple[int, int],
    rng: np.random.Generator,
    least_px: float = 60.0,
    most: float = 0.9,
) -> Iterator[Pose]:
    """Yield random poses wholly in a frame: any turn, up to 20 degrees of tilt, sides of `least_px` to `most` of the frame."""
    while True:
        side = float(np.exp(rng.uniform(np.log(least_px), np.log(most * min(shape)))))
        direction, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, 20)
        centre = rng.uniform(0, 1, 2) * shape
        pose = Pose(
            side,
            (float(centre[0]), float(centre[1])),
            float(rng.uniform(0, 360)),
            float(tilt * np.cos(direction)),
            float(tilt * np.sin(direction)),
        )
        corners = pose.corners(1.05)
        if (corners > 2).all() and (corners < np.array(shape) - 3).all():
            yield pose
