"""The lens in the words of the bench: tilt, curvature, astigmatism and coma over the field, with errors.

All numbers are linear in the double Zernike coefficients, or simple functions of such
numbers, so that their errors follow from the joint covariance. Each is the coefficient of
its own polynomial over the circle around the frame: terms of higher order do not change it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, inf, isfinite, nan, sqrt

import numpy as np

from labkit.field.pair import Pair
from labkit.field.surfaces import BestPlane, Surface, best_plane, um_relative_std
from labkit.field.symmetry import Share, share
from labkit.optics.field import FieldModel
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats
from labkit.uncertain import Uncertain

ARCMIN_PER_UM_PER_MM = 60 * 180 / np.pi * 1e-3

SURFACES: tuple[Surface, ...] = ("medial", "sagittal", "tangential")

Weights = Mapping[tuple[int, int], float]
"""A linear number: weights of coefficients by the Noll modes of field and pupil."""


@dataclass(frozen=True, eq=False)
class SensorTilt:
    """The tilt of the sensor to the lens's focal surface.

    A decentred element tilts the focal surface: the two are the same until the lens or the
    body is turned. The tilt is the slope of the focus error, which is positive where the
    sensor lies behind the image.

    Parameters
    ----------
    slope : um/mm, down and right
    extent_mm : (height, width) of the frame
    """

    slope: Pair
    extent_mm: tuple[float, float]

    @property
    def angle(self) -> Pair:
        """Tilt in arc minutes, down and right."""
        return self.slope.times(ARCMIN_PER_UM_PER_MM, "arcmin")

    @property
    def direction_deg(self) -> Uncertain:
        """Direction in which the sensor recedes from the lens, degrees from right towards down."""
        return self.slope.direction_deg

    @property
    def over_frame(self) -> Uncertain:
        """Peak to valley of the tilted plane over the frame, um, from one corner to the opposite."""
        signs = np.where(self.slope.value < 0, -1.0, 1.0)
        return self._along(signs * self.extent_mm)

    @property
    def across(self) -> dict[str, Uncertain]:
        """Focus error at the end of a line across the frame less that at its start, um."""
        down, right = self.extent_mm
        lines = {
            "left to right": (0.0, right),
            "top to bottom": (down, 0.0),
            "top left to bottom right": (down, right),
            "bottom left to top right": (-down, right),
        }
        return {name: self._along(np.array(line)) for name, line in lines.items()}

    def _along(self, line_mm: Floats) -> Uncertain:
        number = self.slope.along(line_mm)
        return Uncertain(number.value, number.std, "um")


@dataclass(frozen=True, eq=False)
class LensTerms:
    """The terms of one channel. A number whose modes were not fitted is nan.

    Parameters
    ----------
    channel : name
    radius_mm : half the frame's diagonal
    tilt : of the sensor to the focal surface
    curvature : of medial focus, mm for each mm² of image height; positive where the sensor
        lies behind the image at the edge, so that the image bends towards the lens
    sagittal_curvature, tangential_curvature : of the two surfaces, mm for each mm²
    astigmatism : tangential less sagittal curvature, mm for each mm²
    level_at : where the focal surface is level, mm from the frame's centre: the tilt seen
        as a decentre of the curvature, the same numbers in other words
    linear_coma : of the lens with an axis, waves RMS for each mm of image height, positive
        as Noll 8 is at the right edge
    coma : constant over the field, waves RMS, down and right (Noll 7 and 8)
    coma_free_at : where both comas cancel, mm from the frame's centre
    linear_astigmatism : waves RMS for each mm, A: with A = right + i down and H = x + i y,
        Noll 6 + i Noll 5 is A H
    constant_astigmatism : waves RMS, Noll 5 as down, Noll 6 as right
    spherical : mean over the field, waves RMS (Noll 11)
    best_planes : of each focal surface
    misaligned : misalignment of the first order without defocus, RMS over pupil and field
    rest : what neither a lens with an axis nor misalignment of the first order makes
    """

    channel: str
    radius_mm: float
    tilt: SensorTilt
    curvature: Uncertain
    sagittal_curvature: Uncertain
    tangential_curvature: Uncertain
    astigmatism: Uncertain
    level_at: Pair
    linear_coma: Uncertain
    coma: Pair
    coma_free_at: Pair
    linear_astigmatism: Pair
    constant_astigmatism: Pair
    spherical: Uncertain
    best_planes: dict[Surface, BestPlane]
    misaligned: Share
    rest: Share

    @property
    def curvature_radius_mm(self) -> Uncertain:
        """Radius of the medial focal surface at its vertex, mm, positive where the image bends towards the lens."""
        return radius_of(self.curvature)

    def at_corner_um(self, curvature: Uncertain) -> Uncertain:
        """Return a curvature as the focus error at the frame's corners less that at its centre, um."""
        factor = 1e3 * self.radius_mm**2
        return Uncertain(factor * curvature.value, factor * curvature.std, "um")


def radius_of(curvature: Uncertain) -> Uncertain:
    """Return the radius, mm, of a surface by the mm that it bends for each mm² of height."""
    value = curvature.value
    if not (value and isfinite(value)):
        return Uncertain(inf, inf, "mm")
    return Uncertain(1 / (2 * value), curvature.std / (2 * value**2), "mm")


def lens_terms(model: FieldModel, channel: str) -> LensTerms:
    """Return the terms of a channel. Raises ValueError for a channel that the field lacks."""
    of = _Numbers(model, channel)
    radius = model.frame.radius_mm
    square = 2 * sqrt(3) / radius**2  # of Noll 4 in the field, by height squared
    # of the symmetric pair of Noll 5 and 6 with the field's, towards the field's radius
    ring = sqrt(6) / 2 / radius**2
    bent: Weights = {(4, DEFOCUS): square}
    astigmatic: Weights = {(6, 6): ring, (5, 5): ring}
    slope: tuple[Weights, Weights] = (
        {(3, DEFOCUS): 2 / radius},
        {(2, DEFOCUS): 2 / radius},
    )
    coma: tuple[Weights, Weights] = ({(1, 7): 1.0}, {(1, 8): 1.0})
    linear_coma: Weights = {(2, 8): 1 / radius, (3, 7): 1 / radius}
    linear_astigmatism: tuple[Weights, Weights] = (
        {(2, 5): 1 / radius, (3, 6): -1 / radius},
        {(2, 6): 1 / radius, (3, 5): 1 / radius},
    )
    extent = np.array(model.frame.shape_px) * model.frame.pixel_pitch_um * 1e-3
    return LensTerms(
        channel,
        radius,
        SensorTilt(of.pair_um(*slope), (float(extent[0]), float(extent[1]))),
        of.curvature(bent),
        of.curvature(_sum(bent, astigmatic, -1 / sqrt(2))),
        of.curvature(_sum(bent, astigmatic, 1 / sqrt(2))),
        of.curvature(_sum({}, astigmatic, sqrt(2))),
        of.zero(*slope, _sum({}, bent, 2.0)),
        of.number(linear_coma, "waves/mm"),
        of.pair(*coma, "waves"),
        of.zero(*coma, linear_coma),
        of.pair(*linear_astigmatism, "waves/mm"),
        of.pair({(1, 5): 1.0}, {(1, 6): 1.0}, "waves"),
        of.number({(1, 11): 1.0}, "waves"),
        {surface: best_plane(model, channel, surface) for surface in SURFACES},
        share(model, channel, "misaligned"),
        share(model, channel, "rest"),
    )


class _Numbers:
    """Linear numbers of a channel with their covariance."""

    def __init__(self, model: FieldModel, channel: str) -> None:
        if channel not in model.channels:
            known = ", ".join(model.channels)
            raise ValueError(f"the field has no channel {channel}: it has {known}")
        self._model = model
        self._channel = channel

    def number(self, weights: Weights, unit: str) -> Uncertain:
        """Return a number; nan if one of its coefficients was not fitted."""
        value, covariance = self._of(weights)
        return Uncertain(value[0], sqrt(max(covariance[0, 0], 0.0)), unit)

    def curvature(self, weights: Weights) -> Uncertain:
        """Return a number of defocus for each mm² in mm of focus for each mm²."""
        number = self.number(weights, "")
        factor = self._model.um_per_wave * 1e-3
        value = factor * number.value
        cone = um_relative_std(self._model) * value
        return Uncertain(value, hypot(factor * number.std, cone), "mm/mm²")

    def pair(self, down: Weights, right: Weights, unit: str) -> Pair:
        """Return a vector."""
        return Pair(*self._of(down, right), unit)

    def pair_um(self, down: Weights, right: Weights) -> Pair:
        """Return a slope of defocus in um of focus for each mm."""
        of = self.pair(down, right, "waves/mm")
        relative = um_relative_std(self._model)
        return of.times(self._model.um_per_wave, "um/mm", relative)

    def zero(self, down: Weights, right: Weights, slope: Weights) -> Pair:
        """Return the place at which a vector that grows as slope times height is zero, mm from the frame's centre."""
        values, covariance = self._of(down, right, slope)
        if not values[2]:
            return Pair(np.full(2, nan), np.full((2, 2), inf), "mm")
        place = -values[:2] / values[2]
        by = -np.column_stack([np.eye(2), place]) / values[2]
        return Pair(place, by @ covariance @ by.T, "mm")

    def _of(self, *numbers: Weights) -> tuple[Floats, Floats]:
        """Return numbers (k,) and their covariance (k, k)."""
        model = self._model
        rows = np.zeros((len(numbers), model.waves.size))
        known = np.ones(len(numbers), bool)
        for row, weights in enumerate(numbers):
            for (field, pupil), weight in weights.items():
                if field not in model.field or pupil not in model.noll:
                    known[row] = False
                    continue
                rows[row, model.index(self._channel, field, pupil)] += weight
        values = np.where(known, rows @ model.waves.ravel(), nan)
        covariance = rows @ model.covariance @ rows.T
        return values, np.where(np.outer(known, known), covariance, inf)


def _sum(one: Weights, other: Weights, factor: float) -> Weights:
    """Return one number plus another times a factor."""
    keys = {**one, **other}
    return {key: one.get(key, 0.0) + factor * other.get(key, 0.0) for key in keys}
