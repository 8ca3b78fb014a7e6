"""Numbers of lens, target and rail that a plan states, each with a standard error."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.optics.lens import Convention
from labkit.plan import Plan
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
    convention : law of defocus, see `labkit.optics.lens.defocus_waves`
    """

    focal_length: Uncertain
    f_number: Uncertain
    size_std: float
    range_std_mm: float
    range_zero_std_mm: float
    homing_std_mm: float
    wavelength_std: dict[str, float]
    reference_nm: float
    convention: Convention = "corrected"

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
            convention=plan.fit.convention,
        )
