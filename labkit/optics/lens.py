"""First-order optics: where the light meets, how defocus runs with range, how large the blur is (thesis, Appendix E)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from labkit.arrays import positive, real_array
from labkit.types import Floats

Convention = Literal["corrected", "thesis"]

PV_PER_RMS = np.sqrt(
    12.0
)  # a defocus of unit peak-to-valley over a disc has an RMS of 1/sqrt(12)

USUAL_LOG_MAGNIFICATION = 0.7
"""Prior standard error of the logarithm: pupil magnifications of lenses lie between 0.5 and 2."""

TELLING_STD = 0.1
"""Largest standard error of a pupil magnification that tells lenses apart, which lie between 0.5 and 2."""


@dataclass(frozen=True, slots=True)
class ThinLens:
    """A lens by its focal length (mm), f-number at infinity, and pupil magnification Dout/Din. Arrays in their
    place stand for many lenses, and broadcast with ranges."""

    focal_length_mm: float
    f_number: float
    pupil_magnification: float = 1.0

    def __post_init__(self) -> None:
        least = np.minimum(
            np.minimum(self.focal_length_mm, self.f_number), self.pupil_magnification
        )
        if not np.all(least > 0):
            raise ValueError(
                f"focal length, f-number and pupil magnification must be positive: {self}"
            )

    @property
    def exit_pupil_mm(self) -> float:
        """Diameter of the exit pupil, mm."""
        return self.pupil_magnification * self.focal_length_mm / self.f_number

    def image_distance_mm(self, range_mm: Floats | float) -> Floats:
        """Return the distance behind the rear principal plane where a range comes to focus, mm. Thesis (E.1).

        Raises ValueError for a range not beyond the focal length.
        """
        range_mm = real_array("range_mm", range_mm, None, "mm")
        if np.any(range_mm <= self.focal_length_mm):
            raise ValueError(
                f"range must exceed the focal length, {self.focal_length_mm:g} mm: {range_mm}"
            )
        return range_mm * self.focal_length_mm / (range_mm - self.focal_length_mm)

    def focused_magnification(self, focus_mm: Floats | float) -> Floats:
        """Return the size of the image over the object's, unitless, at the best focus of a range: f / (r - f)."""
        return np.asarray(self.image_distance_mm(focus_mm) / np.asarray(focus_mm))

    def working_f_number(self, focus_mm: Floats | float) -> Floats:
        """Return the working f-number of a lens focused at a range: N (1 + m0 / mp), whatever the target's
        range.
        """
        return self.f_number * (
            1 + self.focused_magnification(focus_mm) / self.pupil_magnification
        )

    def chief_ray_scale(
        self, target_mm: Floats | float, focus_mm: Floats | float
    ) -> Floats:
        """Return the size of the image over the target's, unitless, for a target at one range and focus at
        another.

        Chief rays go through the pupils' centres, so blur changes no size. target_mm,
        focus_mm: broadcast together.
        """
        f = self.focal_length_mm
        mp = self.pupil_magnification
        from_entrance_mm = real_array("target_mm", target_mm, None, "mm") - f + f / mp
        return np.asarray(self.pupil_to_image_mm(focus_mm) / (mp * from_entrance_mm))

    def in_colour(self, focus_mm: Floats | float, reference_mm: Floats | float) -> ThinLens:
        """Return the lens in a colour that focuses at focus_mm where this lens focuses at reference_mm.

        Both share sensor and aperture. The sensor is where this lens focuses reference_mm,
        so the colour's focal length brings focus_mm to the same place. focus_mm,
        reference_mm: broadcast together.
        """
        focal_mm = 1 / (1 / self.image_distance_mm(reference_mm) + 1 / np.asarray(focus_mm))
        f_number = self.f_number * focal_mm / self.focal_length_mm
        return ThinLens(
            cast(float, focal_mm), cast(float, f_number), self.pupil_magnification
        )

    def pupil_to_image_mm(
        self, range_mm: Floats | float, convention: Convention = "corrected"
    ) -> Floats:
        """Return the distance from the exit pupil to the image of a range, mm.

        Thesis (E.2); (4.40) prints the sign of (mp-1) wrong.
        """
        offset = (self.pupil_magnification - 1.0) * self.focal_length_mm
        return self.image_distance_mm(range_mm) + (
            offset if convention == "corrected" else -offset
        )


def defocus_waves(
    lens: ThinLens,
    target_mm: Floats | float,
    focus_mm: Floats | float,
    reference_nm: float,
    convention: Convention = "corrected",
) -> Floats:
    """Return the RMS defocus of a target at one range, focus at another, in waves at the reference wavelength.

    The defocus is positive for a target beyond best focus. target_mm, focus_mm: ranges,
    broadcast together. Thesis (4.40), with the sagitta about the exit pupil as in (E.2) and
    (E.9), unless convention is "thesis".
    """
    positive("reference_nm", reference_nm, "nm")
    half_squared = (lens.exit_pupil_mm / 2.0) ** 2
    path_mm = _sagitta_mm(lens.pupil_to_image_mm(target_mm, convention), half_squared)
    path_mm = path_mm - _sagitta_mm(
        lens.pupil_to_image_mm(focus_mm, convention), half_squared
    )
    return np.asarray(path_mm / PV_PER_RMS / (reference_nm * 1e-6))


def _sagitta_mm(radius_mm: Floats, half_squared: float) -> Floats:
    """Return R - sqrt(R^2 - h^2) of a wave over its pupil, without loss of digits."""
    return np.asarray(half_squared / (radius_mm + np.sqrt(radius_mm**2 - half_squared)))


def blur_per_wave_um(f_number: float, reference_um: float) -> float:
    """Return the diameter of the geometric blur on the sensor, um, for one wave RMS of defocus.

    A defocus of W peak to valley makes a circle 8 N W wide: it moves the focus by 8 N^2 W
    in a beam of f-number N.

    Parameters
    ----------
    f_number : working f-number N
    reference_um : wavelength of the unit of defocus
    """
    return float(8 * f_number * PV_PER_RMS * reference_um)


def circle_of_confusion_mm(
    lens: ThinLens, target_mm: Floats | float, focus_mm: Floats | float
) -> Floats:
    """Return the diameter on the sensor of the geometric blur of a point. Thesis (E.9)."""
    image = lens.image_distance_mm(target_mm)
    focus = lens.image_distance_mm(focus_mm)
    return np.asarray(
        lens.exit_pupil_mm * np.abs(focus - image) / lens.pupil_to_image_mm(target_mm)
    )


def ground_sample_mm(
    lens: ThinLens, range_mm: Floats | float, pixel_pitch_um: float
) -> Floats:
    """Return the width of one pixel on a target at a range, mm. Thesis (2.35)."""
    range_mm = real_array("range_mm", range_mm, None, "mm")
    positive("pixel_pitch_um", pixel_pitch_um, "um")
    return np.asarray(
        (range_mm - lens.focal_length_mm) * pixel_pitch_um * 1e-3 / lens.focal_length_mm
    )
