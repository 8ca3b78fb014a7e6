"""The target's tilt by its perspective, and the sensor's tilt without it.

The depth of a target's point over that of the point in the middle of the frame is the
denominator of the plane homography: w = 1 + g·h to first order in the place h on the sensor
in mm. A target r away (Z from the entrance pupil) is then Z g mm deeper for each mm on the
sensor, and its image m² times as much nearer to the lens, with the longitudinal magnification
m² = f² / (r - f)². So the focus over the sensor slopes by

    m² Z g

more than with a target parallel to the sensor: that much of the slope is the target's. What
perspective shows is the angle between target and sensor, not between target and lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, sqrt
from typing import Any

import numpy as np
from scipy.stats import chi2

from labkit.arrays import real_array, symmetric
from labkit.field.geometry import FieldGeometry
from labkit.field.pair import Pair
from labkit.field.tile_model import Numbers
from labkit.optics.lens import ThinLens
from labkit.types import Floats
from labkit.uncertain import Uncertain

CONTRADICTED_P = 0.01
"""Probability of ranges that contradict the perspective's tilts by chance."""

TELLING_SHARE_STD = 0.25
"""Largest standard error of the share of the target's tilts that shows up in focus, for ranges that test it."""

SHARE_ROUNDS = 5
"""In which the target's tilts get the weight that their share leaves them."""


@dataclass(frozen=True, eq=False)
class TargetTilts:
    """How the target was tilted against the sensor at each range.

    Parameters
    ----------
    ranges_mm : (stations,)
    depth_per_mm : (stations, 2) g: relative growth of depth, down and right, for each mm on the sensor
    covariance : (2 stations, 2 stations) of `depth_per_mm.ravel()`
    pupil_to_image_mm : (stations,) of the angles; nan for an unknown range
    um : (stations,) slope of focus for each unit of g, µm; nan for an unknown range
    um_relative_std : relative standard error of `um`, common to all ranges
    """

    ranges_mm: tuple[float | None, ...]
    depth_per_mm: Floats
    covariance: Floats
    pupil_to_image_mm: Floats
    um: Floats
    um_relative_std: float = 0.0

    @property
    def angles_deg(self) -> list[tuple[Uncertain, Uncertain]]:
        """Tilt of the target at each range: of its lower side, and of its right side, away from the camera."""
        std = np.sqrt(np.diag(self.covariance)).reshape(-1, 2)
        slope = self.pupil_to_image_mm[:, None] * self.depth_per_mm
        error = self.pupil_to_image_mm[:, None] * std / (1 + slope**2)
        angles = np.degrees(np.stack([np.arctan(slope), error], axis=-1))
        return [
            (Uncertain(down[0], down[1], "deg"), Uncertain(right[0], right[1], "deg"))
            for down, right in angles
        ]

    @property
    def focus_um_per_mm(self) -> Floats:
        """(stations, 2) slope of focus over the sensor that is the target's; positive where the sensor is behind the image."""
        return np.asarray(self.um[:, None] * self.depth_per_mm)

    @property
    def focus_covariance(self) -> Floats:
        """(2 stations, 2 stations) of `focus_um_per_mm.ravel()`."""
        each = np.repeat(self.um, 2)
        lens = self.um_relative_std * self.focus_um_per_mm.ravel()
        return np.asarray(np.outer(each, each) * self.covariance + np.outer(lens, lens))


@dataclass(frozen=True, eq=False)
class SeparatedTilt:
    """The slope of focus over the sensor that is the camera's.

    Parameters
    ----------
    value : (2,) µm/mm, down and right, positive where the sensor is behind the image
    covariance : (2, 2)
    share : of the target's tilts by perspective that shows up in focus: 1 for a tilt of the target
    p_value : probability of slopes that contradict a share of 1 as much; nan where one range is alone
    unknown : what these ranges do not determine, in words
    """

    value: Floats
    covariance: Floats
    share: Uncertain
    p_value: float
    unknown: tuple[str, ...]

    @property
    def slope(self) -> Pair:
        """The camera's slope of focus, um/mm."""
        return Pair(self.value, self.covariance, "µm/mm")

    @property
    def words(self) -> str:
        """The camera's tilt in a sentence."""
        std = np.sqrt(np.diag(self.covariance))
        down, right = (
            Uncertain(value, error) for value, error in zip(self.value, std, strict=True)
        )
        without = (
            "the target's tilt" if not self.perspective_contradicted else "perspective"
        )
        return f"sensor tilt without {without}, by the tiles: {down} µm/mm down, {right} µm/mm right"

    def as_json(self) -> dict[str, Any]:
        """Return the tilt with its covariance, the share, and what is unknown."""
        return {
            "um_per_mm": {
                "value": self.value.tolist(),
                "covariance": self.covariance.tolist(),
            },
            "share_of_perspective": self.share.as_json(),
            "p_value": None if np.isnan(self.p_value) else self.p_value,
            "unknown": list(self.unknown),
        }

    @property
    def perspective_contradicted(self) -> bool:
        """Return whether the perspective is not the target's tilt, so that its share was estimated."""
        return self.p_value < CONTRADICTED_P


def target_tilts(
    geometry: FieldGeometry, lens: ThinLens, focal_relative_std: float = 0.0
) -> TargetTilts:
    """Return the target's tilts against the sensor at all ranges of a fit.

    focal_relative_std : relative standard error of the lens's focal length, to whose square the slope of focus is proportional
    """
    model = geometry.model
    ranges = np.array([nan if r is None else r for r in model.ranges_mm])
    known = np.isfinite(ranges)
    focal_mm = lens.focal_length_mm
    magnification = focal_mm / (ranges - focal_mm)
    pupil_to_image = np.full(len(ranges), nan)
    pupil_to_image[known] = lens.pupil_to_image_mm(ranges[known])

    def gradients(numbers: Numbers) -> Numbers:
        stations = range(len(ranges))
        back = [np.linalg.inv(model.matrix(numbers, k))[2] for k in stations]
        return np.concatenate([-row[:2] / row[2] for row in back])

    depth, covariance = geometry.linear(gradients)
    um = 1e3 * magnification**2 * model.distances_mm
    return TargetTilts(
        model.ranges_mm,
        depth.reshape(-1, 2),
        covariance,
        pupil_to_image,
        um,
        2 * focal_relative_std,
    )


def sensor_tilt(
    slopes_um_per_mm: Floats, covariance: Floats, tilts: TargetTilts
) -> SeparatedTilt:
    """Separate the slopes of focus over the sensor into the camera's and the target's.

    Slopes of two ranges or more test that the target's tilts show up in focus as the
    perspective predicts. Where they do not, something else than a tilt makes the
    perspective, and the share of it that shows up in focus is estimated with the tilt.

    Parameters
    ----------
    slopes_um_per_mm : (stations, 2) at the ranges of `tilts`
    covariance : (2 stations, 2 stations) of the slopes
    tilts : by perspective

    Raises
    ------
    ValueError : arrays of other shapes, or an unknown range
    """
    count = len(tilts.ranges_mm)
    slopes = real_array("slopes_um_per_mm", slopes_um_per_mm, (count, 2), "µm/mm").ravel()
    own = symmetric("covariance", covariance, 2 * count, "(µm/mm)²")
    if not np.all(np.isfinite(tilts.um)):
        raise ValueError("the target's tilt needs the ranges of all photographs, in mm")
    target = tilts.focus_um_per_mm.ravel()
    both = own + tilts.focus_covariance
    level = np.tile(np.eye(2), (count, 1))
    value, of_value, square = _solve(level, slopes - target, both)
    p_value = float(chi2.sf(square, 2 * count - 2)) if count > 1 else nan
    if not p_value < CONTRADICTED_P:
        unknown = _unknown(level, target, both, count)
        return SeparatedTilt(value, of_value, Uncertain(1.0, 0.0), p_value, unknown)
    free = np.concatenate([level, target[:, None]], axis=1)
    share = 1.0
    for _ in range(SHARE_ROUNDS):
        total = own + share**2 * tilts.focus_covariance
        numbers, errors, _ = _solve(free, slopes, total)
        share = float(numbers[2])
    estimated = Uncertain(share, sqrt(errors[2, 2]))
    return SeparatedTilt(numbers[:2], errors[:2, :2], estimated, p_value, ())


def _solve(
    rows: Floats, values: Floats, covariance: Floats
) -> tuple[Floats, Floats, float]:
    """Return the least squares' numbers, their covariance, and the sum of squares left."""
    weights = np.asarray(np.linalg.inv(covariance), float)
    errors = np.asarray(np.linalg.inv(rows.T @ weights @ rows), float)
    numbers = errors @ rows.T @ weights @ values
    left = values - rows @ numbers
    return numbers, errors, float(left @ weights @ left)


def _unknown(
    level: Floats, target: Floats, covariance: Floats, count: int
) -> tuple[str, ...]:
    """Return what the ranges leave open about tilts."""
    alone = "the sensor's tilt rests on the target's perspective alone"
    if count < 2:
        return (f"{alone}: a second range with another tilt of the target would test it",)
    free = np.concatenate([level, target[:, None]], axis=1)
    weights = np.linalg.inv(covariance)
    normal = free.T @ weights @ free
    inside = normal[2, 2] - normal[2, :2] @ np.linalg.solve(normal[:2, :2], normal[:2, 2])
    if inside * TELLING_SHARE_STD**2 > 1:
        return ()
    return (f"{alone}: the target was tilted alike at all ranges",)
