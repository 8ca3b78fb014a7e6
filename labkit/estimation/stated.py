"""Numbers, lens, light, sensor and camera parts that a plan states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labkit.imaging.optics import Optics
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts import KNOWN
from labkit.optics.lens import USUAL_LOG_MAGNIFICATION, Convention, ThinLens
from labkit.optics.rim import Place
from labkit.optics.spectrum import ONE_WAVELENGTH, Spectrum
from labkit.plan import Channel, Plan
from labkit.uncertain import Uncertain


@dataclass(frozen=True)
class Stated:
    """The plan's numbers with their standard errors, which count as measurements.

    Attributes
    ----------
    focal_length : mm
    f_number : at infinity
    size_std : relative standard error of the target's size
    range_std_mm : standard error of each range relative to the others
    range_zero_std_mm : standard error common to all ranges
    homing_std_mm : standard error of each homing of the rail
    wavelength_std : relative standard error, by channel
    reference_nm : wavelength in which waves are counted
    light_may_be_exact : whether all wavelengths are stated without an error
    convention : law of defocus, see `labkit.optics.lens.defocus_waves`
    field_order : radial order of the field's expansion; None if the session decides
    """

    focal_length: Uncertain
    f_number: Uncertain
    size_std: float
    range_std_mm: float
    range_zero_std_mm: float
    homing_std_mm: float
    wavelength_std: dict[str, float]
    reference_nm: float
    light_may_be_exact: bool = True
    convention: Convention = "corrected"
    field_order: int | None = None

    @classmethod
    def of(cls, plan: Plan) -> Stated:
        """Read the numbers from a plan."""
        size = plan.target.stated_size
        return cls(
            focal_length=plan.lens.stated_focal_length,
            f_number=plan.lens.stated_f_number,
            size_std=size.std / size.value,
            range_std_mm=plan.fit.range_std_mm,
            range_zero_std_mm=plan.fit.range_zero_std_mm,
            homing_std_mm=plan.rail.homing_std_mm if plan.rail else 0.0,
            wavelength_std={
                c.name: c.stated_wavelength.std / c.wavelength_nm for c in plan.channel
            },
            reference_nm=plan.reference_wavelength_nm,
            light_may_be_exact=all(c.may_be_exact for c in plan.channel),
            convention=plan.fit.convention,
            field_order=plan.field.order,
        )


def optics_of(plan: Plan, channel: str, place: Place | None = None) -> Optics:
    """Return light, sensor and lens of a plan's channel, with the nominal f-number; place: of a tile in the frame."""
    light = next(c for c in plan.channel if c.name == channel)
    known = (part.about(ONE_WAVELENGTH, place) for part in KNOWN.values())
    stated = [found for part in known if (found := part.stated(plan, light)) is not None]
    return Optics(
        wavelength_nm=light.wavelength_nm,
        reference_nm=plan.reference_wavelength_nm,
        f_number=plan.lens.f_number,
        pitch_um=plan.sensor.pixel_pitch_um,
        active_um=plan.sensor.active_um,
        noll=plan.fit.noll,
        spectrum=_spectrum(plan, light),
        typical=light.light is not None,
        place=place,
        parts=tuple(part for part, fitted in stated if fitted),
        given=tuple(part for part, fitted in stated if not fitted),
        panel=Aperture.wanted(plan),
    )


def _spectrum(plan: Plan, channel: Channel) -> Spectrum | None:
    """Return the spectrum of a channel's light, as stated in samples or by the light's name; else None."""
    named = plan.named_light(channel.name)
    if named is not None:
        return Spectrum.of_samples(named.nm, named.weights, channel.wavelength_nm)
    if channel.spectrum is None:
        return None
    return Spectrum.of_samples(*channel.samples, channel.wavelength_nm)


def wanted_parts(plan: Plan) -> list[str]:
    """Return the names of the parts that a plan requests to fit, in any channel."""
    return list(
        dict.fromkeys(
            part.name for c in plan.channel for part in optics_of(plan, c.name).parts
        )
    )


def nominal_f_number(plan: Plan, ranges_mm: Sequence[float]) -> Uncertain:
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
