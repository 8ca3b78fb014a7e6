"""Errors to be expected of photographs that are not taken yet: what a channel's pixels will say of its wavefront and cone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, sqrt

import numpy as np

from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.inference.cone import Measured, expand
from labkit.inference.fisher_scoring import NoisePrior, Problem, Start, State
from labkit.inference.identifiability import Bound, bound_of
from labkit.inference.likelihood import FrameData
from labkit.inference.parameter_names import parameter_names
from labkit.plan import Channel, Plan, Sensor
from labkit.target import Target
from labkit.types import Bools, Floats

READ_ELECTRONS = 3.0
WAVES_RMS = 0.05  # of every other mode together: a usual lens
LEAST_DEFOCUS_WAVES = 0.01  # where there is none at all, a little of it changes a picture in second order only
TURN_RAD = 0.02  # of the target: no pixel row lies along a row of cells
SURROUND = 1.2  # side of the frame, in sides of the target
BAYER = "RGGB"  # where the plan leaves the pattern to the files; other orders of the cell have the same bounds


@dataclass(frozen=True, slots=True)
class Planes:
    """A channel's pixels: (row, col) in a cell that repeats every `period` pixels.

    assumed: what the plan leaves open, in words; None where it states the filter array.
    """

    places: tuple[tuple[int, int], ...]
    period: int
    assumed: str | None = None

    @property
    def spacing_px(self) -> float:
        """Side of the square that each pixel of the channel has for itself."""
        return self.period / sqrt(len(self.places))

    def mask(self, side: int) -> Bools:
        """(side, side) True for the channel's pixels."""
        mask = np.zeros((side, side), dtype=bool)
        for row, col in self.places:
            mask[row :: self.period, col :: self.period] = True
        return mask


def planes_of(sensor: Sensor, name: str) -> Planes:
    """The planes of the channel `name`: one for R and B of a Bayer cell, two for G, every pixel of a mono sensor."""
    pattern, assumed = sensor.cfa_pattern, None
    if pattern is None:
        mono = name not in BAYER
        what = (
            "a mono sensor" if mono else "a Bayer filter array: a quarter of the pixels red, half green, a quarter blue"
        )
        pattern, assumed = "mono" if mono else BAYER, f"sensor.cfa_pattern is left to the files; assumed is {what}"
    if pattern in ("mono", "RGB"):  # in colours each has every pixel
        return Planes(((0, 0),), 1, assumed)
    return Planes(tuple(divmod(place, 2) for place, colour in enumerate(pattern) if colour == name), 2, assumed)


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
    frame = FrameData(0 * ones, planes_of(plan.sensor, channel.name).mask(side), ones, 0 * ones)
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
