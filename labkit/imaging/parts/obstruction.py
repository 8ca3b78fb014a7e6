"""An obstruction: a disc in the middle of the pupil without light, such as a mirror lens's second mirror."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from labkit.imaging.estimated import root
from labkit.imaging.parts.part import Part, finite
from labkit.optics.rim import Rim
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain

MOST_OBSTRUCTION = 0.9
"""Largest obstruction, of the pupil's diameter."""

USUAL_SHARE = 0.1
"""Of the pupil's area, where a fit begins: at 0 the likelihood is far from quadratic."""


@dataclass(frozen=True, slots=True)
class Obstruction(Part):
    """An obstructed disc. share: of the pupil's area; the field of light changes linearly with it."""

    share: float = 0.0

    name: ClassVar[str] = "obstruction"
    title: ClassVar[str] = "obstruction"
    words: ClassVar[str] = "an obstructed centre of the pupil"
    labels: ClassVar[tuple[str, ...]] = ("share",)
    usual: ClassVar[tuple[float, ...]] = (0.3,)
    meanings: ClassVar[Mapping[str, str]] = {"diameter": "over the pupil's diameter"}
    of_rim: ClassVar[bool] = True
    far: ClassVar[bool] = True

    @property
    def values(self) -> tuple[float, ...]:
        return (self.share,)

    def at(self, values: Sequence[float]) -> Self:
        (share,) = values
        return type(self)(
            min(max(float(share), -(MOST_OBSTRUCTION**2)), MOST_OBSTRUCTION**2)
        )

    def begun(self, before: Sequence[Part]) -> Self:
        return type(self)(USUAL_SHARE)

    def onto(self, rim: Rim) -> Rim:
        return replace(rim, obstructed=self.share)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        diameter = plan.lens.obstruction
        if diameter is None:
            return None
        if isinstance(diameter, str):
            return self.begun(()), True
        return type(self)(diameter**2), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        (share,) = numbers
        return {"obstruction.diameter": root(share)}

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        diameter = finite(found, "obstruction.diameter")
        return None if diameter is None else self.at([each**2 for each in diameter])
