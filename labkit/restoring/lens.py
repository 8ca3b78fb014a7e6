"""The lens that a session measured, in each colour, carried to another range (thesis (4.40) corrected)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labkit.analysis.local_fits import optics_of
from labkit.errors import DataError
from labkit.imaging.model import Optics
from labkit.imaging.parts import Diffusion, LowPass, Part, Smear, Veil
from labkit.optics.lens import ThinLens, defocus_waves
from labkit.optics.spectrum import Spectrum
from labkit.results import Results, Wavefront
from labkit.types import Floats

SAME_MM = 0.5  # ranges closer than this are that of the fit


def nearest(results: Results, channel: str, range_mm: float | None) -> Wavefront:
    """The wavefront of a channel that was measured nearest to a range. Raises DataError where the channel was not measured."""
    every = results.of_channel(channel)
    if not every:
        raise DataError(
            f"{results.folder}: no PSF of channel {channel}: measured are {', '.join(results.channels)}; "
            "give one of these with --channel, or --force to take another's"
        )
    if range_mm is None:
        return every[0]
    return min(every, key=lambda w: abs((w.range_mm if w.range_mm is not None else range_mm) - range_mm))


def waves_at(results: Results, wavefront: Wavefront, range_mm: float | None) -> Floats:
    """(modes,) of a wavefront carried to a range: its defocus by the lens's law from where it was measured, the rest as it is.

    Raises DataError where the session tells no law.
    """
    waves, at = wavefront.waves.copy(), wavefront.range_mm
    if range_mm is None or at is None or abs(range_mm - at) < SAME_MM or 4 not in wavefront.noll:
        return waves
    if results.focus is None or wavefront.channel not in results.focus.best_focus_mm:
        raise DataError(
            f"{results.folder}: best focus was not determined, so its lens cannot be carried from {at:g} to {range_mm:g} mm; "
            "give a range that was measured, or fit the photograph's own defocus with --fit-defocus"
        )
    lens, zero = lens_of(results)
    if range_mm + zero <= 1.05 * lens.focal_length_mm:
        raise DataError(f"--range {range_mm:g}: more than the focal length is needed, {lens.focal_length_mm:.4g} mm")
    focus = results.focus[wavefront.channel].value + zero
    law = defocus_waves(
        lens,
        np.array([range_mm, at]) + zero,
        focus,
        results.reference_wavelength_nm,
        results.plan.fit.convention,
    )
    waves[wavefront.noll.index(4)] += float(law[0] - law[1])
    return waves


def lens_of(results: Results) -> tuple[ThinLens, float]:
    """The session's lens, and what its ranges lack to the true ones, mm; the engraved one where none was estimated."""
    plan, lens = results.plan.lens, results.lens
    if lens is None:
        assert results.focus is not None
        return ThinLens(plan.focal_length_mm, plan.f_number, results.focus.pupil_magnification.value), 0.0
    found = ThinLens(lens.focal_length.value, lens.f_number.value, lens.pupil_magnification.value)
    return found, lens.range_zero.value


def optics_for(results: Results, wavefront: Wavefront) -> Optics:
    """Light, cone, pixel and the parts of the camera that the session found."""
    optics = optics_of(results.plan, wavefront.channel)
    found = {key: value.value for key, value in results.model_parts.items()}
    parts = [*optics.given, *_parts(found)]
    width_nm = found.get(f"spectrum.{wavefront.channel}.width_nm")
    spectrum = optics.spectrum
    if width_nm is not None:
        spectrum = Spectrum.of_width((width_nm / wavefront.wavelength_nm) ** 2)
    return replace(
        optics,
        f_number=wavefront.f_number if math.isfinite(wavefront.f_number) else optics.f_number,
        wavelength_um=wavefront.wavelength_nm * 1e-3,
        reference_um=wavefront.reference_wavelength_nm * 1e-3,
        noll=wavefront.noll,
        spectrum=spectrum,
        parts=(),
        given=tuple(parts),
    )


def _parts(found: dict[str, float]) -> list[Part]:
    """Of the numbers that results have of them: roots of what a part counts in, but for a veil's share."""

    def square(part: str, number: str) -> float:
        return found.get(f"{part}.{number}_px", 0.0) ** 2

    parts: list[Part] = []
    for turned in (False, True):
        name = LowPass(turned=turned).name
        if f"{name}.rows_px" in found:
            parts.append(LowPass(square(name, "rows"), square(name, "columns"), turned))
    if "diffusion.sigma_px" in found:
        parts.append(Diffusion(square("diffusion", "sigma")))
    if "smear.rows_px" in found:
        parts.append(Smear(square("smear", "rows"), square("smear", "columns")))
    if "veil.share" in found:
        parts.append(Veil(found["veil.share"]))
    return parts
