"""Veiling glare: a share of all light that a lens's surfaces and barrel scatter widely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.parts.part import Part, finite
from labkit.plan import Channel, Plan
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain

SCALE_PX = 15.0
"""Of the veil where nothing is known of it."""

NARROWEST_PX, BROADEST_PX = 3.0, 100.0
"""Between these it is sought: the lens takes what is narrower, ambient light what is much broader than a picture."""


@dataclass(frozen=True, slots=True)
class Veil(Part):
    """Veiling glare exp(-r / scale_px), r the distance in pixels, with a share of the light.

    Scattered light has long tails. A share of 0 leaves the scale undetermined; then the
    usual scale holds. Of a usual glare 83 % stays within its reach; the light beyond is
    nearly even.
    """

    share: float = 0.0
    scale_px: float = SCALE_PX

    name: ClassVar[str] = "veil"
    title: ClassVar[str] = "veil of stray light"
    words: ClassVar[str] = "a veil of stray light"
    labels: ClassVar[tuple[str, ...]] = ("share", "log_scale")
    usual: ClassVar[tuple[float, ...]] = (0.2, 1.0)
    meanings: ClassVar[Mapping[str, str]] = {
        "share": "of all light",
        "scale_px": "distance over which it falls to 1/e",
    }
    reach_px: ClassVar[float] = 48.0

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share, math.log(self.scale_px / SCALE_PX))

    def at(self, values: Sequence[float]) -> Self:
        share, log_scale = map(float, values)
        least = math.log(NARROWEST_PX / SCALE_PX)
        most = math.log(BROADEST_PX / SCALE_PX)
        return type(self)(share, SCALE_PX * math.exp(min(max(log_scale, least), most)))

    @property
    def idle(self) -> bool:
        return not self.share

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return 1 + self.share * self.slopes(rows, columns)[0]

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        square = (2 * np.pi * self.scale_px) ** 2 * (rows**2 + columns**2)
        return (
            np.asarray((1 + square) ** -1.5 - 1),
            np.asarray(-3 * self.share * square * (1 + square) ** -2.5),
        )

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        share = plan.lens.veil
        scale_px = plan.lens.veil_scale_px
        if share is None:
            return None
        if isinstance(share, str):
            return type(self)(scale_px=scale_px), True
        return type(self)(share, scale_px), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        share, log_scale = numbers
        scale_px = SCALE_PX * float(np.exp(log_scale.value))
        return {
            "veil.share": share,
            "veil.scale_px": Uncertain(scale_px, scale_px * log_scale.std, "px"),
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        share = finite(found, "veil.share")
        if share is None:
            return None
        return type(self)(*share, *(finite(found, "veil.scale_px") or [SCALE_PX]))
