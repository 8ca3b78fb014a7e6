"""Lens, light, sensor and camera parts that a plan states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.imaging.aperture import Aperture
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, ThinLens
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.uncertain import Uncertain


def optics_of(plan: Plan, channel: str) -> Optics:
    """Return light, sensor and lens of a plan's channel, with the engraved f-number."""
    light = next(c for c in plan.channel if c.name == channel)
    stated = [
        found for part in KNOWN.values() if (found := part.stated(plan, light)) is not None
    ]
    return Optics(
        wavelength_um=light.wavelength_nm * 1e-3,
        reference_um=plan.reference_wavelength_nm * 1e-3,
        f_number=plan.lens.f_number,
        pitch_um=plan.sensor.pixel_pitch_um,
        active_um=plan.sensor.active_um,
        noll=plan.fit.noll,
        spectrum=None
        if light.spectrum is None
        else Spectrum.of_samples(*light.samples, light.wavelength_nm),
        parts=tuple(part for part, fitted in stated if fitted),
        given=tuple(part for part, fitted in stated if not fitted),
        panel=Aperture.wanted(plan),
    )


def wanted_parts(plan: Plan) -> list[str]:
    """Return the names of the parts that a plan requests to fit, in any channel."""
    return list(
        dict.fromkeys(
            part.name for c in plan.channel for part in optics_of(plan, c.name).parts
        )
    )


def engraved_cone(plan: Plan, ranges_mm: Sequence[float]) -> Uncertain:
    """Return the working f-number, by the engraving, of a lens focused on the mean of some ranges.

    The standard error includes the unknown pupil magnification.
    """
    lens, stated = (
        ThinLens(plan.lens.focal_length_mm, plan.lens.f_number),
        plan.lens.stated_f_number,
    )
    cone = (
        float(lens.working_f_number(float(np.mean(ranges_mm))))
        if ranges_mm
        else lens.f_number
    )
    pupils = (cone / lens.f_number - 1) * USUAL_LOG_MAGNIFICATION
    return Uncertain(cone, cone * float(np.hypot(stated.std / lens.f_number, pupils)))
