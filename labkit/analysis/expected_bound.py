"""Errors to be expected of photographs that are not taken yet: what a channel's pixels will say of its wavefront and cone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from labkit.imaging.model import ForwardModel, Optics
from labkit.imaging.warp import Pose
from labkit.inference.bounds import parameter_names
from labkit.inference.cone import Measured, expand
from labkit.inference.fisher_scoring import NoisePrior, Problem, Start, State
from labkit.inference.identifiability import Bound, bound_of
from labkit.inference.likelihood import FrameData
from labkit.plan import Channel, Plan
from labkit.target import Target
from labkit.types import Floats

READ_ELECTRONS = 3.0
WAVES_RMS = 0.05  # of every other mode together: a usual lens
LEAST_DEFOCUS_WAVES = 0.01  # where there is none at all, a little of it changes a picture in second order only
TURN_RAD = 0.02  # of the target: no pixel row lies along a row of cells
SURROUND = 1.2  # side of the frame, in sides of the target


@dataclass(frozen=True)
class ExpectedFit:
    """What photographs will say. bound: of all parameters, modes first, the cone known; measured: as a session takes it."""

    bound: Bound
    measured: Measured

    def scaled(self, factor: float) -> ExpectedFit:
        """With standard errors times a factor."""
        bound = replace(self.bound, covariance=self.bound.covariance * factor**2)
        return ExpectedFit(bound, replace(self.measured, covariance=self.measured.covariance * factor**2))


def expected_fit(
    plan: Plan,
    target: Target,
    channel: Channel,
    *,
    f_number: float,
    side_px: float,
    defocus_waves: float,
    electrons: float,
) -> ExpectedFit:
    """What one photograph of the target will say; flats' errors are not in it.

    f_number: of the cone that reaches the sensor; side_px: of the target; defocus_waves: RMS, at the reference wavelength;
    electrons: at white.
    """
    first, last = plan.fit.zernike_noll
    noll = tuple(range(first, last + 1))
    optics = Optics(
        wavelength_um=channel.wavelength_nm * 1e-3,
        reference_um=plan.reference_wavelength_nm * 1e-3,
        f_number=f_number,
        pitch_um=plan.sensor.pixel_pitch_um,
        active_um=plan.sensor.active_um,
        noll=noll,
    )
    side = ceil(SURROUND * side_px / 2) * 2
    ones = np.ones((side, side))
    frame = FrameData(0 * ones, plan.sensor.pixels(channel.name).mask((side, side)), ones, 0 * ones)
    noise = NoisePrior(1.0, 0.02, READ_ELECTRONS**2, 0.1)
    pose = _pose(side_px, side, target)
    state = State(_waves(noll, defocus_waves), (pose,), np.array([electrons]), np.zeros(1), noise.centre)
    problem = Problem(ForwardModel.build(optics, target, (side, side), pose), (frame,), noise)
    expansion = expand(problem, Start(state))
    held = np.delete(np.arange(len(expansion.information)), len(noll))  # all but the cone
    bound = bound_of(expansion.information[np.ix_(held, held)], parameter_names(state, noll))
    return ExpectedFit(bound, expansion.measured())


def _waves(noll: tuple[int, ...], defocus_waves: float) -> Floats:
    waves = np.full(len(noll), WAVES_RMS / np.sqrt(len(noll)))
    if noll[0] == 4:
        waves[0] = defocus_waves if abs(defocus_waves) > LEAST_DEFOCUS_WAVES else LEAST_DEFOCUS_WAVES
    return waves


def _pose(side_px: float, frame_px: int, target: Target) -> Pose:
    """The target in the middle of a frame, a little turned and a third of a pixel off."""
    half = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * side_px / 2
    cos, sin = np.cos(TURN_RAD), np.sin(TURN_RAD)
    return Pose.from_corners(half @ np.array([[cos, -sin], [sin, cos]]) + (frame_px - 1) / 2 + 0.3, target.size_mm)
