"""How a lens with distortion and lateral colour images the tiles of a target.

Places on the sensor are in mm from the middle of the frame, y down and x right. A pinhole
maps the target's plane, or a slightly bent print, to v; the lens moves v to

    u = v (1 + k1 r² + k2 r⁴) + 2 (b·v) v + b r²,    r = |v|,

and a channel moves u to u (1 + s) + t against the reference channel. b is what a centre c of
the distortion away from the frame's middle adds to first order, b = -k1 c; linear terms
belong to the pinhole. The model stays regular where k1 is zero and no centre exists.
All functions accept complex numbers, for derivatives by complex steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labkit.field.tile_places import (
    CORNERS,
    PartsOfTarget,
    TileGrid,
    TilePlace,
    corners_by_nodes,
    nodes,
)
from labkit.optics.field import FieldFrame
from labkit.types import Floats, Integers

Numbers = NDArray[Any]
"""Real, or complex in derivatives by complex steps."""

HOMOGRAPHY = 8
"""Numbers of a station's pinhole: rows of the matrix, whose last element is 1."""

DEPTHS = (6, 7)
"""Places among them of the relative change of depth over the target, down and right."""

RADIAL, DECENTRE, FIFTH, BEND, TILE_GROWTH = (0,), (1, 2), (3,), (4, 5, 6), (7,)
"""Places of k1, b, k2, the print's curvatures, and the tiles' relative growth against the plan at the stated pitch among
the numbers that all stations share."""

SHARED = 8

CHANNEL_NUMBERS = 3
"""Numbers of a channel: s, and t down and right in mm."""


@dataclass(frozen=True, eq=False)
class TileModel:
    """The corners of all tiles as a function of the numbers of stations, lens and channels.

    Parameters
    ----------
    frame : coordinates
    grid : the tiles on the target
    places : observations
    ranges_mm : of the stations; `places` have no others
    channels : the reference first
    distances_mm : (stations,) from the entrance pupil to the target
    """

    frame: FieldFrame
    grid: TileGrid | PartsOfTarget
    places: tuple[TilePlace, ...]
    ranges_mm: tuple[float | None, ...]
    channels: tuple[str, ...]
    distances_mm: Floats

    @property
    def size(self) -> int:
        """Count of all numbers: homographies, then the shared ones, then the channels' but the reference's."""
        return int(self.shared.stop) + CHANNEL_NUMBERS * (len(self.channels) - 1)

    @property
    def shared(self) -> slice:
        """Place of the numbers that all stations share."""
        first = HOMOGRAPHY * len(self.ranges_mm)
        return slice(first, first + SHARED)

    def homography(self, station: int) -> slice:
        """Return the place of a station's homography."""
        return slice(HOMOGRAPHY * station, HOMOGRAPHY * (station + 1))

    def colour(self, channel: str) -> slice:
        """Return the place of a channel's numbers; empty for the reference."""
        at = self.shared.stop + CHANNEL_NUMBERS * (self.channels.index(channel) - 1)
        return slice(at, at + CHANNEL_NUMBERS * (channel != self.channels[0]))

    @property
    def unit_mm(self) -> float:
        """Unit of length on the target in the homographies' numbers: from its centre to its corner."""
        return float(np.hypot(*self.grid.whole_mm) / 2)

    def matrix(self, numbers: Numbers, station: int) -> Numbers:
        """Return the homography (3, 3) from mm on the target to mm on the sensor, before distortion."""
        return np.asarray(
            matrices(numbers[self.homography(station)][None], self.unit_mm)[0]
        )

    def corners_mm(self, numbers: Numbers) -> Numbers:
        """Return the corners (n, 4, 2) of the homography nearest to each tile's image."""
        flat = self._pinhole(numbers, np.zeros(len(BEND)))
        printed = self._pinhole(numbers, numbers[self.shared][list(BEND)])
        moved = distorted(printed, numbers[self.shared])
        own = self._colours(numbers)
        away = moved * (1 + own[..., :1]) + own[..., 1:] - flat
        inside = away[:, len(CORNERS) :].reshape(len(away), -1)
        corners = (inside @ corners_by_nodes().T).reshape(-1, *CORNERS.shape)
        return np.asarray(flat[:, : len(CORNERS)] + corners)

    @cached_property
    def stations(self) -> Integers:
        """(n,) station of each observation."""
        return np.array([self.ranges_mm.index(p.key.range_mm) for p in self.places])

    @cached_property
    def channel_numbers(self) -> Integers:
        """(n,) channel of each observation."""
        return np.array([self.channels.index(p.key.channel) for p in self.places])

    @cached_property
    def target_mm(self) -> Floats:
        """(n, 4 + nodes, 2) corners and nodes of each observation's tile on the target."""
        within = np.concatenate([CORNERS, nodes()])
        return np.stack([self.grid.places_mm(p.tile, within) for p in self.places])

    @cached_property
    def from_middle_mm(self) -> Floats:
        """(n, 4 + nodes, 2) the same from the middle of the tile."""
        middles = self.target_mm[:, :4].mean(axis=1, keepdims=True)
        return np.asarray(self.target_mm - middles)

    def _pinhole(self, numbers: Numbers, bend: Numbers) -> Numbers:
        """Return the pinhole's image (n, points, 2) of a print with curvatures `bend`."""
        count = HOMOGRAPHY * len(self.ranges_mm)
        by_station = matrices(numbers[:count].reshape(-1, HOMOGRAPHY), self.unit_mm)
        growth = numbers[self.shared][TILE_GROWTH[0]]
        ones = np.ones((*self.target_mm.shape[:2], 1))
        printed = self.target_mm + growth * self.from_middle_mm
        places = np.concatenate([printed, ones], axis=2)
        image = places @ by_station[self.stations].swapaxes(1, 2)
        behind = sag_mm(self.target_mm, bend) / self.distances_mm[self.stations][:, None]
        return image[..., :2] / (image[..., 2] + behind)[..., None]

    def _colours(self, numbers: Numbers) -> Numbers:
        """Return the numbers (n, 1, 3) of each observation's channel."""
        own = np.concatenate([np.zeros(CHANNEL_NUMBERS), numbers[self.shared.stop :]])
        return own.reshape(-1, CHANNEL_NUMBERS)[self.channel_numbers][:, None]


def matrices(numbers: Numbers, unit_mm: float) -> Numbers:
    """Return homographies (n, 3, 3) from mm on the target by numbers (n, 8) in a unit of length on the target."""
    last = np.ones((len(numbers), 1))
    by_unit = np.concatenate([numbers, last], axis=1).reshape(-1, 3, 3)
    return np.asarray(by_unit / np.array([unit_mm, unit_mm, 1.0]))


def sag_mm(target_mm: Floats, bend: Numbers) -> Numbers:
    """Return how far places (..., 2) of a bent print are behind its plane, by curvatures (3,) 1/mm: yy, xx, yx."""
    y = target_mm[..., 0]
    x = target_mm[..., 1]
    return np.asarray(bend[0] * y * y / 2 + bend[1] * x * x / 2 + bend[2] * y * x)


def distorted(at_mm: Numbers, shared: Numbers) -> Numbers:
    """Return places (..., 2) after the lens's distortion, by the shared numbers."""
    square = (at_mm * at_mm).sum(axis=-1, keepdims=True)
    decentre = shared[list(DECENTRE)]
    along = (at_mm @ decentre)[..., None]
    radial = 1 + shared[RADIAL[0]] * square + shared[FIFTH[0]] * square**2
    return np.asarray(at_mm * (radial + 2 * along) + decentre * square)
