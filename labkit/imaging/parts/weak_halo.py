"""A halo weaker than that of diffraction at a clean round edge: what lies far out of it is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from labkit.imaging.parts.veil import Veil
from labkit.types import Floats

SCALE_PX = 30.0
"""Standard deviation, pixels, of the Gaussian that is missing: broad, as the light farthest out is."""


@dataclass(frozen=True, slots=True)
class WeakHalo:
    """The opposite of a veil: a share of the light that the halo lacks."""

    share: float = 0.0

    name: ClassVar[str] = "weak_halo"
    labels: ClassVar[tuple[str, ...]] = ("share",)
    usual: ClassVar[tuple[float, ...]] = (0.01,)

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share,)

    def at(self, values: Sequence[float]) -> Self:
        (share,) = values
        return replace(self, share=float(share))

    def transfer(self, rows: Floats, columns: Floats) -> Floats:
        return Veil(-self.share, SCALE_PX).transfer(rows, columns)

    def slopes(self, rows: Floats, columns: Floats) -> tuple[Floats, ...]:
        return (-Veil(scale_px=SCALE_PX).slopes(rows, columns)[0],)
