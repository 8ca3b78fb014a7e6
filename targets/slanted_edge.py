"""A square, black on the left and white on the right of a slanted edge, as in ISO 12233."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.target.target import SURROUNDS, low_pass
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec

MAX_ANGLE_DEG = 45.0
NODES_ALONG_EDGE = 12
"""Gauss-Legendre nodes to a panel of the integral over y."""


@dataclass(frozen=True, slots=True)
class SlantedEdge:
    """A straight edge through the centre of a square: white where x > y tan(angle), y down and x right.

    side_mm: of the square; angle_deg: by which the edge's lower end leans to the right, -45 to 45;
    surround: radiance around, None = unknown. Raises TargetError for other angles or sides.
    """

    side_mm: float
    angle_deg: float
    surround: float | None = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.side_mm) and self.side_mm > 0):
            raise TargetError(
                f"a target's side is longer than 0 mm, not {self.side_mm:g} mm"
            )
        if not abs(self.angle_deg) <= MAX_ANGLE_DEG:
            raise TargetError(
                f"[target] angle_deg = {self.angle_deg:g}: an edge leans by -45 to 45 degrees"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of the square."""
        return self.side_mm, self.side_mm

    @property
    def slope(self) -> float:
        """Millimetres to the right along the edge for each millimetre down."""
        return math.tan(math.radians(self.angle_deg))

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the radiance (m, n) on the grid y_mm (m,) × x_mm (n,) after the filter of `CellTarget.sample`.

        Along x each line is the filter's step response at the edge less the response at the
        square's side, exactly. Along y the filter is integrated over the square's height by
        Gauss's rule, to about 1e-6: the kernel ends with a small step. Raises ValueError
        unless bandwidth_per_mm > 0.
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y, x = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        half = self.side_mm / 2
        around = self.surround or 0.0
        reach, step = low_pass()

        def passed(mm: Floats) -> Floats:
            return np.asarray(step(np.clip(mm * bandwidth_per_mm, -reach, reach)))

        at, weight = _gauss(half, bandwidth_per_mm)
        square = passed(x + half) - passed(x - half)
        white = passed(x - self.slope * at[:, None]) - passed(x - half)
        distance = (y[:, None] - at) * bandwidth_per_mm
        kernel = np.where(
            np.abs(distance) < reach,
            step.derivative()(np.clip(distance, -reach, reach)),
            0.0,
        )
        height = passed(y + half) - passed(y - half)
        blurred: Floats = (kernel * (weight * bandwidth_per_mm)) @ white
        if around:
            blurred += around * (1 - np.outer(height, square))
        return blurred

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return exact point values at broadcast (y_mm, x_mm); the surround (0 if unknown) outside."""
        y, x = np.broadcast_arrays(
            real_array("y_mm", y_mm, None, "mm"), real_array("x_mm", x_mm, None, "mm")
        )
        inside = (np.abs(y) <= self.side_mm / 2) & (np.abs(x) <= self.side_mm / 2)
        return np.where(
            inside, (x > self.slope * y).astype(np.float64), self.surround or 0.0
        )


def open_target(spec: TargetSpec) -> SlantedEdge:
    """Return an edge slanted by ``spec.angle_deg`` in a square of ``spec.size_mm``.

    Raises TargetError for other angles.
    """
    return SlantedEdge(spec.size_mm, spec.angle_deg, SURROUNDS[spec.surround])


def _gauss(half_mm: float, bandwidth_per_mm: float) -> tuple[Floats, Floats]:
    """Return nodes and weights in mm from -half_mm to half_mm, in panels of at most 1 / bandwidth."""
    panels = max(1, math.ceil(2 * half_mm * bandwidth_per_mm))
    node, weight = np.polynomial.legendre.leggauss(NODES_ALONG_EDGE)
    width = 2 * half_mm / panels
    middles = -half_mm + (np.arange(panels) + 0.5) * width
    return (middles[:, None] + node * width / 2).ravel(), np.tile(
        weight * width / 2, panels
    )
