"""A camera or a rail that shakes during the exposure: a Gaussian in one direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.types import AnyFloats


@dataclass(frozen=True, slots=True)
class Smear:
    """A Gaussian of any direction, by its second moments, pixels squared: rows, columns, and across, of rows and columns.

    A line of length l has the variance l^2 / 12, and its Gaussian's transfer function to the fourth power of l w.
    """

    rows: float = 0.0
    columns: float = 0.0
    across: float = 0.0

    labels: ClassVar[tuple[str, ...]] = ("rows_px2", "columns_px2", "across_px2")
    usual: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2)

    @property
    def name(self) -> str:
        return "smear"

    @property
    def values(self) -> tuple[float, ...]:
        return self.rows, self.columns, self.across

    def at(self, values: Sequence[float]) -> Self:
        rows, columns, across = values
        return replace(self, rows=float(rows), columns=float(columns), across=float(across))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        moment = self.rows * rows**2 + self.columns * columns**2 + 2 * self.across * rows * columns
        return np.asarray(np.exp(-2 * np.pi**2 * moment))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        transfer = -2 * np.pi**2 * self.transfer(rows, columns)
        return rows**2 * transfer, columns**2 * transfer, 2 * rows * columns * transfer
