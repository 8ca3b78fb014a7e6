"""Stray light: a share of all light that a lens's surfaces and barrel spread broadly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.types import AnyFloats

SCALE_PX = 15.0
"""Of the veil where nothing is known of it."""

NARROWEST_PX, BROADEST_PX = 3.0, 100.0
"""Between these it is sought: the lens takes what is narrower, ambient light what is much broader than a picture."""

REACH_PX = 48.0
"""How far beyond the frame a model keeps its light: of a usual veil 83 % stays within; what is farther is nearly even."""


@dataclass(frozen=True, slots=True)
class Veil:
    """exp(-r / scale_px), r the distance in pixels, that holds a share of the light: scattered light falls off by long tails.

    The scale moves nothing where the share is 0; there it stays the usual one.
    """

    share: float = 0.0
    scale_px: float = SCALE_PX

    labels: ClassVar[tuple[str, ...]] = ("share", "log_scale")
    usual: ClassVar[tuple[float, ...]] = (0.2, 1.0)

    @property
    def name(self) -> str:
        return "veil"

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share, math.log(self.scale_px / SCALE_PX))

    def at(self, values: Sequence[float]) -> Self:
        share, log_scale = map(float, values)
        within = min(max(log_scale, math.log(NARROWEST_PX / SCALE_PX)), math.log(BROADEST_PX / SCALE_PX))
        return replace(self, share=share, scale_px=SCALE_PX * math.exp(within))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return 1 + self.share * self.slopes(rows, columns)[0]

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        square = (2 * np.pi * self.scale_px) ** 2 * (rows**2 + columns**2)
        return (
            np.asarray((1 + square) ** -1.5 - 1),
            np.asarray(-3 * self.share * square * (1 + square) ** -2.5),
        )
