"""Predict the standard errors of a fit before its photographs exist, by the model's Fisher information."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, sqrt

import numpy as np

from labkit.analysis.target_tiles import tiles_along
from labkit.estimation.candidate import Measured
from labkit.estimation.climb import NoisePrior, Problem, Start, State
from labkit.estimation.expansion import expand
from labkit.estimation.identifiability import Bound, bound_of
from labkit.estimation.likelihood import FrameData
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.lens import ThinLens, defocus_waves, ground_sample_mm
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Channel, Plan
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.target.target import Target, open_target
from labkit.types import Floats

EXPECTED_NOISE = NoisePrior(1.0, 0.02, 9.0, 0.1)
"""Counts are electrons; 3 electrons of read noise; both known as well as flats and darks show them."""

EXPECTED_WAVES_RMS = 0.05
"""All modes except defocus together, of a usual lens."""

LEAST_DEFOCUS_WAVES = 0.01
"""Least defocus of an expected fit: at focus a picture depends on defocus in second order only, without Fisher information."""

TURN_RAD = 0.02
SHIFT_PX = 0.3
"""Of the target: no row of pixels is parallel to a row of cells or begins with one."""

DETERMINED_WAVES = 0.01
"""Standard error, waves RMS at the reference wavelength, of a mode that photographs determine."""

SURROUND = 1.2
"""Side of the frame, in sides of the target."""

WIDEST_PX = 160
"""Side of the target in the frame computed; errors of larger ones, up to those that are fitted whole, go as 1/size."""


@dataclass(frozen=True)
class ExpectedFit:
    """The expected result of a fit.

    bound: of all parameters, modes first, the working f-number known; measured: as the
    session's estimate reads fits.
    """

    bound: Bound
    measured: Measured

    def scaled(self, factor: float) -> ExpectedFit:
        """Return the fit with all standard errors multiplied by a factor."""
        return ExpectedFit(
            replace(self.bound, covariance=self.bound.covariance * factor**2),
            replace(self.measured, covariance=self.measured.covariance * factor**2),
        )


@dataclass(frozen=True, slots=True)
class Setup:
    """Plan, lens, target and light of the expected photographs.

    focus_mm: range of best focus; electrons: at white, in one photograph; frames:
    photographs of each range.
    """

    plan: Plan
    lens: ThinLens
    target: Target
    focus_mm: float
    electrons: float
    frames: int

    @classmethod
    def of(cls, plan: Plan, ranges_mm: Sequence[float], electrons: float) -> Setup:
        """Return the setup of a plan, with best focus in the middle of the ranges."""
        lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
        frames = plan.capture_camera.frames_per_range if plan.capture_camera else 1
        return cls(
            plan,
            lens,
            open_target(plan.target),
            middle_mm(ranges_mm, lens),
            electrons,
            frames,
        )

    def side_px(self, range_mm: float) -> float:
        """Return the side of the target in the photograph, pixels."""
        pitch_um = self.plan.sensor.pixel_pitch_um
        return self.plan.target.size_mm / float(
            ground_sample_mm(self.lens, range_mm, pitch_um)
        )

    def tiles(self, range_mm: float) -> int:
        """Return the number of tiles of which a target at a range is fitted, at most."""
        count, _ = tiles_along(self.side_px(range_mm))
        return count**2

    def of_all_tiles(self, fit: ExpectedFit, range_mm: float) -> ExpectedFit:
        """Return the expected fit of a tile with the errors of all tiles together, for the lens that they share."""
        return fit.scaled(1 / sqrt(self.tiles(range_mm)))

    def defocus(self, range_mm: float) -> float:
        """Return the defocus at a range, waves RMS at the reference wavelength."""
        reference_nm = self.plan.reference_wavelength_nm
        return float(defocus_waves(self.lens, range_mm, self.focus_mm, reference_nm))

    def fit(
        self,
        channel: Channel,
        range_mm: float,
        defocus: float,
        noll: tuple[int, ...] | None = None,
    ) -> ExpectedFit:
        """Return the expected fit of one range and channel, of one tile of a large target, without errors of flats.

        Parameters
        ----------
        channel, range_mm : of the photographs
        defocus : waves RMS
        noll : modes in place of the plan's
        """
        _, side_px = tiles_along(self.side_px(range_mm))
        optics = self._optics(channel, noll or self.plan.fit.noll)
        one = self._of_one_photograph(optics, channel, min(side_px, WIDEST_PX), defocus)
        return one.scaled(min(1.0, WIDEST_PX / side_px) / sqrt(self.frames))

    def determined_noll(self, channel: Channel, range_mm: float) -> int:
        """Return the last mode up to which one range determines each mode to `DETERMINED_WAVES`, all of them free.

        Modes join in the session's groups, from Noll 45 downwards; 0 if not even the plan's
        modes are determined.
        """
        first = self.plan.fit.noll[0]
        usual = self.plan.fit.noll[-1]
        lasts = [group.last for group in MODE_GROUPS.values() if group.last > usual]
        for last in (*reversed(lasts), usual):
            noll = tuple(range(first, last + 1))
            bound = self.fit(channel, range_mm, self.defocus(range_mm), noll).bound
            if max(bound.std[: len(noll)]) <= DETERMINED_WAVES:
                return last
        return 0

    def _of_one_photograph(
        self, optics: Optics, channel: Channel, side_px: float, defocus: float
    ) -> ExpectedFit:
        side = ceil(SURROUND * side_px / 2) * 2
        shape = (side, side)
        light = np.ones(shape)
        used = self.plan.sensor.pixels(channel.name).mask(shape)
        frame = FrameData(0 * light, used, light, 0 * light)
        pose = _pose(side_px, side, self.target)
        waves = _waves(optics.noll, defocus)
        state = State(
            waves, (pose,), np.array([self.electrons]), np.zeros(1), EXPECTED_NOISE.centre
        )
        model = ForwardModel.build(optics, self.target, shape, pose)
        expansion = expand(Problem(model, (frame,), EXPECTED_NOISE), Start(state))
        cone = len(optics.noll)
        free = np.delete(np.arange(len(expansion.information)), cone)
        bound = bound_of(
            expansion.information[np.ix_(free, free)], state.parameter_names(optics.noll)
        )
        return ExpectedFit(bound, expansion.measured())

    def _optics(self, channel: Channel, noll: tuple[int, ...]) -> Optics:
        plan = self.plan
        return Optics(
            wavelength_nm=channel.wavelength_nm,
            reference_nm=plan.reference_wavelength_nm,
            f_number=float(self.lens.working_f_number(self.focus_mm)),
            pitch_um=plan.sensor.pixel_pitch_um,
            active_um=plan.sensor.active_um,
            noll=noll,
        )


def middle_mm(ranges_mm: Sequence[float], lens: ThinLens) -> float:
    """Return the range whose image distance is midway between the nearest and the farthest range's."""
    ends = [lens.image_distance_mm(end(ranges_mm)) for end in (min, max)]
    image = float(np.mean(ends))
    return image * lens.focal_length_mm / (image - lens.focal_length_mm)


def _waves(noll: tuple[int, ...], defocus: float) -> Floats:
    waves = np.full(len(noll), EXPECTED_WAVES_RMS / np.sqrt(len(noll)))
    if noll[0] == DEFOCUS:
        waves[0] = defocus if abs(defocus) > LEAST_DEFOCUS_WAVES else LEAST_DEFOCUS_WAVES
    return waves


def _pose(side_px: float, frame_px: int, target: Target) -> Pose:
    """Return a target in the middle of a frame, slightly rotated and shifted."""
    half = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * side_px / 2
    cos, sin = np.cos(TURN_RAD), np.sin(TURN_RAD)
    turned = half @ np.array([[cos, -sin], [sin, cos]])
    return Pose.from_corners(turned + (frame_px - 1) / 2 + SHIFT_PX, target.size_mm)
