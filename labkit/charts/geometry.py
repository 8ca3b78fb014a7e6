"""Distortion of a lens and the pose of a chart, by the points of its lattice: the chart is one plane, which residuals test.

The lens is a pinhole at the plan's focal length with radial distortion (Brown, *Photogrammetric Engineering* 37, 1971), as
OpenCV's `calibrateCameraExtended` has it; its centre is the frame's. Errors are by least squares, as OpenCV's are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import norm

from labkit.optics.field import FieldFrame
from labkit.types import Floats
from labkit.uncertain import Uncertain

LEAST_POINTS = 9
TWO_TERMS = 40  # points from which the fourth power of the radius is fitted, too
POSE = 6  # numbers of a pose
UNDISTORTING = 20  # steps from a distorted radius to that of a pinhole
SURELY_BENT = 1e-6  # probability of the neighbours' agreement, if the chart was a plane
LEAST_BEND_PX = 0.2  # RMS: pixels near a corner, and blur, move neighbours alike by less
TABLE = (
    "photograph",
    "points",
    "tilt about rows' axis",
    "tilt about columns' axis",
    "RMS, px",
)


@dataclass(frozen=True)
class ChartPose:
    """The pose of a chart in a photograph.

    Attributes
    ----------
    photograph, points : its number, and the points of the lattice
    tilts_deg : (2,) by which the chart is tilted against the sensor: its lower end, and its right end, farther away
    rms_px : of the points' residuals
    bent : whether neighbours' residuals agree: the chart is no plane, or the lens distorts otherwise
    """

    photograph: int
    points: int
    tilts_deg: tuple[Uncertain, Uncertain]
    rms_px: float
    bent: bool

    @property
    def row(self) -> list[str]:
        """Cells of the table."""
        tilts = [f"{of}°" for of in self.tilts_deg]
        return [str(self.photograph + 1), str(self.points), *tilts, f"{self.rms_px:.3f}"]


@dataclass(frozen=True)
class ChartGeometry:
    """Distortion and poses.

    Attributes
    ----------
    radial : coefficients k1, or k1 and k2, of the squared radius over the focal length
    height_mm : of the outermost point
    distortion : of the image height there, relative
    poses : one for each photograph
    """

    radial: tuple[Uncertain, ...]
    height_mm: float
    distortion: Uncertain
    poses: tuple[ChartPose, ...]

    def rows(self) -> list[list[str]]:
        """Return a heading and a row for each photograph."""
        return [[*TABLE], *(pose.row for pose in self.poses)]

    @property
    def sentence(self) -> str:
        """The distortion in words."""
        percent = Uncertain(100 * self.distortion.value, 100 * self.distortion.std)
        return f"distortion {percent} % at an image height of {self.height_mm:.2f} mm"

    def as_json(self) -> dict[str, Any]:
        """Return the entry "geometry"."""
        return {
            "radial": list(self.radial),
            "height_mm": self.height_mm,
            "distortion": self.distortion,
            "poses": [
                {
                    "photograph": pose.photograph,
                    "points": pose.points,
                    "tilt_rows_deg": pose.tilts_deg[0],
                    "tilt_columns_deg": pose.tilts_deg[1],
                    "rms_px": pose.rms_px,
                    "bent": pose.bent,
                }
                for pose in self.poses
            ],
        }


def chart_geometry(
    lattices: Sequence[tuple[NDArray[np.intp], Floats]],
    frame: FieldFrame,
    focal_mm: float,
) -> ChartGeometry | None:
    """Return the distortion that all photographs share, and the pose of the chart in each; None for too few points.

    Parameters
    ----------
    lattices : of each photograph cells (m, 2) and the points there (m, 2), (row, column) in pixels
    frame : coordinates
    focal_mm : distance of the lens's rear principal point from the sensor
    """
    used = [k for k, (cells, _) in enumerate(lattices) if len(cells) >= LEAST_POINTS]
    if not used:
        return None
    chart = [_on_plane(lattices[k][0]) for k in used]
    seen = [lattices[k][1][:, ::-1] for k in used]
    terms = 2 if sum(map(len, seen)) >= TWO_TERMS else 1
    focal_px = focal_mm * 1e3 / frame.pixel_pitch_um
    camera = np.diag([focal_px, focal_px, 1.0])
    camera[:2, 2] = frame.centre_px[::-1]
    fit = _fitted(chart, seen, frame.shape_px[::-1], camera, terms)
    poses = tuple(
        _pose(fit, j, k, points)
        for j, (k, points) in enumerate(zip(used, seen, strict=True))
    )
    std = np.sqrt(np.diag(fit.of_radial))
    radial = tuple(
        Uncertain(float(value), float(error))
        for value, error in zip(fit.radial, std, strict=True)
    )
    centre = frame.centre_px[::-1]
    away = max(float(np.hypot(*(of - centre).T).max()) for of in seen)
    height_mm = away * frame.pixel_pitch_um * 1e-3
    return ChartGeometry(radial, height_mm, fit.distortion(away / focal_px), poses)


def _on_plane(cells: NDArray[np.intp]) -> Floats:
    """Return points (m, 3) of the chart, right, down and away, in squares."""
    return np.column_stack([cells[:, ::-1], np.zeros(len(cells))])


@dataclass(frozen=True)
class _Fit:
    """Poses and distortion.

    Attributes
    ----------
    turns : (3,) of each photograph, radians
    radial : (terms,)
    residuals : (m, 2) of each photograph, px
    covariance : (numbers, numbers) of all poses, then the radial terms
    """

    turns: list[Floats]
    radial: Floats
    residuals: list[Floats]
    covariance: Floats

    @property
    def of_radial(self) -> Floats:
        """Covariance of the radial terms."""
        terms = len(self.radial)
        return self.covariance[-terms:, -terms:]

    def distortion(
        self,
        radius: float,
    ) -> Uncertain:
        """Return the relative distortion at a radius in the picture, in focal lengths."""
        degrees = 2 * np.arange(1, len(self.radial) + 1)
        ideal = radius
        for _ in range(UNDISTORTING):
            ideal = radius / (1 + float(ideal**degrees @ self.radial))
        powers = ideal**degrees
        variance = powers @ self.of_radial @ powers
        value = float(powers @ self.radial)
        return Uncertain(value, float(np.sqrt(variance)))


def _fitted(
    chart: Sequence[Floats],
    seen: Sequence[Floats],
    size: tuple[int, ...],
    camera: Floats,
    terms: int,
) -> _Fit:
    """Fit poses and radial terms."""
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_FOCAL_LENGTH
    flags |= cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K3
    if terms == 1:
        flags |= cv2.CALIB_FIX_K2
    found = cv2.calibrateCameraExtended(
        [of.astype(np.float32) for of in chart],
        [of.astype(np.float32) for of in seen],
        size,
        camera,
        np.zeros(5),
        flags=flags,
    )
    brown = np.ravel(found[2])[:5].astype(float)
    turns = [np.ravel(of).astype(float) for of in found[3]]
    shifts = [np.ravel(of).astype(float) for of in found[4]]
    left, slopes = _residuals(chart, seen, turns, shifts, camera, brown, terms)
    freedom = max(left.size - slopes.shape[1], 1)
    square = float(left @ left) / freedom
    covariance = square * np.linalg.pinv(slopes.T @ slopes)
    ends = np.cumsum([len(of) for of in seen])[:-1]
    parts = np.split(left.reshape(-1, 2), ends)
    return _Fit(turns, brown[:terms], parts, covariance)


def _pose(
    fit: _Fit,
    j: int,
    photograph: int,
    points: Floats,
) -> ChartPose:
    """Return the pose of the fit's photograph j, whose points (m, 2) were seen."""
    at = slice(POSE * j, POSE * j + 3)
    left = fit.residuals[j]
    rms = float(np.sqrt(np.mean(left**2) * 2))
    return ChartPose(
        photograph,
        len(points),
        _tilts(fit.turns[j], fit.covariance[at, at]),
        rms,
        rms > LEAST_BEND_PX and _agree(points, left),
    )


def _residuals(
    chart: Sequence[Floats],
    seen: Sequence[Floats],
    turns: Sequence[Floats],
    shifts: Sequence[Floats],
    camera: Floats,
    distortion: Floats,
    terms: int,
) -> tuple[Floats, Floats]:
    """Return residuals (n,), px, and the slopes (n, numbers) of the model by all poses and the radial terms."""
    size = POSE * len(chart) + terms
    left = []
    rows = []
    for j, (points, pixels) in enumerate(zip(chart, seen, strict=True)):
        expected, slopes = cv2.projectPoints(
            points, turns[j], shifts[j], camera, distortion
        )
        left.append((pixels - expected[:, 0]).ravel())
        row = np.zeros((2 * len(points), size))
        row[:, POSE * j : POSE * (j + 1)] = slopes[:, :POSE]
        # behind the pose stand two focal lengths and two coordinates of the centre
        row[:, size - terms :] = slopes[:, POSE + 4 : POSE + 4 + terms]
        rows.append(row)
    return np.concatenate(left), np.vstack(rows)


def _tilts(
    turn: Floats,
    covariance: Floats,
) -> tuple[Uncertain, Uncertain]:
    """Return how much farther away the chart's lower and right ends are, degrees, of a turn (3,) in radians."""

    def of(vector: Floats) -> Floats:
        normal = cv2.Rodrigues(vector)[0][:, 2]
        normal = normal * np.sign(normal[2])
        return np.asarray(np.degrees(np.arctan2(-normal[[1, 0]], normal[2])), float)

    step = 1e-5
    slopes = np.array(
        [(of(turn + step * one) - of(turn - step * one)) / (2 * step) for one in np.eye(3)]
    )
    std = np.sqrt(np.einsum("ik,ij,jk->k", slopes, covariance, slopes))
    down, right = map(Uncertain, of(turn), std)
    return down, right


def _agree(
    points: Floats,
    left: Floats,
) -> bool:
    """Return whether residuals (m, 2) of neighbouring points (m, 2) agree by more than chance (Moran's statistic)."""
    _, nearest = cKDTree(points).query(points, min(5, len(points)))
    near = np.reshape(nearest, (len(points), -1))
    products = (left[:, None] * left[near[:, 1:]]).sum(axis=2)
    correlation = float(products.sum()) / max(near.shape[1] - 1, 1) / float((left**2).sum())
    pairs = products.size
    return bool(norm.sf(correlation * np.sqrt(pairs)) < SURELY_BENT)
