"""Black disks in rows and columns on white: the usual chart for distortion and for lateral colour."""

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

NODES_ACROSS_DISK = 12
"""Gauss-Legendre nodes to a panel of the integral over a disk's height."""


@dataclass(frozen=True, slots=True)
class Disks:
    """Black disks on a white sheet, each in the middle of a square.

    grid: (rows, columns) of squares; spacing_mm: side of a square, middle to middle;
    diameter_mm: of a disk, less than the spacing. surround: radiance around the squares,
    None = unknown. Raises TargetError for any other value.
    """

    grid: tuple[int, int]
    spacing_mm: float
    diameter_mm: float
    surround: float | None = None

    def __post_init__(self) -> None:
        if min(self.grid) < 1 or not 0 < self.diameter_mm < self.spacing_mm < math.inf:
            raise TargetError(
                f"[target] disks: {self.grid[0]} × {self.grid[1]} of {self.diameter_mm:g} mm, {self.spacing_mm:g} mm apart: "
                "allowed are 1 and more, of a diameter_mm below their distance, size_mm over the number of rows"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of all squares."""
        return self.grid[0] * self.spacing_mm, self.grid[1] * self.spacing_mm

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the radiance (m, n) on the grid y_mm (m,) × x_mm (n,) after the filter of `CellTarget.sample`.

        Along x each chord of a disk is the difference of the filter's step responses at its
        ends, exactly. Along y the chords r cos t at r sin t are integrated over t by
        Gauss's rule, to about 1e-6. All rows have the same chords. Raises ValueError unless
        bandwidth_per_mm > 0.
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y, x = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        reach, step = low_pass()

        def passed(mm: Floats) -> Floats:
            return np.asarray(step(np.clip(mm * bandwidth_per_mm, -reach, reach)))

        radius = self.diameter_mm / 2
        angle, weight = _gauss(math.ceil(math.pi * radius * bandwidth_per_mm) + 1)
        half_chord = radius * np.cos(angle)
        down = radius * np.sin(angle)
        (rows, cols), kernel = self._middles(), step.derivative()
        chords = np.zeros((angle.size, x.size))
        for middle in cols:
            chords += passed(x - middle + half_chord[:, None]) - passed(
                x - middle - half_chord[:, None]
            )
        heights = np.zeros((y.size, angle.size))
        for middle in rows:
            distance = (y[:, None] - middle - down) * bandwidth_per_mm
            heights += np.where(
                np.abs(distance) < reach, kernel(np.clip(distance, -reach, reach)), 0.0
            )
        black: Floats = (heights * (weight * half_chord * bandwidth_per_mm)) @ chords
        height, width = self.size_mm
        sheet = np.outer(
            passed(y + height / 2) - passed(y - height / 2),
            passed(x + width / 2) - passed(x - width / 2),
        )
        around = self.surround or 0.0
        return np.asarray(around + (1 - around) * sheet - black)

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return exact point values at broadcast (y_mm, x_mm); the surround (0 if unknown) outside."""
        y, x = np.broadcast_arrays(
            real_array("y_mm", y_mm, None, "mm"), real_array("x_mm", x_mm, None, "mm")
        )
        height, width = (side / 2 for side in self.size_mm)
        inside = (np.abs(y) <= height) & (np.abs(x) <= width)
        down, right = (y + height) % self.spacing_mm, (x + width) % self.spacing_mm
        white = (
            np.hypot(down - self.spacing_mm / 2, right - self.spacing_mm / 2)
            > self.diameter_mm / 2
        )
        return np.where(inside, white.astype(np.float64), self.surround or 0.0)

    def _middles(self) -> tuple[Floats, Floats]:
        """Return y of each row of disks and x of each column, in mm."""
        rows, cols = (
            np.asarray((np.arange(n) - (n - 1) / 2) * self.spacing_mm, dtype=np.float64)
            for n in self.grid
        )
        return rows, cols


def open_target(spec: TargetSpec) -> Disks:
    """Return ``spec.grid`` disks of ``spec.diameter_mm``, in rows ``spec.size_mm`` high together.

    Raises TargetError.
    """
    if spec.grid is None or spec.diameter_mm is None:
        raise TargetError(
            '[target] kind = "disks" needs grid = [rows, columns] and diameter_mm'
        )
    return Disks(
        spec.grid, spec.size_mm / spec.grid[0], spec.diameter_mm, SURROUNDS[spec.surround]
    )


def _gauss(panels: int) -> tuple[Floats, Floats]:
    """Return nodes and weights from -pi/2 to pi/2."""
    node, weight = np.polynomial.legendre.leggauss(NODES_ACROSS_DISK)
    width = math.pi / panels
    middles = -math.pi / 2 + (np.arange(panels) + 0.5) * width
    return (middles[:, None] + node * width / 2).ravel(), np.tile(
        weight * width / 2, panels
    )
