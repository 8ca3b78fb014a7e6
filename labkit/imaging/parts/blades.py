"""A diaphragm of blades: the pupil is a polygon with more or less round sides."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from labkit.imaging.estimated import polar
from labkit.imaging.parts.part import Part, finite
from labkit.optics.rim import Diaphragm, Rim
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

USUAL = range(5, 12)
"""Numbers of blades that diaphragms have."""


@dataclass(frozen=True, slots=True)
class Blades(Part):
    """A diaphragm of a number of blades, by how straight they are, from 0 for round to 1, and the direction of one's middle.

    cosine, sine: the straightness times cosine and sine of `number` times the direction. Close to 0 the rim's departure from
    a circle is hardly more than its harmonic of this order, which the two numbers span.
    """

    number: int
    cosine: float = 0.0
    sine: float = 0.0

    labels: ClassVar[tuple[str, ...]] = ("cosine", "sine")
    usual: ClassVar[tuple[float, ...]] = (1.0, 1.0)
    meanings: ClassVar[Mapping[str, str]] = {
        "roundness": "curvature of a blade, 1 where the pupil is round",
        "turn_deg": "direction of a blade's middle, from right towards down",
    }
    of_rim: ClassVar[bool] = True
    one_sided: ClassVar[bool] = False
    kind: ClassVar[str] = "blades"

    @property
    def name(self) -> str:
        return f"blades_{self.number}"

    @property
    def title(self) -> str:
        return f"diaphragm of {self.number} blades"

    @property
    def words(self) -> str:
        return f"a {self.title}"

    @property
    def sought(self) -> bool:  # type: ignore[override]
        return self.number in USUAL

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return (-1.0, -1.0) if self.number % 2 else (1.0, 1.0)

    @property
    def values(self) -> tuple[float, ...]:
        return self.cosine, self.sine

    def at(self, values: Sequence[float]) -> Self:
        cosine, sine = map(float, values)
        straight = max(math.hypot(cosine, sine), 1.0)
        return replace(self, cosine=cosine / straight, sine=sine / straight)

    def onto(self, rim: Rim) -> Rim:
        if self.idle:
            return rim
        turn = math.atan2(self.sine, self.cosine) / self.number
        blades = Diaphragm(self.number, turn, 1 - math.hypot(self.cosine, self.sine))
        return replace(rim, cuts=(*rim.cuts, blades))

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        return (replace(self), True) if plan.lens.blades == self.number else None

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        cosine, sine = numbers
        straight, turn_deg = polar(cosine, sine, self.number)
        return {
            f"{self.name}.roundness": Uncertain(1 - straight.value, straight.std),
            f"{self.name}.turn_deg": turn_deg,
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        values = finite(found, f"{self.name}.roundness", f"{self.name}.turn_deg")
        if values is None:
            return None
        straight = 1 - values[0]
        turn = self.number * math.radians(values[1])
        return self.at([straight * math.cos(turn), straight * math.sin(turn)])
