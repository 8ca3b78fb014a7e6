"""A grid of equal targets that fills a frame: the plane between the targets is their surround."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.plan import TargetSpec
from labkit.target import Target, low_pass, open_target, read_spec
from labkit.types import Floats

Place = tuple[int, int]
"""(row, column) of a target in a grid, from 0."""


@dataclass(frozen=True, slots=True)
class TargetGrid:
    """Equal targets in rows and columns.

    Parameters
    ----------
    tile : each target; its surround lies between the targets too
    grid : (rows, columns) of targets
    pitch_mm : distance of neighbours' centres along rows and columns

    Raises
    ------
    TargetError
        no targets, or targets that overlap
    """

    tile: Target
    grid: tuple[int, int]
    pitch_mm: float

    def __post_init__(self) -> None:
        if min(self.grid) < 1:
            raise TargetError(f"[target] grid = {list(self.grid)}: allowed is 1 and more")
        height, width = self.tile.size_mm
        if not max(height, width) < self.pitch_mm < np.inf:
            raise TargetError(
                f"[target] pitch_mm = {self.pitch_mm:g}: allowed is more than a target's {height:g} × {width:g} mm"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(height, width) of all targets, from the first one's edge to the last one's."""
        (rows, cols), (height, width) = self.grid, self.tile.size_mm
        return (rows - 1) * self.pitch_mm + height, (cols - 1) * self.pitch_mm + width

    @property
    def surround(self) -> float | None:
        """Radiance between and around the targets; None if unknown."""
        return self.tile.surround

    def centre_mm(self, place: Place) -> tuple[float, float]:
        """Return (y, x) of a target's centre, from the centre of the grid."""
        y, x = (
            (index - (count - 1) / 2) * self.pitch_mm
            for index, count in zip(place, self.grid, strict=True)
        )
        return y, x

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the radiance (m, n) on the grid y_mm (m,) × x_mm (n,) after the filter of `CellTarget.sample`.

        Each target is added where the filter lets it reach. Raises ValueError unless
        bandwidth_per_mm > 0.
        """
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        y, x = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        around = self.surround or 0.0
        reach_mm = low_pass()[0] / bandwidth_per_mm
        made = np.full((y.size, x.size), around)
        for place in np.ndindex(*self.grid):
            down, right = (
                at - centre
                for at, centre in zip((y, x), self.centre_mm(place), strict=True)
            )
            near = np.ix_(
                *(
                    np.flatnonzero(np.abs(away) < side / 2 + reach_mm)
                    for away, side in zip((down, right), self.tile.size_mm, strict=True)
                )
            )
            rows, cols = near[0].ravel(), near[1].ravel()
            made[near] += (
                self.tile.sample(down[rows], right[cols], bandwidth_per_mm) - around
            )
        return made

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return exact point values at broadcast (y_mm, x_mm); between the targets the surround, 0 if unknown."""
        y, x = (
            _from_the_nearest(real_array(name, at, None, "mm"), count, self.pitch_mm)
            for name, at, count in zip(
                ("y_mm", "x_mm"), (y_mm, x_mm), self.grid, strict=True
            )
        )
        return self.tile.radiance(y, x)


def open_grid(spec: TargetSpec) -> TargetGrid | None:
    """Return the grid of targets of a plan's [target] table; None for a single target.

    Raises TargetError for targets that overlap or are unknown.
    """
    if not spec.of_many or spec.grid is None or spec.pitch_mm is None:
        return None
    return TargetGrid(open_target(spec), spec.grid, spec.pitch_mm)


def shown_target(spec: TargetSpec | str) -> Target:
    """Open all that a display or a print shows: the grid of targets, or the single target.

    Parameters
    ----------
    spec : table of a plan, or a text as `labkit.open_target` takes

    Raises
    ------
    PlanError
        for a bad plan
    TargetError
        for an unknown kind
    """
    spec = read_spec(spec) if isinstance(spec, str) else spec
    return open_grid(spec) or open_target(spec)


def _from_the_nearest(at_mm: Floats, count: int, pitch_mm: float) -> Floats:
    """Return the distance from the centre of the nearest target along an axis."""
    index = np.clip(np.rint(at_mm / pitch_mm + (count - 1) / 2), 0, count - 1)
    return np.asarray(at_mm - (index - (count - 1) / 2) * pitch_mm)
