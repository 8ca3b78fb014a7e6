"""Frames of one channel at one range, of the whole target or of one of its tiles: the input of the estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData
from labkit.imaging.warp import Pose
from labkit.key import Key, Tile
from labkit.optics.field import FieldFrame, centre_px
from labkit.types import Floats


@dataclass(frozen=True)
class Observation:
    """Frames of one channel at one range, cut to the target or to one of its tiles, and the place of the cut.

    Attributes
    ----------
    range_mm : planned range, which names the observation
    measured_range_mm : range by the rail's scale if the rail has one, else the planned range
    channel : name of the channel
    names : names of the files
    frames : counts, with calibration
    poses : pose of the target in each frame, in pixels of the cut, right to about a pixel
    noise : calibrated noise
    places : (row, column) of the channel's planes in the cut
    period : pixels after which each plane repeats
    origin_px : (row, column) of the cut's first pixel in the raw image
    homings : for each frame, how often the rail had been homed; empty if not recorded
    order : place of the first photograph in the session
    tile : (row, column) of the tile; None for a target that is whole
    photograph_px : (rows, columns) of the raw image, where it is tiled
    """

    range_mm: float | None
    measured_range_mm: float | None
    channel: str
    names: tuple[str, ...]
    frames: tuple[FrameData, ...]
    poses: tuple[Pose, ...]
    noise: NoisePrior
    places: tuple[tuple[int, int], ...]
    period: int
    origin_px: tuple[int, int] = (0, 0)
    homings: tuple[int, ...] = ()
    order: int = 0
    tile: Tile | None = None
    photograph_px: tuple[int, int] = (0, 0)

    @property
    def key(self) -> Key:
        """Identity of the observation and of its wavefront."""
        return Key(self.range_mm, self.channel, self.tile)

    @cached_property
    def place(self) -> tuple[float, float]:
        """(y, x) of the tile's middle from the middle of the raw image, over half its diagonal; (0, 0) without tiles."""
        if self.tile is None:
            return 0.0, 0.0
        middle = centre_px(np.array(self.corners_px), self.origin_px, self.shape)
        y, x = FieldFrame(self.photograph_px).relative(middle)
        return float(y), float(x)

    @property
    def tile_place(self) -> tuple[float, float] | None:
        """The place of a tile; None without tiles."""
        return None if self.tile is None else self.place

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the cut."""
        rows, columns = self.frames[0].counts.shape
        return rows, columns

    @property
    def corners_px(self) -> tuple[Floats, ...]:
        """Target corners (4, 2) in each frame as (row, column) in pixels of the raw image, in the target's order."""
        return tuple(pose.corners_px() + np.array(self.origin_px) for pose in self.poses)
