"""How the simulated lens changes over the frame: focus, aberrations, pupil, light and places.

Places are (down, right) on the sensor, mm from the frame's centre; heights count from the
lens's axis. Modes are Noll's in waves RMS at REFERENCE_NM, in the pupil coordinates of
`optics`. Misaligned lenses follow nodal aberration theory: K. Thompson, J. Opt. Soc. Am. A
22, 1389 (2005).

Written without labkit.optics and labkit.imaging, which it tests.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import atan2, degrees, hypot, sqrt
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.zernike_table import ZernikeTable
from labkit.types import Floats

Pair = tuple[float, float]
"""Down and right."""

MOST_COMA_WAVES = 2.0
MOST_DISTORTION = 0.1
"""Relative change of a place's distance by distortion at the frame's corner."""

LIGHT_RADII = 25
"""Heights at which the pupil's clear share is measured; a spline lies between."""


@dataclass(frozen=True, slots=True)
class FieldTerms:
    """All numbers of a lens that change over the frame; none by default.

    Raises ValueError for impossible numbers.
    """

    axis_mm: Pair = (0.0, 0.0)
    """Place of the lens's axis, from which heights count."""
    field_curvature_per_mm: float = 0.0
    """Focus error of the sensor, mm for each mm² of height squared; positive where the sensor lies behind the image."""
    sensor_tilt_um_per_mm: Pair = (0.0, 0.0)
    """The same, µm for each mm down and right of the frame's centre."""
    coma_waves: Pair = (0.0, 0.0)
    """Coma of a decentred lens, the same everywhere: Noll 7 (down) and 8 (right)."""
    coma_per_mm: float = 0.0
    """Coma along the height, for each mm of height."""
    astigmatism_per_mm: Pair = (0.0, 0.0)
    """Astigmatism of a decentred lens, linear in the height: the decentre's vector, waves for each mm."""
    astigmatism_per_mm2: float = 0.0
    """Astigmatism along the height, for each mm² of height squared."""
    k1_per_mm2: float = 0.0
    """Radial distortion: a place r mm from the centre moves to r (1 + k1 r²)."""
    distortion_centre_mm: Pair = (0.0, 0.0)
    cos4: float = 0.0
    """Share of the fall of light with the fourth power of the cosine of the chief ray's angle: 1 for all."""
    cats_eye_per_mm: Pair | None = None
    """A second circle that cuts the pupil: its shift along the height, for each mm of height, and its radius, in units of the
    opening's radius."""
    table: ZernikeTable | None = None
    """Modes of a rotationally symmetric lens over the field angle."""

    def __post_init__(self) -> None:
        if not hypot(*self.coma_waves) <= MOST_COMA_WAVES:
            raise ValueError(
                f"constant coma has at most {MOST_COMA_WAVES:g} waves RMS, "
                f"not {hypot(*self.coma_waves):g}"
            )
        if not 0 <= self.cos4 <= 1:
            raise ValueError(f"cos4 is 0 (even) to 1, not {self.cos4:g}")
        if self.cats_eye_per_mm and not self.cats_eye_per_mm[1] > 0:
            raise ValueError(
                f"a cat's eye has a radius above 0, not {self.cats_eye_per_mm[1]:g}"
            )

    @property
    def varies(self) -> bool:
        """Return whether the PSF changes over the frame."""
        return (
            replace(
                self,
                axis_mm=(0.0, 0.0),
                k1_per_mm2=0.0,
                distortion_centre_mm=(0.0, 0.0),
                cos4=0.0,
            )
            != FieldTerms()
        )

    def height_mm(self, place_mm: Pair) -> Pair:
        """Return the height of a place: down and right of the axis."""
        return place_mm[0] - self.axis_mm[0], place_mm[1] - self.axis_mm[1]

    def sensor_behind_um(self, place_mm: Pair) -> float:
        """Return how far the sensor lies behind the image of a target at best focus, µm."""
        down, right = self.height_mm(place_mm)
        per_down, per_right = self.sensor_tilt_um_per_mm
        curved = 1e3 * self.field_curvature_per_mm * (down * down + right * right)
        return curved + per_down * place_mm[0] + per_right * place_mm[1]

    def waves(
        self, place_mm: Pair, nm: float, um_per_wave: float, per_tangent_mm: float
    ) -> dict[int, float]:
        """Return the field's share of each mode at a place.

        Parameters
        ----------
        place_mm : (down, right)
        nm : wavelength
        um_per_wave : shift of focus on the sensor for one wave RMS of Noll 4
        per_tangent_mm : height of a chief ray of unit tangent
        """
        height = self.height_mm(place_mm)
        right_down = complex(height[1], height[0])
        decentre = complex(self.astigmatism_per_mm[1], self.astigmatism_per_mm[0])
        coma = complex(self.coma_waves[1], self.coma_waves[0])
        coma += self.coma_per_mm * right_down
        astigmatism = self.astigmatism_per_mm2 * right_down**2 + decentre * right_down
        found = {
            4: self.sensor_behind_um(place_mm) / um_per_wave,
            5: astigmatism.imag,
            6: astigmatism.real,
            7: coma.imag,
            8: coma.real,
        }
        if self.table is not None:
            tangent = abs(right_down) / per_tangent_mm
            azimuth = atan2(height[0], height[1])
            for j, amount in self.table.waves(tangent, azimuth, nm).items():
                found[j] = found.get(j, 0.0) + amount
        return found

    def pupil(self, place_mm: Pair, pupil: Pupil) -> Pupil:
        """Return the pupil that light to a place passes. Raises ValueError where less than a tenth is clear."""
        if self.cats_eye_per_mm is None:
            return pupil
        per_mm, radius = self.cats_eye_per_mm
        down, right = self.height_mm(place_mm)
        eye = per_mm * hypot(down, right), radius, degrees(atan2(down, right))
        return replace(pupil, cats_eye=eye)

    def light(
        self,
        shape_px: tuple[int, int],
        pitch_mm: float,
        pupil: Pupil,
        per_tangent_mm: float,
        some: slice = slice(None),
    ) -> Floats:
        """Return the light on some rows of a sensor of (rows, columns), relative to the axis without a cat's
        eye.
        """
        down, right = (
            (np.arange(count) - (count - 1) / 2) * pitch_mm - at
            for count, at in zip(shape_px, self.axis_mm, strict=True)
        )
        farthest = np.hypot(abs(down).max(), abs(right).max())
        height = np.hypot(down[some, None], right)
        light = np.ones_like(height)
        if self.cos4:
            light += self.cos4 * ((1 + (height / per_tangent_mm) ** 2) ** -2 - 1)
        if self.cats_eye_per_mm is not None:
            radii = np.linspace(0, farthest, LIGHT_RADII)
            at = [(self.axis_mm[0] + radius, self.axis_mm[1]) for radius in radii]
            shares = [self.pupil(place, pupil).clear_share for place in at]
            light *= CubicSpline(radii, shares)(height)
        return np.asarray(light)

    def numbers(self) -> dict[str, Any]:
        """Return all numbers by their names, for the truth; the table by its path."""
        every = {one.name: getattr(self, one.name) for one in fields(self)}
        return every | {"table": None if self.table is None else self.table.path}


@dataclass(frozen=True, slots=True)
class Distortion:
    """Radial distortion about a centre (column, row): a distance r becomes r (1 + k1 r²), pixels."""

    k1_per_px2: float
    centre_px: tuple[float, float]

    def distorted(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return where ideal places (x right, y down) come to lie; broadcast."""
        right, down = x - self.centre_px[0], y - self.centre_px[1]
        grown = 1 + self.k1_per_px2 * (right**2 + down**2)
        return self.centre_px[0] + right * grown, self.centre_px[1] + down * grown

    def straight(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the ideal places of distorted ones; broadcast.

        With q = k1 r² of the distorted place, the ratio s of the distances solves
        s + q s³ = 1. For q < -4/27, far beyond a frame, no ideal place exists.
        """
        right, down = x - self.centre_px[0], y - self.centre_px[1]
        q = np.maximum(self.k1_per_px2 * (right**2 + down**2), LEAST_Q)
        s = 1 - q / (1 + 3 * q)
        for _ in range(MOST_NEWTON_STEPS):
            step = (s + q * s**3 - 1) / (1 + 3 * q * s**2)
            s -= step
            if np.abs(step).max() < STRAIGHT_WITHIN:
                break
        return self.centre_px[0] + right * s, self.centre_px[1] + down * s


MOST_NEWTON_STEPS = 12
STRAIGHT_WITHIN = 1e-7
"""Relative convergence: after a step of this size the error is its square."""

LEAST_Q = -0.14


def um_per_wave(f_number: float, reference_nm: float) -> float:
    """Return the shift of focus, µm, that is one wave RMS of Noll 4: 16 sqrt(3) N² lambda.

    f_number : N of the cone at the sensor
    """
    return 16 * sqrt(3) * f_number**2 * reference_nm * 1e-3
