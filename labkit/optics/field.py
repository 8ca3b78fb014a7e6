"""The wavefront over the field: a double Zernike expansion, in the place on the sensor and in the pupil.

W(H; ρ) = Σ c_kj Z_k(H / H_max) Z_j(ρ), both in Noll's order (Kwee and Braat, Pure Appl. Opt. 2, 21 (1993)). H is a
place on the sensor in mm from the frame's centre, x along the rows to the right, y down, as in the pupil; H_max is half the
frame's diagonal. Noll 4 is defocus where the reference channel is in best focus in the middle of the frame: its terms with
k > 1 are the shape of the focal surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import ArrayLike

from labkit.arrays import real_array
from labkit.optics.lens import blur_per_wave_um
from labkit.optics.rim import ROUND_EVERYWHERE, FieldRim, Rim
from labkit.optics.wavefront import DEFOCUS, FittedWavefront
from labkit.optics.zernike import modes_at
from labkit.plan import leading_channel
from labkit.types import Floats
from labkit.uncertain import Uncertain


@dataclass(frozen=True)
class FieldFrame:
    """The frame of a sensor: the coordinates of the field.

    Parameters
    ----------
    shape_px : (rows, columns) of the raw image
    pixel_pitch_um : of the raw's pixels; nan where lengths are not needed
    """

    shape_px: tuple[int, int]
    pixel_pitch_um: float = nan

    @property
    def centre_px(self) -> Floats:
        """(row, column) of the frame's centre; pixel centres are at integers."""
        return (np.array(self.shape_px) - 1) / 2

    @property
    def radius_mm(self) -> float:
        """Half the frame's diagonal, the unit of the field's polynomials."""
        return self.radius_px * self.pixel_pitch_um * 1e-3

    @property
    def radius_px(self) -> float:
        """The same in pixels."""
        return float(np.hypot(*self.shape_px) / 2)

    def relative(self, places_px: ArrayLike) -> Floats:
        """Return the places (..., 2), y and x from the centre, in units of the radius."""
        return np.asarray((np.asarray(places_px, float) - self.centre_px) / self.radius_px)

    def heights_mm(self, places_px: ArrayLike) -> Floats:
        """Return (..., 2) image heights (y down, x right) in mm from the centre, of places (..., 2) as (row, column)."""
        away = np.asarray(places_px, float) - self.centre_px
        return np.asarray(away * self.pixel_pitch_um * 1e-3)

    def places_px(self, heights_mm: ArrayLike) -> Floats:
        """Return the places (..., 2) of image heights (..., 2)."""
        return np.asarray(heights_mm, float) / (self.pixel_pitch_um * 1e-3) + self.centre_px

    def polynomials(self, field: Sequence[int], places_px: ArrayLike) -> Floats:
        """Return the field's Zernike polynomials (terms, ...) at places (..., 2); the corners are at radius 1."""
        at = self.relative(places_px)
        return modes_at(tuple(field), at[..., 1], at[..., 0])


def centre_px(
    corners_px: Floats, origin_px: tuple[int, int], shape_px: tuple[int, int]
) -> Floats:
    """Return the (row, column) of a tile's middle.

    Of a target that a cut holds, where its diagonals cross, as a mean over photographs; of a part of a target, the middle of
    the cut.

    Parameters
    ----------
    corners_px : (frames, 4, 2) of the target, in pixels of the raw image
    origin_px, shape_px : of the cut
    """
    origin, shape = np.array(origin_px), np.array(shape_px)
    away = corners_px - origin
    if np.any(away < -0.5) or np.any(away > shape - 0.5):
        return np.asarray(origin + (shape - 1) / 2)
    first, second, third, last = np.moveaxis(_homogeneous(away), 1, 0)
    middle = np.cross(np.cross(first, third), np.cross(second, last))
    return np.asarray(origin + np.mean(middle[:, :2] / middle[:, 2:], axis=0))


def _homogeneous(places: Floats) -> Floats:
    """Return places (..., 2) with a third coordinate, 1."""
    return np.append(places, np.ones((*places.shape[:-1], 1)), axis=-1)


def field_terms(order: int) -> tuple[int, ...]:
    """Return Noll's numbers of the field's polynomials up to a radial order: order 2 has 1 to 6."""
    return tuple(range(1, (order + 1) * (order + 2) // 2 + 1))


@dataclass(frozen=True, eq=False)
class FieldModel:
    """The wavefront of each channel at every place of the frame, with errors.

    Parameters
    ----------
    frame : coordinates
    channels : names
    field : Noll's numbers of the field's polynomials, from 1
    noll : Noll's numbers of the pupil's modes, with 4
    waves : (channels, field terms, modes) coefficients, waves RMS at the reference wavelength
    covariance : of `waves.ravel()`
    wavelengths_nm : (channels,)
    reference_nm : of the unit of waves
    f_number, f_number_std : of the cone at the sensor
    scale_std : (channels,) relative standard errors of lambda N; empty for that of the f-number
    rim : of the pupil, over the frame

    Raises
    ------
    ValueError : arrays of other shapes, or modes without defocus
    """

    frame: FieldFrame
    channels: tuple[str, ...]
    field: tuple[int, ...]
    noll: tuple[int, ...]
    waves: Floats
    covariance: Floats
    wavelengths_nm: tuple[float, ...]
    reference_nm: float
    f_number: float
    f_number_std: float = 0.0
    scale_std: tuple[float, ...] = ()
    rim: FieldRim = ROUND_EVERYWHERE

    def __post_init__(self) -> None:
        shape = (len(self.channels), len(self.field), len(self.noll))
        real_array("waves", self.waves, shape, "waves RMS")
        size = int(np.prod(shape))
        real_array("covariance", self.covariance, (size, size), "waves RMS squared")
        if DEFOCUS not in self.noll or self.field[:1] != (1,):
            raise ValueError("a field needs Noll 4 in the pupil and 1 in the field")

    @property
    def um_per_wave(self) -> float:
        """Shift of focus on the sensor, um, that changes Noll 4 by a wave RMS at the reference wavelength.

        Noll 4 grows where the image moves from the sensor towards the lens, as of a target that goes away.
        """
        blur_um = blur_per_wave_um(self.f_number, 1e-3 * self.reference_nm)
        return self.f_number * blur_um

    def index(self, channel: str, field: int, pupil: int) -> int:
        """Return the place of a coefficient in `waves.ravel()`. Raises ValueError for a missing coefficient."""
        at = (
            self.channels.index(channel),
            self.field.index(field),
            self.noll.index(pupil),
        )
        return int(np.ravel_multi_index(at, self.waves.shape))

    def rows(self, channel: str, places_px: ArrayLike) -> Floats:
        """Return (..., modes, coefficients): the modes at places (..., 2) as linear combinations of `waves.ravel()`."""
        at = np.moveaxis(self.frame.polynomials(self.field, places_px), 0, -1)
        rows = np.zeros((*at.shape[:-1], len(self.noll), *self.waves.shape))
        for mode in range(len(self.noll)):
            rows[..., mode, self.channels.index(channel), :, mode] = at
        return rows.reshape(*rows.shape[: -self.waves.ndim], -1)

    def modes(self, channel: str, places_px: ArrayLike) -> tuple[Floats, Floats]:
        """Return the modes (..., modes), waves RMS, at places (..., 2), and their covariances (..., modes, modes)."""
        at = np.moveaxis(self.frame.polynomials(self.field, places_px), 0, -1)
        own = self.channels.index(channel)
        # rows would hold the other channels' coefficients too, times zero
        covariance = self.covariance.reshape(self.waves.shape * 2)[own, :, :, own]
        half = np.tensordot(at, covariance, 1)
        return at @ self.waves[own], np.einsum("...jkl,...k->...jl", half, at)

    @property
    def leading(self) -> str:
        """The channel whose focal surface stands for all: green if present, else the first."""
        return leading_channel(self.channels)

    @property
    def sensor_tilt(self) -> tuple[Floats, Floats]:
        """(2,) slopes of the sensor over its image along y and x, um/mm, and their covariance (2, 2).

        The best plane over the frame: positive where the sensor lies farther behind the image at larger y or x.
        """
        places = [self.index(self.leading, k, DEFOCUS) for k in (3, 2)]
        # Noll 2 and 3 are 2ρ cos θ and 2ρ sin θ
        scale = 2 * self.um_per_wave / self.frame.radius_mm
        return scale * self.waves.ravel()[places], scale**2 * self.covariance[
            np.ix_(places, places)
        ]

    @property
    def curvature(self) -> Uncertain:
        """Distance of the sensor behind its image over the square of the image height, mm/mm²: the field's Noll 4."""
        at = self.index(self.leading, 4, DEFOCUS)
        # Noll 4 is √3 (2ρ² - 1)
        scale = 2 * np.sqrt(3) * 1e-3 * self.um_per_wave / self.frame.radius_mm**2
        std = float(scale * np.sqrt(self.covariance[at, at]))
        return Uncertain(float(scale * self.waves.ravel()[at]), std, "mm/mm²")

    def rim_at(self, place_px: ArrayLike) -> Rim:
        """Return the pupil's rim as seen from a place (row, column)."""
        y, x = self.frame.relative(place_px)
        return self.rim.at((float(y), float(x)))

    def wavefront(
        self, channel: str, place_px: ArrayLike, sensor_um: float = 0.0
    ) -> FittedWavefront:
        """Return the wavefront of a channel at a place (row, column), with the sensor moved away from the lens by some um."""
        waves, covariance = self.modes(channel, place_px)
        waves[..., self.noll.index(DEFOCUS)] += sensor_um / self.um_per_wave
        of_channel = self.channels.index(channel)
        return FittedWavefront(
            self.noll,
            waves,
            covariance,
            self.wavelengths_nm[of_channel],
            self.reference_nm,
            self.f_number,
            self.f_number_std,
            scale_std=self.scale_std[of_channel] if self.scale_std else None,
            rim=self.rim_at(place_px),
        )
