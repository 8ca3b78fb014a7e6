"""Steps behind a cat's eye: the wavefront moves with the clear part of the pupil.

A picture shows the wavefront about the centre of the clear part. Modes are those over the full pupil, about its own centre:
where steps are straight in modes and in the numbers of the cutting circle, climbs follow a curved valley.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.estimation.climb import State
from labkit.imaging.optics import Optics
from labkit.optics.other_circle import PLANES, moved_over
from labkit.types import Floats

SHORT = 1e-3
"""Share of a step for the derivative along it."""


def carried(begin: State, end: State, optics: Optics, change: Floats) -> State:
    """Bend a straight step so that the wavefront moves with the clear part; to first order nothing changes.

    Parameters
    ----------
    begin, end : before and after the straight step
    optics : before the step
    change : (camera,) of the camera parameters
    """

    def after(share: float) -> Optics:
        return optics.with_camera_parameters(optics.camera_parameters + share * change)

    def moved(waves: Floats, share: float) -> Floats:
        there = after(share)
        wider = optics.f_number / there.f_number
        away = np.subtract(optics.rim.centre, np.multiply(wider, there.rim.centre))
        return moved_over(optics.noll, waves, away, wider)

    planes = np.zeros(PLANES)
    waves = np.concatenate([planes, begin.waves])
    slope = (moved(waves, SHORT) - moved(waves, -SHORT)) / (2 * SHORT)
    bent = moved(np.concatenate([planes, end.waves]) - slope, 1.0)
    poses = tuple(after(1.0).tilted(pose, bent[1:PLANES]) for pose in end.poses)
    return replace(end, waves=bent[PLANES:], poses=poses)
