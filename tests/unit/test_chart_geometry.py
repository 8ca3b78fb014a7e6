"""Distortion and pose by a chart's points against a camera in closed form, and OpenCV's own errors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from labkit.charts.geometry import ChartGeometry, chart_geometry
from labkit.optics.field import FieldFrame
from labkit.types import Floats

FRAME = FieldFrame((3000, 4096), 3.45)
FOCAL_MM = 12.0
K1, K2 = -0.08, 0.03
NOISE_PX = 0.05
CELLS = np.argwhere(np.ones((9, 13), bool))
TILTS_DEG = ((4.0, -7.0), (-3.0, 2.0))


def seen(
    tilts_deg: tuple[float, float], rng: np.random.Generator, bend: float = 0.0
) -> Floats:
    """(m, 2) points, (row, column), of a board of unit squares; bend: by which its middle is nearer."""
    down, right = np.tan(np.radians(tilts_deg))
    y, x = (CELLS - [4.0, 6.0]).T
    rightwards = np.array([1, 0, right]) / np.hypot(1, right)
    normal = np.array([-right, -down, 1]) / np.sqrt(1 + right**2 + down**2)
    at = np.outer(x, rightwards) + np.outer(y, np.cross(normal, rightwards))
    x, y = at[:, :2].T
    z = 18.0 + at[:, 2] - bend * (1 - (x / 6) ** 2)
    u, v = x / z, y / z
    square = u * u + v * v
    light = 1 + K1 * square + K2 * square**2
    focal_px = FOCAL_MM * 1e3 / FRAME.pixel_pitch_um
    points = FRAME.centre_px + focal_px * (np.column_stack([v, u]) * light[:, None])
    return np.asarray(points + rng.normal(0, NOISE_PX, points.shape))


def geometry(rng: np.random.Generator, bend: float = 0.0) -> ChartGeometry:
    found = chart_geometry(
        [(CELLS, seen(of, rng, bend)) for of in TILTS_DEG], FRAME, FOCAL_MM
    )
    assert found is not None
    return found


def test_distortion_and_tilts_are_within_errors() -> None:
    pulls: list[float] = []
    for seed in range(20):
        found = geometry(np.random.default_rng(seed))
        ideal = np.linspace(0, 0.6, 60_000)
        light = 1 + K1 * ideal**2 + K2 * ideal**4
        truth = np.interp(found.height_mm / FOCAL_MM, ideal * light, light) - 1
        pulls.append(float(found.distortion.value - truth) / found.distortion.std)
        for pose, tilts in zip(found.poses, TILTS_DEG, strict=True):
            both = zip(pose.tilts_deg, tilts, strict=True)
            pulls += [(of.value - true) / of.std for of, true in both]
            assert pose.rms_px == pytest.approx(NOISE_PX * np.sqrt(2), rel=0.2)
            assert not pose.bent
    assert np.abs(pulls).max() < 4
    assert np.std(pulls) == pytest.approx(1, abs=0.28)  # of 100, four of their own errors


def test_errors_are_opencvs() -> None:
    rng = np.random.default_rng(1)
    points = [seen(of, rng) for of in TILTS_DEG]
    found = chart_geometry([(CELLS, of) for of in points], FRAME, FOCAL_MM)
    assert found is not None
    focal_px = FOCAL_MM * 1e3 / FRAME.pixel_pitch_um
    centre = FRAME.centre_px[::-1]
    board = np.column_stack([CELLS[:, ::-1], np.zeros(len(CELLS))]).astype(np.float32)
    std = cv2.calibrateCameraExtended(
        [board, board],
        [of[:, ::-1].astype(np.float32) for of in points],
        FRAME.shape_px[::-1],
        np.array([[focal_px, 0, centre[0]], [0, focal_px, centre[1]], [0, 0, 1]]),
        np.zeros(5),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_FIX_FOCAL_LENGTH
        | cv2.CALIB_FIX_PRINCIPAL_POINT
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_FIX_K3,
    )[5].ravel()
    assert [of.std for of in found.radial] == pytest.approx(std[4:6], rel=0.05)


def test_a_bent_chart_is_told() -> None:
    found = geometry(np.random.default_rng(3), bend=0.2)
    assert all(pose.bent for pose in found.poses)


def test_a_few_points_have_no_geometry() -> None:
    few = (CELLS[:6], seen(TILTS_DEG[0], np.random.default_rng(1))[:6])
    assert chart_geometry([few], FRAME, FOCAL_MM) is None
