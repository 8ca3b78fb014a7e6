"""The frames of one channel at one range, as the estimate takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData
from labkit.imaging.warp import Pose
from labkit.key import Key
from labkit.types import Floats


@dataclass(frozen=True)
class Observation:
    """The frames of one channel at one range, cut to the target, and where the cut is in them.

    Attributes
    ----------
    range_mm : as planned, which names the observation
    measured_range_mm : as the rail's scale had it, where it has one; else the same
    channel : its name
    names : of the files
    frames : counts with what is known of them
    poses : of the target in each frame, in pixels of the cut, right to about a pixel
    noise : as calibrated
    places : (row, column) of the channel's planes in the cut
    period : pixels after which each plane repeats
    origin_px : (row, column) of the cut's first pixel in the raw
    homings : of each frame, how often the rail had been homed; empty where that was not recorded
    order : of the first photograph in the session
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

    @property
    def key(self) -> Key:
        """The identity of this observation and of its wavefront."""
        return Key(self.range_mm, self.channel)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the cut."""
        rows, columns = self.frames[0].counts.shape
        return rows, columns

    @property
    def corners_px(self) -> tuple[Floats, ...]:
        """Of each frame the target's corners (4, 2) as (row, column) in pixels of the raw, in the target's order."""
        return tuple(pose.corners_px() + np.array(self.origin_px) for pose in self.poses)
