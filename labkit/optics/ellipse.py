"""Elliptical pupils, whose perfect image is a disc's but for a stretch: the nearest closed form to an uneven halo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from labkit.types import Floats

LARGEST_STRETCH = 100.0
EVEN_EDGES = 1e-6  # unevenness of edges below which an outline is as good as a circle
RIM_POINTS = 256


@dataclass(frozen=True)
class Ellipse:
    """An ellipse about the pupil's centre, with the unit circle's area.

    Attributes
    ----------
    stretch : its longest diameter over the shortest
    direction : of the longest
    """

    stretch: float = 1.0
    direction: float = 0.0

    @property
    def corners(self) -> Sequence[float]:
        """An ellipse has no corners."""
        return ()

    def turned(self, angle: float) -> Ellipse:
        """Return the ellipse turned by an angle."""
        return replace(self, direction=self.direction + angle)

    def radius(self, theta: Floats) -> Floats:
        """Return the distance of the ellipse from its centre."""
        return np.asarray(1 / self.distance(np.cos(theta), np.sin(theta)))

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distance of points from the centre, in that of the ellipse in their direction."""
        cosine, sine, root = (
            np.cos(self.direction),
            np.sin(self.direction),
            self.stretch**0.5,
        )
        along, across = x * cosine + y * sine, y * cosine - x * sine
        return np.asarray(np.hypot(along / root, across * root))

    @property
    def halo(self) -> float:
        """Length of the edge, over a circle's: the light in the diffraction halo."""
        short, long = _edge(self.stretch)
        return float(np.hypot(short, long).mean() / self.stretch**0.5)

    @classmethod
    def with_edges(cls, uneven: complex) -> Ellipse:
        """Return the ellipse with an unevenness of its edges: the mean of exp(2i angle) of their normals."""
        if abs(uneven) < EVEN_EDGES:
            return cls()
        log_stretch = brentq(
            lambda log: _uneven(np.exp(log)) - abs(uneven), 0.0, np.log(LARGEST_STRETCH)
        )
        # most normals point along the shortest diameter
        return cls(float(np.exp(log_stretch)), float(np.angle(uneven) + np.pi) / 2)


CIRCLE = Ellipse()


def _edge(stretch: float) -> tuple[Floats, Floats]:
    """Return an ellipse's normals (points,) along its shortest and its longest diameter, as long as their arcs.

    The unit is the shortest radius, for a full turn of the parameter.
    """
    turn = np.linspace(0, 2 * np.pi, RIM_POINTS, endpoint=False)
    return stretch * np.sin(turn), np.cos(turn)


def _uneven(stretch: float) -> float:
    """Return the mean of cos(2 angle) of an ellipse's normals, the angles from its shortest diameter."""
    short, long = _edge(stretch)
    length = np.hypot(short, long)
    return float(np.sum((short**2 - long**2) / length) / np.sum(length))
