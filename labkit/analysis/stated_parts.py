"""The parts of a camera that its plan states, and those that it wants fitted."""

from __future__ import annotations

from dataclasses import replace

from labkit.imaging.parts import Aperture, Diffusion, LowPass, Part, Smear, Veil
from labkit.inference.missing_parts import SPECTRUM
from labkit.optics.spectrum import Spectrum
from labkit.plan import Plan
from labkit.plan.tables import Channel

FIT = "fit"


def stated_parts(plan: Plan) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """Those to be fitted, and those of known numbers."""
    low_pass, diffusion, smear = plan.sensor.low_pass_filter, plan.sensor.diffusion_px, plan.sensor.smear_px
    veil, shown = plan.lens.veil, plan.target.pixels
    strayed = Veil(scale_px=plan.lens.veil_scale_px)
    fitted, given = list[Part](), list[Part]()
    if shown is not None and shown.aperture is None:
        fitted.append(Aperture())
    if low_pass is not None:
        part = LowPass(*low_pass.squares, turned=low_pass.turned)
        (fitted if low_pass.spread_px == FIT else given).append(part)
    unknown: tuple[tuple[Part, object], ...] = ((Diffusion(), diffusion), (Smear(), smear), (strayed, veil))
    fitted += [part for part, number in unknown if number == FIT]
    if isinstance(diffusion, float | int):
        given.append(Diffusion(diffusion**2))
    if smear is not None and not isinstance(smear, str):
        rows, columns = smear if isinstance(smear, tuple) else (smear, smear)
        given.append(Smear(rows**2, columns**2))
    if isinstance(veil, float | int):
        given.append(replace(strayed, share=veil))
    return tuple(fitted), tuple(given)


def stated_spectrum(channel: Channel) -> Spectrum:
    """Of samples, of a width that is known, of one to be fitted, or of one wavelength."""
    if channel.spectrum is not None:
        return replace(Spectrum.of_samples(*channel.samples, channel.wavelength_nm), stated=True)
    if channel.width_nm is None:
        return Spectrum()
    if isinstance(channel.width_nm, str):
        return Spectrum.of_width(0.0)
    return replace(Spectrum.of_width((channel.width_nm / channel.wavelength_nm) ** 2).fixed, stated=True)


def wanted_parts(plan: Plan) -> list[str]:
    """Names of the parts that the plan wants fitted, the width of spectra among them."""
    names = [part.name for part in stated_parts(plan)[0]]
    return [*names, SPECTRUM] if any(channel.width_nm == FIT for channel in plan.channel) else names
