"""Charge that wanders between the pixels before it is read: a round Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.types import AnyFloats


@dataclass(frozen=True, slots=True)
class Diffusion:
    """exp(-2 pi^2 sigma^2 w^2). variance: sigma^2, pixels squared."""

    variance: float = 0.0

    labels: ClassVar[tuple[str, ...]] = ("variance_px2",)
    usual: ClassVar[tuple[float, ...]] = (0.2,)

    @property
    def name(self) -> str:
        return "diffusion"

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        (variance,) = values
        return replace(self, variance=float(variance))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return np.asarray(np.exp(-2 * np.pi**2 * self.variance * (rows**2 + columns**2)))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        return (np.asarray(-2 * np.pi**2 * (rows**2 + columns**2) * self.transfer(rows, columns)),)
