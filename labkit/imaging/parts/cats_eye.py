"""A cat's eye: off the axis the edge of another lens element cuts the pupil from one side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import polar
from labkit.imaging.parts.part import Part, finite
from labkit.imaging.parts.uneven_rim import UnevenRim
from labkit.optics.rim import FULL_TURN, Circle, Rim
from labkit.plan import Channel, Plan
from labkit.types import Floats
from labkit.uncertain import Uncertain

MOST_SHIFT = 0.95
"""Largest shift, of the circle's radius: its centre and the pupil's both lie in the clear part."""

ANGLES = np.linspace(0, FULL_TURN, 96, endpoint=False)
SHIFTS = np.arange(0.1, 1.01, 0.1)
SIZES = np.arange(0.7, 1.61, 0.1)
START_DIRECTIONS = np.linspace(0, FULL_TURN, 36, endpoint=False)
"""Circles that a fit may begin with."""


@dataclass(frozen=True, slots=True)
class CatsEye(Part):
    """A circle that cuts the pupil. right, down: shift of its centre; growth: its radius less 1; of the full
    pupil's radius.

    With all numbers 0 the circle is the pupil's own edge. The likelihood is not regular
    there, so fits test for an `UnevenRim` and estimate a cat's eye in its place.
    """

    right: float = 0.0
    down: float = 0.0
    growth: float = 0.0

    name: ClassVar[str] = "cats_eye"
    title: ClassVar[str] = "cat's eye"
    words: ClassVar[str] = "a pupil that is cut to a cat's eye"
    labels: ClassVar[tuple[str, ...]] = ("right", "down", "growth")
    usual: ClassVar[tuple[float, ...]] = (0.5, 0.5, 0.5)
    meanings: ClassVar[Mapping[str, str]] = {
        "shift": "of the cutting circle's centre, over the pupil's radius",
        "radius": "of the circle, over the pupil's radius",
        "direction_deg": "of the shift, from right towards down",
    }
    of_rim: ClassVar[bool] = True
    one_sided: ClassVar[bool] = False
    kind: ClassVar[str] = UnevenRim.kind
    sought: ClassVar[bool] = False  # type: ignore[misc]

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return -1.0, -1.0, 1.0

    @property
    def values(self) -> tuple[float, ...]:
        return self.right, self.down, self.growth

    @property
    def _circle(self) -> Circle:
        shift = math.hypot(self.right, self.down)
        direction = math.atan2(self.down, self.right)
        return Circle(shift, 1 + self.growth, direction)

    def at(self, values: Sequence[float]) -> Self:
        right, down, growth = map(float, values)
        growth = max(growth, -0.9)
        shift = math.hypot(right, down)
        within = min(1.0, MOST_SHIFT * (1 + growth) / shift) if shift else 1.0
        return replace(self, right=within * right, down=within * down, growth=growth)

    def begun(self, before: Sequence[Part]) -> Self:
        """Return the circle whose outline has the harmonics of a previously fitted uneven rim."""
        uneven = next((part for part in before if isinstance(part, UnevenRim)), None)
        if uneven is None:
            return self
        every = product(SHIFTS, SIZES, START_DIRECTIONS)
        circles = [
            Circle(float(s), float(r), float(t)) for s, r, t in every if r - 1 < s < r
        ]
        away = [np.linalg.norm(_harmonics(one) - uneven.values) for one in circles]
        best = circles[int(np.argmin(away))]
        return self.at(
            [
                best.shift * math.cos(best.direction),
                best.shift * math.sin(best.direction),
                best.size - 1,
            ]
        )

    def onto(self, rim: Rim) -> Rim:
        return rim if self.idle else replace(rim, cuts=(*rim.cuts, Circle(), self._circle))

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        return None

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        right, down, growth = numbers
        shift, direction_deg = polar(right, down)
        return {
            "cats_eye.shift": shift,
            "cats_eye.radius": Uncertain(1 + growth.value, growth.std),
            "cats_eye.direction_deg": direction_deg,
        }

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        values = finite(
            found, "cats_eye.shift", "cats_eye.radius", "cats_eye.direction_deg"
        )
        if values is None:
            return None
        shift = values[0]
        radius = values[1]
        direction = math.radians(values[2])
        return self.at(
            [shift * math.cos(direction), shift * math.sin(direction), radius - 1]
        )


def _harmonics(circle: Circle) -> Floats:
    """Return the second and third harmonics (4,) of the outline of a pupil cut by a circle, relative to its
    mean.
    """
    outline = np.minimum(1.0, circle.radius(ANGLES))
    outline = outline / outline.mean()
    turns = np.array([wave(k * ANGLES) for k in (2, 3) for wave in (np.cos, np.sin)])
    return np.asarray(2 * (turns @ outline) / len(ANGLES))
