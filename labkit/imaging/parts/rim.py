"""Parts of the pupil's rim.

- A diaphragm of blades: the pupil is a polygon with more or less round sides
- An obstruction: a disc in the middle of the pupil without light, such as a mirror lens's second mirror
- An oval or three-sided pupil, such as an oblique or a vignetted one, to first order of its departure from a
  circle
- A cat's eye: off the axis the edge of another lens element cuts the pupil from one side
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import ClassVar, Self

import numpy as np

from labkit.imaging.estimated import polar, root
from labkit.imaging.parts.part import Part, finite
from labkit.optics.rim import FULL_TURN, Circle, Diaphragm, Rim
from labkit.plan import Channel, Plan
from labkit.types import Floats
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
        straight = min(math.hypot(self.cosine, self.sine), 1.0)
        blades = Diaphragm(self.number, turn, 1 - straight)
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


AT_BOUND = 1 - 1e-6
"""Share of a bound from which a number is taken to have ended there."""

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

    @property
    def at_bound(self) -> bool:
        return self.share > AT_BOUND * MOST_OBSTRUCTION**2

    def starts(self, before: Sequence[Part]) -> tuple[Self, ...]:
        return (type(self)(USUAL_SHARE),)

    def onto(self, rim: Rim) -> Rim:
        return replace(rim, obstructed=self.share)

    def stated(self, plan: Plan, channel: Channel) -> tuple[Self, bool] | None:
        diameter = plan.lens.obstruction
        if diameter is None:
            return None
        if isinstance(diameter, str):
            return self.starts(())[0], True
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


MOST_UNEVENNESS = 0.8
"""Largest departure of the rim; at 1 it would no longer be a closed curve."""


class Uneven(Part):
    """Harmonics of the rim's radius: no plan states them, and results have them as they are."""

    __slots__ = ()

    of_rim: ClassVar[bool] = True
    kind: ClassVar[str] = "uneven rim"
    one_sided: ClassVar[bool] = False

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


@dataclass(frozen=True, slots=True)
class UnevenRim(Uneven):
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

    @property
    def twin_signs(self) -> tuple[float, ...]:
        return 1.0, 1.0, -1.0, -1.0

    @property
    def values(self) -> tuple[float, ...]:
        return self.cosine_2, self.sine_2, self.cosine_3, self.sine_3

    def at(self, values: Sequence[float]) -> Self:
        depth = type(self)(*map(float, values))._depth
        within = min(1.0, MOST_UNEVENNESS / depth) if depth else 1.0
        return type(self)(*(within * float(value) for value in values))

    @property
    def _depth(self) -> float:
        """The largest departure of the radius, relative, if both harmonics peak at one place."""
        return math.hypot(self.cosine_2, self.sine_2) + math.hypot(
            self.cosine_3, self.sine_3
        )

    @property
    def at_bound(self) -> bool:
        return self._depth > AT_BOUND * MOST_UNEVENNESS

    def onto(self, rim: Rim) -> Rim:
        return replace(rim, uneven=self.values)


LEAST_GROWTH = -0.9
"""Of a circle a tenth as large as the pupil; a smaller one would be the pupil itself."""

MOST_SHIFT = 0.95
"""Largest shift, of the circle's radius: its centre and the pupil's both lie in the clear part."""

ANGLES = np.linspace(0, FULL_TURN, 96, endpoint=False)
START_DIRECTIONS = np.linspace(0, FULL_TURN, 36, endpoint=False)
TENTHS = 10
SHIFTS = range(1, TENTHS + 1)
SMALL_SIZES, LARGE_SIZES = range(7, TENTHS + 1), range(TENTHS + 1, 17)
"""Circles that a fit may begin with, in tenths of the pupil's radius: some are no larger than the pupil."""

USUAL_SHIFT, BLIND_DIRECTIONS = 0.4, np.linspace(0, FULL_TURN, 8, endpoint=False)
"""Of circles that a fit may begin with where no rim is known."""


@dataclass(frozen=True, slots=True)
class CatsEye(Part):
    """A circle that cuts the pupil. right, down: shift of its centre; growth: its radius less 1; of the full
    pupil's radius, to its blades' corners.

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
        "shift": "of the cutting circle's centre, over the full pupil's radius",
        "radius": "of the circle, over the full pupil's radius",
        "direction_deg": "of the shift, from right towards down",
    }
    of_rim: ClassVar[bool] = True
    one_sided: ClassVar[bool] = False
    kind: ClassVar[str] = Uneven.kind
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
        growth = max(growth, LEAST_GROWTH)
        shift = math.hypot(right, down)
        within = min(1.0, MOST_SHIFT * (1 + growth) / shift) if shift else 1.0
        return replace(self, right=within * right, down=within * down, growth=growth)

    @property
    def sides(self) -> tuple[Self, ...]:
        """The circle and the one opposite: their even harmonics are the same, and blades may make up for the odd ones."""
        return self, self.twin

    @property
    def at_bound(self) -> bool:
        most = MOST_SHIFT * (1 + self.growth)
        return self.growth <= LEAST_GROWTH or self._circle.shift > AT_BOUND * most

    def starts(self, before: Sequence[Part]) -> tuple[Self, ...]:
        """Return the circle of another fit, or small and large circles on both sides whose outlines are like an uneven rim.

        Without either, circles on all sides.
        """
        if eye := [part for part in before if isinstance(part, type(self))]:
            return (self.at(eye[0].values),)
        uneven = next((part for part in before if isinstance(part, UnevenRim)), None)
        if uneven is None:
            shift = USUAL_SHIFT * np.exp(1j * BLIND_DIRECTIONS)
            return tuple(self.at([one.real, one.imag, 0.0]) for one in shift)
        return tuple(
            self.at(
                [
                    one.shift * math.cos(one.direction),
                    one.shift * math.sin(one.direction),
                    one.size - 1,
                ]
            )
            for one in circles_like(uneven.values, START_DIRECTIONS)
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


def circles_like(
    uneven: Sequence[float], directions: Floats, least_size: float = 0.0
) -> list[Circle]:
    """Return the circles whose cut outlines have second and third harmonics (4,) most like these: four that differ.

    Two are no larger than the pupil and two are larger: one farther out cuts as deep, and climbs between them are slow. The
    second of either two lies on the opposite side, for only the third harmonic tells sides apart, and it may stand for modes.

    directions: of their shifts, with opposite ones among them; least_size: radius
    """
    found: list[Circle] = []
    for sizes in (SMALL_SIZES, LARGE_SIZES):
        circles = [
            Circle(s / TENTHS, r / TENTHS, float(t))
            for s, r, t in product(SHIFTS, sizes, directions)
            if r - TENTHS < s < r and r >= least_size * TENTHS
        ]
        away = [float(np.linalg.norm(_harmonics(one) - uneven)) for one in circles]
        first, *others = (circles[k] for k in np.argsort(away, kind="stable"))
        found += first, next(o for o in others if _opposite(o, first))
    return found


def _opposite(one: Circle, other: Circle) -> bool:
    """Return whether circles are shifted to opposite sides."""
    return math.cos(one.direction - other.direction) < 0


def _harmonics(circle: Circle) -> Floats:
    """Return the second and third harmonics (4,) of the outline of a pupil cut by a circle.

    About the centre of the clear part, relative to the mean.
    """
    second, third = _upright_harmonics(replace(circle, direction=0.0))
    turned = (
        second * cmath.exp(2j * circle.direction),
        third * cmath.exp(3j * circle.direction),
    )
    return np.array([part for one in turned for part in (one.real, one.imag)])


@lru_cache(maxsize=len(SHIFTS) * (len(SMALL_SIZES) + len(LARGE_SIZES)))
def _upright_harmonics(circle: Circle) -> tuple[complex, complex]:
    """Return the second and third harmonics, cosine and sine as a complex number, for a circle in the direction 0."""
    cut = Rim((Circle(), circle))
    right, down = cut.centre
    theta = np.linspace(0, FULL_TURN, 4 * ANGLES.size, endpoint=False)
    outline = cut.outline(theta)
    x, y = outline * np.cos(theta) - right, outline * np.sin(theta) - down
    about = np.interp(ANGLES, np.arctan2(y, x), np.hypot(x, y), period=FULL_TURN)
    second, third = (2 * np.exp(1j * k * ANGLES) @ about / about.sum() for k in (2, 3))
    return complex(second), complex(third)
