"""The clear pupil of the simulated lens: blades, central obstruction, cat's eye, and their samples on a grid.

Every rim is a disc's, and the pupil is the overlap of all discs, less the obstruction. A
sample is a smooth function of its distance from the nearest rim, so that a transform of
samples has the light of a sharp rim.

Written without labkit.optics and labkit.imaging, which it tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import asin, atan2, cos, pi, radians, sin, sqrt

import numpy as np
from numpy.polynomial.hermite_e import hermeval
from scipy.special import factorial, ndtr

from labkit.types import Floats

FEWEST_BLADES = 3
MOST_BLADES = 24
MOST_OBSTRUCTED = 0.9
LEAST_CLEAR_SHARE = 0.1
"""Share of the pupil that a cat's eye leaves at least."""

STRAIGHT = 1e-6
"""Rounding below which a blade is as straight as doubles can tell."""

RIM_SIGMA, RIM_TERMS = 1.35, 8
"""A rim is smoothed by a kernel whose transform is exp(-t) (1 + t + ... + t^8 / 8!), t = (2 pi sigma f)^2 / 2, f in cycles per
sample: 1e-6 less than one where light lands a sixth of a period from the axis, 2e-4 in a window's corners, and 7e-5 at
most where copies of the field come from, five sixths away."""

RIM_REACH = 10
"""Samples from the rim, beyond which the kernel has nothing left: 1e-9."""

MEASURED_RADIUS = 500
"""Samples to the radius where areas are measured."""

SPIKES = 180
"""Directions of half a turn that far light is counted in. A straight blade's light is narrower."""

RIM_POINTS, ON_RIM = 36_000, 1e-9
"""Points on each rim for these directions, and the distance within which they lie on it."""


@dataclass(frozen=True, slots=True)
class Pupil:
    """A pupil that is no disc. Directions are measured from right towards down, as the sensor sees the pupil.

    blades: of the diaphragm, 0 for a round diaphragm; turn_deg: direction of the middle of
    a blade; rounding: 0 for straight blades, 1 for a circle; each blade is an arc of radius
    1/rounding, in units of the circle through the corners. obstruction: diameter of the
    dark disc in the middle over that of the circle of the opening's area. cats_eye: (shift,
    radius, direction in degrees) of a second circle that cuts the pupil off the axis, in
    units of the radius of the circle of the opening's area. Raises ValueError for an
    impossible pupil.
    """

    blades: int = 0
    turn_deg: float = 0.0
    rounding: float = 0.0
    obstruction: float = 0.0
    cats_eye: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.blades and not FEWEST_BLADES <= self.blades <= MOST_BLADES:
            raise ValueError(
                f"a diaphragm has {FEWEST_BLADES} to {MOST_BLADES} blades, or 0 for a "
                f"round one, not {self.blades}"
            )
        if not 0 <= self.rounding <= 1:
            raise ValueError(
                f"rounding of blades is 0 (straight) to 1 (a circle), not {self.rounding:g}"
            )
        if not 0 <= self.obstruction < MOST_OBSTRUCTED:
            raise ValueError(
                f"an obstruction is 0 to less than {MOST_OBSTRUCTED:g} of the diameter, "
                f"not {self.obstruction:g}"
            )
        if not self.blades and (self.rounding or self.turn_deg):
            raise ValueError("turn and rounding are those of blades: say how many")
        if self.cats_eye and not self.clear_share >= LEAST_CLEAR_SHARE:
            raise ValueError(
                "a cat's eye is shift, radius and direction of a circle that leaves a tenth "
                f"of the pupil or more, not {self.clear_share:.2g} of it"
            )

    @property
    def opening(self) -> float:
        """Radius of the circle of the opening's area; 1 is the radius for the clear area on the axis."""
        return 1 / sqrt(1 - self.obstruction**2)

    @property
    def extent(self) -> float:
        """Radius of the smallest circle about the axis around the opening: of the rim, or of the blades'
        corners.
        """
        if not self.blades:
            return self.opening
        half = pi / self.blades
        area = self.blades * sin(half) * cos(half)
        if self.rounding > STRAIGHT:
            leaning = asin(self.rounding * sin(half))
            area += self.blades * (leaning - sin(2 * leaning) / 2) / self.rounding**2
        return self.opening * sqrt(pi / area)

    @property
    def apothem(self) -> float:
        """Distance of straight blades from the axis."""
        return self.extent * cos(pi / self.blades)

    @property
    def clear_share(self) -> float:
        """Share of the clear area on the axis that the cat's eye leaves."""
        return _measured(self)[0]

    @property
    def rim(self) -> float:
        """Length of all rims over that of a clear disc of the same area: far light is proportional."""
        area, length = _measured(self)
        return length / (2 * area)

    @property
    def spikes(self) -> Floats:
        """(SPIKES,) length of the rims across each direction of half a turn, over the mean: far light goes along them."""
        is_round = not self.cats_eye and (not self.blades or self.rounding == 1)
        return np.ones(SPIKES) if is_round else _spikes(self)

    def samples(self, u: Floats, v: Floats, per_radius: float) -> Floats:
        """Return the share of light that passes at coordinates (u right, v down) of a grid.

        A unit is the radius of the circle of the clear area on the axis; per_radius:
        samples to a unit.
        """
        return _smooth_step(self._from_rim(u, v) * per_radius)

    def _from_rim(self, u: Floats, v: Floats) -> Floats:
        """Return the distance from the nearest rim, units, positive where light passes."""
        inside = np.full(np.broadcast_shapes(u.shape, v.shape), np.inf)
        for right, down, radius in self._discs():
            np.minimum(inside, radius - np.hypot(u - right, v - down), out=inside)
        for across, along in self._edges():
            np.minimum(inside, self.apothem - u * across - v * along, out=inside)
        if self.obstruction:
            dark = self.obstruction * self.opening
            np.minimum(inside, np.hypot(u, v) - dark, out=inside)
        return inside

    def _directions(self) -> Iterator[tuple[float, float]]:
        """Yield the direction of the middle of each blade: right, down."""
        for k in range(self.blades):
            angle = radians(self.turn_deg) + 2 * pi * k / self.blades
            yield cos(angle), sin(angle)

    def _edges(self) -> Iterator[tuple[float, float]]:
        """Yield the directions of straight blades."""
        if self.rounding <= STRAIGHT:
            yield from self._directions()

    def _discs(self) -> Iterator[tuple[float, float, float]]:
        """Yield centre (right, down) and radius of each disc within which light passes."""
        if not self.blades:
            yield 0.0, 0.0, self.opening
        elif self.rounding > STRAIGHT:
            half = pi / self.blades
            radius = 1 / self.rounding
            middle = cos(half) - sqrt(radius**2 - sin(half) ** 2)
            for right, down in self._directions():
                yield (
                    middle * right * self.extent,
                    middle * down * self.extent,
                    radius * self.extent,
                )
        if self.cats_eye:
            shift, radius, direction = self.cats_eye
            angle = radians(direction)
            unit = self.opening
            yield shift * cos(angle) * unit, shift * sin(angle) * unit, radius * unit


ROUND_PUPIL = Pupil()


def _smooth_step(samples: Floats) -> Floats:
    """Return the kernel's integral up to a distance from the rim: 0 far outside, 1 far inside.

    In Hermite's polynomials each power of t adds a derivative of the Gaussian.
    """
    near = np.abs(samples) < RIM_REACH
    z = samples[near] / RIM_SIGMA
    k = np.arange(1, RIM_TERMS + 1)
    weights = np.zeros(2 * RIM_TERMS)
    weights[2 * k - 1] = -((-1.0) ** k) / (2.0**k * factorial(k))
    step = (samples > 0).astype(float)
    step[near] = ndtr(z) + hermeval(z, weights) * np.exp(-z * z / 2) / sqrt(2 * pi)
    return step


def _in_samples(pupil: Pupil) -> Floats:
    """Return distances from the rim on a grid, samples."""
    edge = int(pupil.extent * MEASURED_RADIUS) + RIM_REACH
    axis = np.arange(-edge, edge + 1) / MEASURED_RADIUS
    return pupil._from_rim(axis[None, :], axis[:, None]) * MEASURED_RADIUS


@lru_cache(maxsize=64)
def _spikes(pupil: Pupil) -> Floats:
    """Return `Pupil.spikes`: the length of all rims that limit the light, by the direction across them."""
    lengths = np.zeros(SPIKES)
    for u, v, across, apart in _on_rims(pupil):
        lit = pupil._from_rim(u, v) > -ON_RIM
        turn = (across[lit] / pi % 1 * SPIKES).astype(int) % SPIKES
        lengths += apart * np.bincount(turn, minlength=SPIKES)
    return np.asarray(lengths / lengths.mean())


def _on_rims(pupil: Pupil) -> Iterator[tuple[Floats, Floats, Floats, float]]:
    """Yield points u, v of each rim, the directions across it, and the distance of points."""
    share = (np.arange(RIM_POINTS) + 0.5) / RIM_POINTS
    around, along = 2 * pi * share, 2 * pupil.extent * (share - 0.5)
    dark = (0.0, 0.0, pupil.obstruction * pupil.opening)
    for right, down, radius in (*pupil._discs(), dark):
        u, v = right + radius * np.cos(around), down + radius * np.sin(around)
        yield u, v, around, 2 * pi * radius / RIM_POINTS
    for right, down in pupil._edges():
        u = pupil.apothem * right - along * down
        v = pupil.apothem * down + along * right
        across = np.full(RIM_POINTS, atan2(down, right))
        yield u, v, across, 2 * pupil.extent / RIM_POINTS


@lru_cache(maxsize=64)
def _measured(pupil: Pupil) -> tuple[float, float]:
    """Clear area and length of all rims, in units of the disc's area and of its radius times pi."""
    inside = _in_samples(pupil)
    area, wider, narrower = (
        float(_smooth_step(inside + by).sum()) for by in (0.0, 0.5, -0.5)
    )
    disc = pi * MEASURED_RADIUS**2
    return area / disc, (wider - narrower) * MEASURED_RADIUS / disc
