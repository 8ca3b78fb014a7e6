"""Coarse photographs: pixels binned, and light of a longer wavelength.

A strong wavefront's picture is nearly the geometric blur, which does not depend on the wavelength. A camera with pixels and a
wavelength several times as large sees the same blur with fewer waves of aberration, so that its likelihood has fewer optima,
and costs less time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.estimation.climb import NoisePrior, State
from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import Views, first_state
from labkit.estimation.settings import SETTINGS
from labkit.estimation.starts import Sketches, fitted_light
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.target.target import Target
from labkit.types import Bools, Floats


@dataclass(frozen=True, eq=False)
class Coarse:
    """The first frame of a station as a coarser camera would take it.

    Attributes
    ----------
    sketch : the frame with its model
    pixels : pixels of the frame along a side of a coarse pixel
    """

    sketch: Sketches
    pixels: int

    @classmethod
    def of(cls, optics: Optics, target: Target, views: Views, width_airy: float) -> Coarse:
        """Return a station's first frame with pixels about `width_airy` wide, lambda N."""
        pixels = max(1, round(width_airy * optics.airy_um / optics.pitch_um))
        width_um = pixels * optics.pitch_um
        longer = max(1.0, width_um / optics.airy_um / SETTINGS.coarse_pixel_airy)
        sketch = Sketches(
            replace(
                optics,
                wavelength_nm=optics.wavelength_nm * longer,
                pitch_um=width_um,
                active_um=width_um - optics.pitch_um + optics.active_um,
                # blurs of the camera are narrower than a coarse pixel
                parts=tuple(part for part in optics.parts if part.of_rim),
                given=tuple(part for part in optics.given if part.of_rim),
            ),
            target,
            _binned(views.frames[0], pixels),
            _binned_pose(views.poses[0], pixels),
            _binned_noise(views.noise, pixels),
        )
        return cls(sketch, pixels)

    def state(self, waves: Floats, pose: Pose | None = None) -> State:
        """Return the state of a wavefront, its light fitted. pose: in the frame's pixels; None for the approximate pose."""
        sketch = self.sketch
        at = sketch.pose if pose is None else _binned_pose(pose, self.pixels)
        first = first_state(sketch.frame, at, sketch.noise, waves.size)
        return fitted_light(sketch.wide, replace(first, waves=waves))[1]

    def pose(self, state: State) -> Pose:
        """Return the pose of a state in the frame's pixels."""
        (pose,) = state.poses
        middle = (self.pixels - 1) / 2
        return _scaled(pose, self.pixels).shifted(-middle, -middle)


def _binned(frame: FrameData, pixels: int) -> FrameData:
    """Return a frame of means over squares of pixels; squares with less than half of the most used pixels are not used."""
    if pixels == 1:
        return frame
    rows, columns = (count // pixels for count in frame.counts.shape)

    def squares(values: Floats | Bools) -> Floats | Bools:
        cut = values[: rows * pixels, : columns * pixels]
        return cut.reshape(rows, pixels, columns, pixels)

    counted = squares(frame.used).sum(axis=(1, 3))

    def mean(values: Floats) -> Floats:
        total = squares(np.where(frame.used, values, 0.0)).sum(axis=(1, 3))
        return np.asarray(total / np.maximum(counted, 1))

    used = 2 * counted >= counted.max()
    return FrameData(
        mean(frame.counts),
        used,
        np.where(used, mean(frame.illumination), 1.0),
        mean(frame.relative_std) / pixels,
        rounding=mean(frame.rounding) / pixels**2
        if frame.rounding.size
        else frame.rounding,
    )


def _binned_noise(noise: NoisePrior, pixels: int) -> NoisePrior:
    return replace(
        noise,
        gain=noise.gain / pixels**2,
        read_variance=noise.read_variance / pixels**2,
    )


def _binned_pose(pose: Pose, pixels: int) -> Pose:
    middle = (pixels - 1) / 2
    return _scaled(pose.shifted(middle, middle), 1 / pixels)


def _scaled(pose: Pose, factor: float) -> Pose:
    """Return a pose in pixels of which a pixel has `factor` along each side."""
    return replace(pose, v=pose.v * np.r_[np.full(6, factor), 1.0, 1.0])
