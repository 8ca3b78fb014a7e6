"""Shake of the camera or the rail during the exposure: a Gaussian in one direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import root
from labkit.imaging.parts.part import Part, finite
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class Smear(Part):
    """A Gaussian of any direction, by its second moments, pixels squared: rows, columns, and across, of rows and columns.

    A line of length l has the variance l^2 / 12, and its Gaussian's transfer function to the fourth power of l w.
    """

    rows: float = 0.0
    columns: float = 0.0
    across: float = 0.0

    name: ClassVar[str] = "smear"
    title: ClassVar[str] = "smear"
    words: ClassVar[str] = "smear, by a shake or a rolling shutter"
    labels: ClassVar[tuple[str, ...]] = ("rows_px2", "columns_px2", "across_px2")
    usual: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2)
    meanings: ClassVar[Mapping[str, str]] = {
        "rows_px": "along rows",
        "columns_px": "along columns",
        "slant_px2": "covariance of both",
    }

    @property
    def values(self) -> tuple[float, ...]:
        return self.rows, self.columns, self.across

    def at(self, values: Sequence[float]) -> Self:
        rows, columns, across = values
        return type(self)(float(rows), float(columns), float(across))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        moment = (
            self.rows * rows**2
            + self.columns * columns**2
            + 2 * self.across * rows * columns
        )
        return np.asarray(np.exp(-2 * np.pi**2 * moment))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        transfer = -2 * np.pi**2 * self.transfer(rows, columns)
        return rows**2 * transfer, columns**2 * transfer, 2 * rows * columns * transfer

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        sigma_px = plan.sensor.smear_px
        if sigma_px is None:
            return None
        if isinstance(sigma_px, str):
            return type(self)(), True
        rows, columns = sigma_px if isinstance(sigma_px, tuple) else (sigma_px, sigma_px)
        return type(self)(rows**2, columns**2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        rows, columns, across = numbers
        return {
            "smear.rows_px": root(rows, "px"),
            "smear.columns_px": root(columns, "px"),
            "smear.slant_px2": Uncertain(across.value, across.std, "px²"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sides = finite(found, "smear.rows_px", "smear.columns_px")
        if sides is None:
            return None
        slant = finite(found, "smear.slant_px2") or [0.0]  # earlier results lack it
        return self.at([*(side**2 for side in sides), *slant])
