"""Motion of simulated controllers, in their own time: ramps up, cruises, ramps down; may be braked on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass

Point = tuple[float, ...]
"""A position on every axis, in mm."""


@dataclass(frozen=True, slots=True)
class Move:
    """A straight move from rest to rest that begins at `begin_s`; speed in mm/s, acceleration in mm/s²."""

    origin: Point
    target: Point
    begin_s: float
    speed: float
    acceleration: float

    @property
    def length_mm(self) -> float:
        """The whole way."""
        return math.dist(self.origin, self.target)

    @property
    def end_s(self) -> float:
        """Time of rest."""
        ramp_s, peak = self._ramp()
        return (
            self.begin_s + 2 * ramp_s + (self.length_mm - peak * ramp_s) / peak
            if peak
            else self.begin_s
        )

    def along(self, now_s: float) -> tuple[float, float]:
        """Return (distance in mm, speed) at a time."""
        ramp_s, peak = self._ramp()
        since_s = now_s - self.begin_s
        left_s = self.end_s - now_s
        if left_s <= 0:
            return self.length_mm, 0.0
        if since_s < ramp_s:
            return self.acceleration * since_s**2 / 2, self.acceleration * since_s
        if left_s < ramp_s:
            return (
                self.length_mm - self.acceleration * left_s**2 / 2,
                self.acceleration * left_s,
            )
        return peak * (since_s - ramp_s / 2), peak

    def at(self, way_mm: float) -> Point:
        """Return the place after a distance."""
        share = way_mm / self.length_mm if self.length_mm else 1.0
        return tuple(
            a + share * (b - a) for a, b in zip(self.origin, self.target, strict=True)
        )

    def _ramp(self) -> tuple[float, float]:
        """Return (time of either ramp, top speed reached)."""
        peak = min(self.speed, math.sqrt(self.length_mm * self.acceleration))
        return peak / self.acceleration, peak


@dataclass(frozen=True, slots=True)
class Braking:
    """A move braked from `begin_s` on."""

    move: Move
    begin_s: float

    @property
    def end_s(self) -> float:
        """Time of rest."""
        return self.begin_s + self.move.along(self.begin_s)[1] / self.move.acceleration

    def position(self, now_s: float) -> Point:
        """Return the place at a time, never beyond the end of the move."""
        way_mm, speed = self.move.along(self.begin_s)
        since_s = min(now_s, self.end_s) - self.begin_s
        way_mm += speed * since_s - self.move.acceleration * since_s**2 / 2
        return self.move.at(min(way_mm, self.move.length_mm))
