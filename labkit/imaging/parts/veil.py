"""Stray light: a share of all light that a lens's surfaces and barrel spread broadly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.types import AnyFloats

SCALE_PX = 12.0
"""Standard deviation of the veil. Ambient light takes what is much broader than a picture, the lens what is narrower."""


@dataclass(frozen=True, slots=True)
class Veil:
    """A Gaussian of scale_px, its standard deviation in pixels, that holds a share of the light."""

    share: float = 0.0
    scale_px: float = SCALE_PX

    labels: ClassVar[tuple[str, ...]] = ("share",)
    usual: ClassVar[tuple[float, ...]] = (0.2,)

    @property
    def name(self) -> str:
        return "veil"

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share,)

    def at(self, values: Sequence[float]) -> Self:
        (share,) = values
        return replace(self, share=float(share))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return 1 + self.share * self.slopes(rows, columns)[0]

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        return (np.asarray(np.exp(-2 * np.pi**2 * self.scale_px**2 * (rows**2 + columns**2)) - 1),)
