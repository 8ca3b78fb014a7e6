"""An oval or three-sided pupil, such as an oblique or a vignetted one, to first order of its departure from a
circle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from labkit.imaging.parts.part import Part, finite
from labkit.optics.rim import Rim
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

MOST_UNEVENNESS = 0.8
"""Largest departure of the rim; at 1 it would no longer be a closed curve."""


@dataclass(frozen=True, slots=True)
class UnevenRim(Part):
    """The second and third harmonics of the rim's radius, relative, as of `labkit.optics.rim.Rim`."""

    cosine_2: float = 0.0
    sine_2: float = 0.0
    cosine_3: float = 0.0
    sine_3: float = 0.0

    name: ClassVar[str] = "uneven_rim"
    title: ClassVar[str] = "uneven rim of the pupil"
    words: ClassVar[str] = "a pupil that is not round"
    labels: ClassVar[tuple[str, ...]] = ("cosine_2", "sine_2", "cosine_3", "sine_3")
    usual: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2, 0.2)
    meanings: ClassVar[Mapping[str, str]] = {
        "cosine_2": "cos 2t of its radius, relative",
        "sine_2": "sin 2t",
        "cosine_3": "cos 3t",
        "sine_3": "sin 3t",
    }
    of_rim: ClassVar[bool] = True
    kind: ClassVar[str] = "uneven rim"
    one_sided: ClassVar[bool] = False

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return 1.0, 1.0, -1.0, -1.0

    @property
    def values(self) -> tuple[float, ...]:
        return self.cosine_2, self.sine_2, self.cosine_3, self.sine_3

    def at(self, values: Sequence[float]) -> Self:
        cosine_2, sine_2, cosine_3, sine_3 = map(float, values)
        depth = math.hypot(cosine_2, sine_2) + math.hypot(cosine_3, sine_3)
        within = min(1.0, MOST_UNEVENNESS / depth) if depth else 1.0
        return type(self)(*(within * float(value) for value in values))

    def onto(self, rim: Rim) -> Rim:
        return replace(rim, uneven=self.values)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        return None

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        return {
            f"{self.name}.{label}": number
            for label, number in zip(self.labels, numbers, strict=True)
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        values = finite(found, *(f"{self.name}.{label}" for label in self.labels))
        return None if values is None else self.at(values)
