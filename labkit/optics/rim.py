"""The rim of a pupil that is no round clear disc: blades, unevenness, a cat's eye, an obstructed centre; here and over a frame.

Lengths are in units of the radius of the circle of equal clear area, angles in radians from
x (right) towards y (down), as in `labkit.optics.psf`. The f-number is that of this circle:
ISO 517 defines an f-number by area.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Protocol, Self

import numpy as np

from labkit.types import Bools, Floats

FULL_TURN = 2 * np.pi
OUTLINE_ARCS = 512  # of an outline, for its extent and its length
CENTROID_ANGLES = 96  # at least, of points to a centroid
HALVINGS = 45  # of an interval of angles, to an intersection


class Cut(Protocol):
    """An edge that limits the pupil and surrounds its centre once."""

    def radius(self, theta: Floats) -> Floats:
        """Return the distance of the edge from the centre, relative to the full pupil's radius."""
        ...

    @property
    def corners(self) -> Sequence[float]:
        """Angles of the edge's corners."""
        ...

    def turned(self, angle: float) -> Self:
        """Return the edge turned by an angle, from x towards y."""
        ...


@dataclass(frozen=True)
class Diaphragm:
    """A diaphragm whose corners lie on the full pupil's circle.

    Attributes
    ----------
    blades : number of blades, each an arc of a circle from corner to corner
    turn : direction of the middle of a blade
    roundness : curvature of the blades, 0 where they are straight, 1 where they make up the circle
    """

    blades: int
    turn: float = 0.0
    roundness: float = 0.0

    @property
    def corners(self) -> Sequence[float]:
        """Angles of the corners, half a blade from its middle."""
        return [self.turn + FULL_TURN * (k + 0.5) / self.blades for k in range(self.blades)]

    def turned(self, angle: float) -> Diaphragm:
        """Return the diaphragm turned by an angle."""
        return replace(self, turn=self.turn + angle)

    def radius(self, theta: Floats) -> Floats:
        """Return the distance of the blades from the centre.

        Points p of an arc have c + b x + r |p|^2 / 2 = 0, x along the blade's direction and
        r the curvature; b and c follow from the corners and from the radius of 1 / r.
        """
        half = np.pi / self.blades
        along = np.cos((theta - self.turn + half) % (2 * half) - half)
        cosine = np.cos(half)
        curved = self.roundness
        b = np.sqrt(1 - (curved * np.sin(half)) ** 2) - curved * cosine
        c = -0.5 * curved - b * cosine
        return np.asarray(-2 * c / (b * along + np.sqrt((b * along) ** 2 - 2 * c * curved)))


@dataclass(frozen=True)
class Circle:
    """A circle, possibly off the pupil's centre, such as the edge of a lens element seen obliquely.

    Attributes
    ----------
    shift : distance of its centre from the pupil's, less than the radius
    size : radius, relative to the full pupil's radius
    direction : of the shift
    """

    shift: float = 0.0
    size: float = 1.0
    direction: float = 0.0

    @property
    def corners(self) -> Sequence[float]:
        """A circle has no corners."""
        return ()

    def turned(self, angle: float) -> Circle:
        """Return the circle turned by an angle."""
        return replace(self, direction=self.direction + angle)

    def radius(self, theta: Floats) -> Floats:
        """Return the distance of the circle from the pupil's centre."""
        away = theta - self.direction
        across = self.shift * np.sin(away)
        return np.asarray(self.shift * np.cos(away) + np.sqrt(self.size**2 - across**2))


@dataclass(frozen=True)
class Rim:
    """The clear part of a pupil: a star-shaped outline less an obstructed disc in its middle.

    The unit of length is the radius of the circle with the clear area of the full pupil, which has no cat's eye. Modes and
    f-numbers of a vignetted pupil so compare with those of the pupil on the axis.

    Attributes
    ----------
    cuts : edges that limit the pupil, the innermost at every angle; none for the full
        circle
    uneven : (4,) the outline's relative departures along cos 2t, sin 2t, cos 3t and sin 3t;
        first harmonics shift the pupil as a whole, which no image shows
    obstructed : obstructed share of the full outline's area; a negative share, in the course of
        an estimate, brightens the centre
    """

    cuts: tuple[Cut, ...] = ()
    uneven: tuple[float, ...] = ()
    obstructed: float = 0.0

    @property
    def is_round(self) -> bool:
        """Return whether the pupil is a clear disc."""
        return not (self.cuts or any(self.uneven) or self.obstructed)

    def turned(self, angle: float) -> Rim:
        """Return the rim turned by an angle, from x towards y."""
        if self.is_round:
            return self
        uneven = list(self.uneven)
        for k in range(0, len(uneven), 2):
            cosine, sine = self.uneven[k : k + 2]
            turn = (2 + k // 2) * angle
            uneven[k] = float(cosine * np.cos(turn) - sine * np.sin(turn))
            uneven[k + 1] = float(cosine * np.sin(turn) + sine * np.cos(turn))
        cuts = tuple(cut.turned(angle) for cut in self.cuts)
        return replace(self, cuts=cuts, uneven=tuple(uneven))

    def outline(self, theta: Floats) -> Floats:
        """Return the distance of the outline from the centre at angles of any shape."""
        return np.asarray(self._scale * self._radius(theta))

    @property
    def dark_area(self) -> float:
        """Obstructed area over the full pupil's clear area."""
        return self.obstructed / (1 - self.obstructed)

    @property
    def inner(self) -> float:
        """Radius of the obstructed disc."""
        return float(np.sqrt(max(self.dark_area, 0.0)))

    def inside(self, x: Floats, y: Floats) -> Bools:
        """Return whether points lie in the clear part."""
        rho = np.hypot(x, y)
        if self.is_round:
            return np.asarray(rho <= 1)
        return np.asarray((rho >= self.inner) & (rho <= self.outline(np.arctan2(y, x))))

    def quadrature(self, radial: int, angular: int) -> tuple[Floats, Floats, Floats]:
        """Return points x, y (points,) in the clear part and their weights, with sum 1.

        Parameters
        ----------
        radial, angular : Gauss's nodes along a radius, and the least number around the rim
        """
        ends = np.unique([*np.linspace(0, FULL_TURN, 8), *(self._kinks() % FULL_TURN)])
        node, weight = np.polynomial.legendre.leggauss(4 + angular // (len(ends) - 1))
        half = 0.5 * np.diff(ends)[:, None]
        theta = (ends[:-1, None] + half * (1 + node)).ravel()[:, None]
        by_angle = (half * weight).ravel()[:, None]
        node, weight = np.polynomial.legendre.leggauss(radial)
        # nothing is clear where a climb tries a cut that reaches into the obstruction
        depth = np.maximum(0.5 * (self.outline(theta) - self.inner), 0.0)
        rho = self.inner + depth * (1 + node)
        weights = (rho * depth * weight * by_angle).ravel()
        x, y = (rho * np.cos(theta)).ravel(), (rho * np.sin(theta)).ravel()
        return x, y, weights / weights.sum()

    def edges(self, arcs: int) -> list[Floats]:
        """Return closed chains of parabolic arcs about a clear area of exactly pi times `area`; the obstruction's
        chain runs backwards.

        Parameters
        ----------
        arcs : number around the outline; corners between arcs add to them

        Returns
        -------
        (points, 2) x and y of the end of an arc, its middle, the end of the next and so on
        """
        circle = _chain(np.linspace(0.0, FULL_TURN, arcs, endpoint=False), np.ones_like)
        outline = _chain(self._ends(arcs), self._radius)
        share = self.dark_area
        outer = outline * np.sqrt(np.pi * (self.area + share) / _area(outline))
        if not self.obstructed:
            return [outer]
        inner = circle * np.sqrt(np.pi * abs(share) / _area(circle))
        return [outer, np.roll(inner[::-1], 1, axis=0) if share > 0 else inner]

    @property
    def full(self) -> Rim:
        """The rim of the full pupil: without the circles that cut it to a cat's eye."""
        kept = tuple(
            cut for cut in self.cuts if not (isinstance(cut, Circle) and cut.shift)
        )
        return self if len(kept) == len(self.cuts) else replace(self, cuts=kept)

    @property
    def is_full(self) -> bool:
        """Return whether no circle cuts the pupil to a cat's eye."""
        return self.full is self

    @cached_property
    def area(self) -> float:
        """Clear area over the full pupil's: 1 unless a cat's eye cuts the pupil."""
        if self.is_full:
            return 1.0
        return self._scale**2 * self._outline_area / np.pi - self.dark_area

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Centroid x, y of the clear part."""
        x, y, weights = self.quadrature(4, CENTROID_ANGLES)
        return float(weights @ x), float(weights @ y)

    @cached_property
    def _scale(self) -> float:
        """Return the unit of `_radius`."""
        clear = (1 - self.obstructed) * self.full._outline_area
        return float(np.sqrt(np.pi / clear))

    @cached_property
    def _outline_area(self) -> float:
        """Area within the outline, in the unit of `_radius`."""
        return _area(_chain(self._ends(OUTLINE_ARCS), self._radius))

    def _radius(self, theta: Floats) -> Floats:
        """Return the outline's distance from the centre, in any unit."""
        cuts = [cut.radius(theta) for cut in self.cuts]
        radius = np.min(cuts, axis=0) if cuts else np.ones_like(theta)
        for place, share in enumerate(self.uneven):
            wave = np.sin if place % 2 else np.cos
            radius = radius + share * wave((2 + place // 2) * theta)
        return np.asarray(radius)

    def arcs(self, number: int) -> tuple[Floats, Floats]:
        """Return angles of the middles of at least a number of arcs around the outline, without corners, and their widths."""
        ends = self._ends(number)
        widths = np.diff(ends, append=ends[0] + FULL_TURN)
        return ends + 0.5 * widths, widths

    def _ends(self, arcs: int) -> Floats:
        """Return angles that split the outline into arcs, corners among them."""
        even = np.linspace(0.0, FULL_TURN, arcs, endpoint=False)
        return np.unique([*even, *(self._kinks() % FULL_TURN)])

    def _kinks(self) -> Floats:
        """Return the angles of corners, and of the intersections of cuts."""
        kinks = [angle for cut in self.cuts for angle in cut.corners]
        theta = np.linspace(0.0, FULL_TURN, OUTLINE_ARCS, endpoint=False)
        for one, other in combinations(self.cuts, 2):

            def inside(at: Floats, one: Cut = one, other: Cut = other) -> Floats:
                return one.radius(at) - other.radius(at)

            low, high = theta, theta + theta[1]
            cross = inside(low) * inside(high) < 0
            low, high = low[cross], high[cross]
            first = np.sign(inside(low))
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                same = np.sign(inside(middle)) == first
                low, high = np.where(same, middle, low), np.where(same, high, middle)
            kinks.extend(low)
        return np.array(kinks)

    @cached_property
    def _extent(self) -> tuple[float, float, float]:
        """Return the longest radius, half the largest width, and the edge's length by the area, over a circle's."""
        if self.is_round:
            return 1.0, 1.0, 1.0
        edges = self.edges(OUTLINE_ARCS)
        theta = np.linspace(0.0, FULL_TURN, OUTLINE_ARCS, endpoint=False)
        reach = np.max(
            np.stack([np.cos(theta), np.sin(theta)], axis=1) @ edges[0].T, axis=1
        )
        width = 0.5 * np.max(reach + np.roll(reach, OUTLINE_ARCS // 2))
        length = sum(
            np.linalg.norm(edge - np.roll(edge, 1, axis=0), axis=1).sum() for edge in edges
        )
        longest = np.max(np.linalg.norm(edges[0], axis=1))
        return float(longest), float(width), float(length / FULL_TURN / self.area)

    @property
    def longest(self) -> float:
        """Distance of the farthest point of the rim from the centre."""
        return self._extent[0]

    @property
    def reach(self) -> float:
        """Half the pupil's largest width: light passes up to this many times the incoherent cutoff 1/(lambda N)."""
        return self._extent[1]

    @property
    def halo(self) -> float:
        """Length of all edges by the clear area, relative to a circle's: the light in the diffraction halo.

        P. J. Clark, J. W. Howard and E. R. Freniere, Appl. Opt. 23, 353 (1984).
        """
        return self._extent[2]

    @property
    def outer(self) -> float:
        """Radius of the full pupil: of a diaphragm's corners, a mirror's edge, or the edge that a cat's eye
        cuts.
        """
        return 1.0 if self.is_round else self._scale


ROUND = Rim()
"""A clear disc."""

ROUND_RIM = Rim((Circle(),))
"""The clear disc, with a circle as its stated outline."""


Place = tuple[float, float]
"""(y, x) of a point of the frame from its middle, over half its diagonal."""

FRAME_MIDDLE: Place = (0.0, 0.0)


@dataclass(frozen=True)
class Vignetting:
    """A circle that cuts the pupil, and whose shift changes linearly over the frame.

    Lengths are in units of the full pupil's radius.

    Attributes
    ----------
    along : shift of its centre in the frame's corners, along the image height
    right, down : shift in the middle of the frame, which a centred lens does not have
    size : radius
    """

    along: float = 0.0
    right: float = 0.0
    down: float = 0.0
    size: float = 1.0

    def circle(self, place: Place) -> Circle:
        """Return the circle as seen from a place."""
        right, down = self.right + self.along * place[1], self.down + self.along * place[0]
        shift = float(np.hypot(right, down))
        return Circle(shift, self.size, float(np.arctan2(down, right)))

    def onto(self, rim: Rim, place: Place) -> Rim:
        """Return the rim of the pupil as seen from a place."""
        circle = self.circle(place)
        if circle.size - circle.shift >= 1:
            return rim
        return replace(rim, cuts=(*rim.cuts, Circle(), circle))


@dataclass(frozen=True)
class FieldRim:
    """The rim at every place of the frame.

    Attributes
    ----------
    middle : what all places have in common
    vignetting : the circle that cuts the pupil off the middle; None without one
    uneven : second and third harmonic of the radius along the image height in the frame's corners, relative: these grow with
        the square and the cube of the height
    """

    middle: Rim = ROUND
    vignetting: Vignetting | None = None
    uneven: tuple[float, float] = (0.0, 0.0)

    def at(self, place: Place) -> Rim:
        """Return the rim as seen from a place."""
        rim = self.middle
        if any(self.uneven):
            rim = replace(rim, uneven=harmonics(*self.uneven, place))
        return rim if self.vignetting is None else self.vignetting.onto(rim, place)


ROUND_EVERYWHERE = FieldRim()


def harmonics(second: float, third: float, place: Place) -> tuple[float, ...]:
    """Return the (4,) harmonics at a place, as of `labkit.optics.rim.Rim`, of an unevenness as of `FieldRim`."""
    height = complex(place[1], place[0])
    along = second * height**2, third * height**3
    return along[0].real, along[0].imag, along[1].real, along[1].imag


def _chain(ends: Floats, radius: Callable[[Floats], Floats]) -> Floats:
    """Return a chain of arcs, as of `Rim.edges`, along a curve with a radius at every angle."""
    after = np.append(ends[1:], ends[0] + FULL_TURN)
    angles = np.stack([ends, 0.5 * (ends + after)], axis=1).ravel()
    return np.asarray(
        radius(angles)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    )


def along(edge: Floats, at: float) -> tuple[Floats, Floats]:
    """Return places (arcs, 2) on each arc of a chain, and their derivatives by `at`, which runs from 0 to 1."""
    first = edge[::2]
    middle = edge[1::2]
    last = np.roll(first, -1, axis=0)
    rise = last - first
    bend = 2 * (first - 2 * middle + last)
    place = first + at * rise + at * (at - 1) * bend
    return place, rise + (2 * at - 1) * bend


def _area(edge: Floats) -> float:
    """Return the area within a chain that runs from x towards y."""
    area = 0.0
    for at in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):
        place, slope = along(edge, at)
        area += 0.25 * float(np.sum(place[:, 0] * slope[:, 1] - place[:, 1] * slope[:, 0]))
    return area
