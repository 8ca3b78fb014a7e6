"""A vector on the sensor, such as a slope or a decentre, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, exp, sqrt
from typing import Any

import numpy as np

from labkit.types import Floats
from labkit.uncertain import Uncertain

UNKNOWN_ANGLE_DEG = 360 / sqrt(12)
"""Standard deviation of an angle that may have any value."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A vector along the sensor's rows and columns; (nan, nan) if it was not estimated.

    Parameters
    ----------
    value : (2,), down the rows, then right along the columns
    covariance : (2, 2)
    unit : of both
    """

    value: Floats
    covariance: Floats
    unit: str = ""

    @property
    def down(self) -> Uncertain:
        """Part down the rows."""
        return self._part(0)

    @property
    def right(self) -> Uncertain:
        """Part right along the columns."""
        return self._part(1)

    @property
    def magnitude(self) -> Uncertain:
        """Length of the vector, with its standard error along the vector."""
        length = float(np.hypot(*self.value))
        if not np.isfinite(length):
            return Uncertain(np.nan, np.inf, self.unit)
        if length == 0:
            largest = float(np.linalg.eigvalsh(self.covariance)[-1])
            return Uncertain(0.0, sqrt(max(largest, 0.0)), self.unit)
        along = self.value / length
        variance = max(float(along @ self.covariance @ along), 0.0)
        return Uncertain(length, sqrt(variance), self.unit)

    @property
    def direction_deg(self) -> Uncertain:
        """Direction, degrees from right towards down."""
        down, right = self.value
        across = np.array([right, -down])
        square = float(across @ across)
        if not square > 0:
            return Uncertain(np.nan, UNKNOWN_ANGLE_DEG, "deg")
        variance = max(float(across @ self.covariance @ across), 0.0)
        std = degrees(sqrt(variance)) / square
        angle = degrees(np.arctan2(down, right))
        return Uncertain(angle, min(std, UNKNOWN_ANGLE_DEG), "deg")

    @property
    def p_value(self) -> float:
        """Probability of a vector as far from zero, in its errors, if the true one is zero; nan without errors."""
        if not np.all(np.isfinite(self.value)) or np.linalg.det(self.covariance) <= 0:
            return float("nan")
        return exp(-0.5 * float(self.value @ np.linalg.solve(self.covariance, self.value)))

    def along(self, direction: Floats) -> Uncertain:
        """Return the component times a vector (2,), down and right, such as an extent in mm."""
        variance = float(direction @ self.covariance @ direction)
        return Uncertain(float(direction @ self.value), sqrt(max(variance, 0.0)))

    def times(self, factor: float, unit: str, relative_std: float = 0.0) -> Pair:
        """Return the vector in another unit.

        relative_std: relative standard error of the factor
        """
        value = factor * self.value
        covariance = factor**2 * self.covariance + relative_std**2 * np.outer(value, value)
        return Pair(value, covariance, unit)

    def as_json(self) -> dict[str, Any]:
        """Return value [down, right] and covariance, null for numbers that are not finite."""
        return {
            "value": [_plain(x) for x in self.value],
            "covariance": [[_plain(x) for x in row] for row in self.covariance],
            "unit": self.unit,
        }

    def _part(self, axis: int) -> Uncertain:
        variance = max(float(self.covariance[axis, axis]), 0.0)
        return Uncertain(float(self.value[axis]), sqrt(variance), self.unit)


def _plain(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None
