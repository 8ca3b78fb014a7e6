"""Diffusion of charge between the pixels before readout: a round Gaussian."""

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
class Diffusion(Part):
    """exp(-2 pi^2 sigma^2 w^2). variance: sigma^2, pixels squared."""

    variance: float = 0.0

    name: ClassVar[str] = "diffusion"
    title: ClassVar[str] = "charge diffusion"
    words: ClassVar[str] = "charge that diffuses between pixels"
    labels: ClassVar[tuple[str, ...]] = ("variance_px2",)
    usual: ClassVar[tuple[float, ...]] = (0.2,)
    meanings: ClassVar[Mapping[str, str]] = {"sigma_px": "standard deviation"}

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        (variance,) = values
        return type(self)(float(variance))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return np.asarray(np.exp(-2 * np.pi**2 * self.variance * (rows**2 + columns**2)))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        return (
            np.asarray(
                -2 * np.pi**2 * (rows**2 + columns**2) * self.transfer(rows, columns)
            ),
        )

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        sigma_px = plan.sensor.diffusion_px
        if sigma_px is None:
            return None
        if isinstance(sigma_px, str):
            return type(self)(), True
        return type(self)(sigma_px**2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        (variance,) = numbers
        return {"diffusion.sigma_px": root(variance, "px")}

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        sigma_px = finite(found, "diffusion.sigma_px")
        return None if sigma_px is None else self.at([sigma**2 for sigma in sigma_px])
