"""Parts of the pupil's rim that change over the frame: what another element's edge cuts off, more and more towards the corners.

Their numbers are those of the whole frame. A tile has the rim that they make at its place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import polar
from labkit.imaging.parts.part import Part, finite
from labkit.imaging.parts.rim import (
    AT_BOUND,
    MOST_SHIFT,
    MOST_UNEVENNESS,
    Uneven,
    circles_like,
)
from labkit.optics.rim import FRAME_MIDDLE, Place, Rim, Vignetting, harmonics
from labkit.optics.spectrum import Spectrum
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class UnevenField(Uneven):
    """Harmonics of the rim's radius along the image height, relative: second grows with its square, third with its cube.

    second, third: in the frame's corners. No other numbers of these orders are those of a rotationally symmetric lens.
    """

    second: float = 0.0
    third: float = 0.0
    place: Place | None = None

    name: ClassVar[str] = "uneven_field"
    title: ClassVar[str] = "pupil that is uneven towards the corners"
    words: ClassVar[str] = "a pupil that is less and less round towards the corners"
    labels: ClassVar[tuple[str, ...]] = ("second", "third")
    usual: ClassVar[tuple[float, ...]] = (0.4, 0.4)
    meanings: ClassVar[Mapping[str, str]] = {
        "second": "second harmonic of its radius in the frame's corners, relative",
        "third": "third harmonic",
    }

    @property
    def sought(self) -> bool:  # type: ignore[override]
        return self.place is not None

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return 1.0, -1.0

    @property
    def values(self) -> tuple[float, ...]:
        return self.second, self.third

    def at(self, values: Sequence[float]) -> Self:
        second, third = map(float, values)
        depth = abs(second) + abs(third)
        within = min(1.0, MOST_UNEVENNESS / depth) if depth else 1.0
        return replace(self, second=within * second, third=within * third)

    @property
    def at_bound(self) -> bool:
        return abs(self.second) + abs(self.third) > AT_BOUND * MOST_UNEVENNESS

    def about(self, typical: Spectrum, place: Place | None) -> Self:
        return replace(self, place=place)

    @property
    def harmonics(self) -> tuple[float, ...]:
        """The rim's harmonics at the place."""
        return harmonics(self.second, self.third, self.place or FRAME_MIDDLE)

    def onto(self, rim: Rim) -> Rim:
        return replace(rim, uneven=self.harmonics)


CLEAR_SIZE = 1.5
"""Radius of a circle that cuts nothing off, where a tile that shows nothing of it leaves it."""

LEAST_SIZE, MOST_ALONG = 1.0, 1.4
"""Bounds of the circle's radius and of its shift in the corners. A smaller circle would limit the pupil in the frame's middle:
then it is the full pupil, and the other circle cuts it, for two circles share the same light whichever is called so."""


@dataclass(frozen=True, slots=True)
class Vignetted(Part):
    """A circle that cuts the pupil off the middle of the frame, as of `labkit.optics.rim.Vignetting`.

    growth: its radius less `CLEAR_SIZE`. Where the circle lies outside the pupil the photographs do not depend on it. So fits
    test for an `UnevenField` and estimate this part in its place.
    """

    along: float = 0.0
    right: float = 0.0
    down: float = 0.0
    growth: float = 0.0
    place: Place | None = None

    name: ClassVar[str] = "vignetting"
    title: ClassVar[str] = "cat's eye over the frame"
    words: ClassVar[str] = "a pupil that is cut to a cat's eye towards the corners"
    labels: ClassVar[tuple[str, ...]] = ("along", "right", "down", "growth")
    usual: ClassVar[tuple[float, ...]] = (1.0, 0.3, 0.3, 0.5)
    meanings: ClassVar[Mapping[str, str]] = {
        "shift": "of the cutting circle's centre in the frame's corners, over the full pupil's radius",
        "radius": "of the circle, over the full pupil's radius",
        "middle_shift": "of the circle's centre in the middle of the frame",
        "middle_direction_deg": "of that shift, from right towards down",
    }
    of_rim: ClassVar[bool] = True
    one_sided: ClassVar[bool] = False
    kind: ClassVar[str] = Uneven.kind
    sought: ClassVar[bool] = False  # type: ignore[misc]

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return -1.0, -1.0, -1.0, 1.0

    @property
    def values(self) -> tuple[float, ...]:
        return self.along, self.right, self.down, self.growth

    @property
    def vignetting(self) -> Vignetting:
        """The circle over the frame."""
        return Vignetting(self.along, self.right, self.down, CLEAR_SIZE + self.growth)

    def at(self, values: Sequence[float]) -> Self:
        along, right, down, growth = map(float, values)
        growth = max(growth, LEAST_SIZE - CLEAR_SIZE)
        along = min(max(along, -MOST_ALONG), MOST_ALONG)
        one = replace(self, along=along, right=right, down=down, growth=growth)
        shift, size = one._shift, CLEAR_SIZE + growth
        within = min(1.0, MOST_SHIFT * size / shift) if shift else 1.0
        moved = (within * one.along, within * one.right, within * one.down)
        return replace(one, along=moved[0], right=moved[1], down=moved[2])

    @property
    def _shift(self) -> float:
        return self.vignetting.circle(self.place or FRAME_MIDDLE).shift

    @property
    def at_bound(self) -> bool:
        size = CLEAR_SIZE + self.growth
        beyond = abs(self.along) > AT_BOUND * MOST_ALONG or size <= LEAST_SIZE
        return beyond or self._shift > AT_BOUND * MOST_SHIFT * size

    def about(self, typical: Spectrum, place: Place | None) -> Self:
        return replace(self, place=place)

    def starts(self, before: Sequence[Part]) -> tuple[Self, ...]:
        """Return the circle of another fit, or small and large circles on both sides that are like an uneven field here."""
        if found := [part for part in before if isinstance(part, type(self))]:
            return (self.at(found[0].values),)
        uneven = next((part for part in before if isinstance(part, UnevenField)), None)
        y, x = self.place or FRAME_MIDDLE
        height = math.hypot(y, x)
        uneven = uneven and replace(uneven, place=self.place)
        if uneven is None or not height:
            return (self,)
        outwards = math.atan2(y, x)
        sides = np.array([outwards, outwards + math.pi])
        return tuple(
            self.at(
                [
                    one.shift / height * math.cos(one.direction - outwards),
                    0.0,
                    0.0,
                    one.size - CLEAR_SIZE,
                ]
            )
            for one in circles_like(uneven.harmonics, sides, LEAST_SIZE)
        )

    def onto(self, rim: Rim) -> Rim:
        return self.vignetting.onto(rim, self.place or FRAME_MIDDLE)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        if plan.field.cats_eye is None:
            return None
        along, radius = plan.field.cats_eye
        return replace(self, along=along, growth=radius - CLEAR_SIZE), False

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        along, right, down, growth = numbers
        shift, direction_deg = polar(right, down)
        return {
            "vignetting.shift": along,
            "vignetting.radius": Uncertain(CLEAR_SIZE + growth.value, growth.std),
            "vignetting.middle_shift": shift,
            "vignetting.middle_direction_deg": direction_deg,
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        values = finite(
            found,
            "vignetting.shift",
            "vignetting.radius",
            "vignetting.middle_shift",
            "vignetting.middle_direction_deg",
        )
        if values is None:
            return None
        along, radius, shift = values[:3]
        direction = math.radians(values[3])
        across = shift * math.cos(direction), shift * math.sin(direction)
        return self.at([along, *across, radius - CLEAR_SIZE])
