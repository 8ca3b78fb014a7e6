"""The optical low-pass filter: two birefringent plates that make four equal spots of each point (physics of cameras, §16)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import mean, root
from labkit.imaging.parts.part import Part, finite
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class LowPass(Part):
    """Four spots at (+-s/2, +-t/2). rows, columns: s^2 and t^2, pixels squared.

    turned: by 45 degrees, so that s runs down to the right and t down to the left. cos(pi s
    w) is analytic in s^2, so an estimate passes s = 0 smoothly; below s^2 = 0 the cosine is
    a cosh.
    """

    rows: float = 0.0
    columns: float = 0.0
    turned: bool = False

    labels: ClassVar[tuple[str, ...]] = ("rows_px2", "columns_px2")
    usual: ClassVar[tuple[float, ...]] = (0.5, 0.5)
    meanings: ClassVar[Mapping[str, str]] = {
        "spread_px": "distance of its spots",
        "rows_px": "along rows",
        "columns_px": "along columns",
    }

    @property
    def name(self) -> str:
        return "low_pass_filter_turned" if self.turned else "low_pass_filter"

    @property
    def title(self) -> str:
        return "low-pass filter, turned by 45°" if self.turned else "low-pass filter"

    @property
    def words(self) -> str:
        return (
            "an optical low-pass filter turned by 45 degrees"
            if self.turned
            else "an optical low-pass filter"
        )

    @property
    def values(self) -> tuple[float, ...]:
        return self.rows, self.columns

    def at(self, values: Sequence[float]) -> Self:
        rows, columns = values
        return replace(self, rows=float(rows), columns=float(columns))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        along, across = self._axes(rows, columns)
        return np.asarray(_split(self.rows, along) * _split(self.columns, across))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        along, across = self._axes(rows, columns)
        return (
            np.asarray(_split_slope(self.rows, along) * _split(self.columns, across)),
            np.asarray(_split(self.rows, along) * _split_slope(self.columns, across)),
        )

    def _axes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, AnyFloats]:
        """Return the frequencies along the two plates."""
        if not self.turned:
            return rows, columns
        return (rows + columns) / math.sqrt(2), (rows - columns) / math.sqrt(2)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        table = plan.sensor.low_pass_filter
        if table is None or table.turned != self.turned:
            return None
        return self.at(table.squares), table.spread_px == "fit"

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        rows, columns = numbers
        return {
            f"{self.name}.spread_px": root(mean(numbers), "px"),
            f"{self.name}.rows_px": root(rows, "px"),
            f"{self.name}.columns_px": root(columns, "px"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sides = finite(found, f"{self.name}.rows_px", f"{self.name}.columns_px")
        return None if sides is None else self.at([side**2 for side in sides])

    def finding(self, found: Mapping[str, Uncertain]) -> str:
        return Part.finding(
            self, {key: found[key] for key in found if not key.endswith(".spread_px")}
        )


def _split(square: float, frequency: AnyFloats) -> AnyFloats:
    """Return cos(pi s w) as a function of s^2."""
    angle = np.pi * math.sqrt(abs(square)) * frequency
    return np.asarray(np.cos(angle) if square >= 0 else np.cosh(angle))


def _split_slope(square: float, frequency: AnyFloats) -> AnyFloats:
    """Return the derivative of `_split` by s^2: -(pi w)^2 / 2 times the sine over its angle."""
    angle = np.pi * math.sqrt(abs(square)) * frequency
    tiny = np.abs(angle) < 1e-4
    safe = np.where(tiny, 1.0, angle)
    ratio = np.where(tiny, 1.0, (np.sin(safe) if square >= 0 else np.sinh(safe)) / safe)
    return np.asarray(-0.5 * (np.pi * frequency) ** 2 * ratio)
