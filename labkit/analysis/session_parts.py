"""What a session found of its camera, in the units of a data sheet, and in words."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import groupby

import numpy as np

from labkit.analysis.lens_fit import LensFit
from labkit.analysis.lens_model import whose
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.session_results import as_focus, as_wavefronts
from labkit.imaging.parts import Aperture
from labkit.imaging.parts.veil import SCALE_PX
from labkit.optics.metrics import psf_difference
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import twin_signs
from labkit.panel_target import USUAL_APERTURE
from labkit.plan import Plan
from labkit.results import Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

LOG_SCALE = "veil.log_scale"
WORDS = {
    "low_pass_filter": "an optical low-pass filter",
    "low_pass_filter_turned": "an optical low-pass filter turned by 45 degrees",
    "diffusion": "charge that diffuses between pixels",
    "smear": "smear, by a shake or a rolling shutter",
    "veil": "a veil of stray light",
    "spectrum": "light of several wavelengths",
}


def model_parts(session: SessionFits, plan: Plan) -> dict[str, Uncertain]:
    """Numbers of the parts that were fitted: how far apart a low-pass filter's spots lie, px; standard deviations of what
    diffuses and smears, px, and of spectra, nm; a veil's share of the light and scale, px; shares that a panel's
    stripes are lit over."""
    numbers = _of_lens(session.lens) if session.lens is not None else _of_fits(session)
    found = dict[str, Uncertain]()
    for name, of in groupby(numbers.items(), key=lambda item: item[0][0].split(".")[0]):
        values = dict(of)
        if name == Aperture.name:
            for key, value in values.items():
                found[f"{name}.lit_{key[0].split('.')[1]}"] = Uncertain(USUAL_APERTURE + value.value, value.std)
        elif name == "veil":
            share, scale = values.values()
            px = SCALE_PX * float(np.exp(scale.value))
            found |= {f"{name}.share": share, f"{name}.scale_px": Uncertain(px, px * scale.std, "px")}
        elif name == "spectrum":
            for (_, channel), value in values.items():
                nm = next(c.wavelength_nm for c in plan.channel if c.name == channel)
                width = _root(value)
                found[f"spectrum.{channel}.width_nm"] = Uncertain(nm * width.value, nm * width.std, "nm")
        else:
            squares = {key[0].split(".")[1].removesuffix("_px2"): value for key, value in values.items()}
            squares.pop("across", None)
            if name.startswith("low_pass_filter"):
                found[f"{name}.spread_px"] = _root(_mean([*squares.values()]), "px")
            found |= {f"{name}.{'sigma' if k == 'variance' else k}_px": _root(v, "px") for k, v in squares.items()}
    return found


def words_of_parts(session: SessionFits, found: dict[str, Uncertain], wanted: Collection[str] = ()) -> list[str]:
    """What was found of the camera, and what is missing, a line each; not of parts that the plan wanted fitted."""
    lines = []
    if session.missing and session.lens is not None:
        named = " and ".join(WORDS[name] for name in session.missing)
        lines.append(
            f"the photographs call for {named}, which the model lacks: errors hold how far that would move each number"
        )
    for name in dict.fromkeys(key.split(".")[0] for key in found):
        numbers = ", ".join(
            f"{key.removeprefix(name + '.').replace('_px', '').replace('_nm', '')} {value}"
            for key, value in found.items()
            if key.startswith(name + ".") and not key.endswith("spread_px")
        )
        if name == Aperture.name:
            across, down = found[f"{name}.lit_across"], found[f"{name}.lit_down"]
            lines.append(
                f"a stripe of the panel's pixels is lit over {across} of its third, and over {down} of the pitch"
            )
            continue
        if name in wanted:
            continue
        lines.append(f"the photographs call for {WORDS[name]}, which the plan does not state: {numbers}")
    return lines


def words_of_change(session: SessionFits, wavefronts: Sequence[Wavefront]) -> list[str]:
    """What the parts that were found change, against the session fitted without them; none where none was found.

    wavefronts: of all its fits.
    """
    plain = session.without_found
    if plain is None or session.unaided(0) is None:
        return []
    others = as_wavefronts(plain)
    pairs = [(wavefronts[k].fitted, others[k].fitted) for k in session.trusted]
    waves = max(_waves_difference(here, there) for here, there in pairs)
    psfs = max(psf_difference(here, there) for here, there in pairs)
    moved = [f"wavefronts by up to {waves:.2g} waves RMS", f"PSFs by up to {100 * psfs:.2g} % (L1)"]
    if focus := _focus_difference(session.lens, plain.lens):
        moved.insert(0, f"best focus by {', '.join(f'{name} {mm:+.2g} mm' for name, mm in focus.items())}")
    rejected = sum(w.test is not None and not w.test.accepted for w in others)
    end = f"; {rejected} of {len(others)} optima would be rejected" if rejected else ""
    return [f"the model as the plan states it would move {', '.join(moved)}{end}"]


def _focus_difference(lens: LensFit | None, other: LensFit | None) -> dict[str, float]:
    """Of best focus, mm, by channel, where both have one."""
    here, there = (None if of is None else as_focus(of) for of in (lens, other))
    if here is None or there is None:
        return {}
    return {c: there[c].value - at.value for c, at in here.best_focus_mm.items() if c in there.best_focus_mm}


def _waves_difference(wavefront: FittedWavefront, other: FittedWavefront) -> float:
    """Waves RMS. Of two twins the nearer counts."""
    twin = other.waves * twin_signs(other.noll)
    return min(float(np.linalg.norm(waves - wavefront.waves)) for waves in (other.waves, twin))


def _of_lens(lens: LensFit) -> dict[tuple[str, ...], Uncertain]:
    """By label, and channel where each has its own: values and standard errors of all parts."""
    return {
        tuple(map(str, c.of)): Uncertain(lens.value(c.kind, *c.of), lens.std(c.kind, *c.of))
        for c in lens.model.columns
        if c.kind == "part"
    }


def _of_fits(session: SessionFits) -> dict[tuple[str, ...], Uncertain]:
    """The same of fits without a lens in common: means weighted by their errors."""
    seen = dict[tuple[str, ...], list[tuple[float, float]]]()
    for local in session.fits:
        measured, modes = local.fit.measured, len(local.fit.noll)
        for k, label in enumerate(measured.parts, modes):
            of = whose(label, local.channel)
            seen.setdefault(of, []).append((measured.values[k], measured.covariance[k, k]))
    return {of: _weighted(np.array(pairs)) for of, pairs in seen.items()}


def _weighted(pairs: Floats) -> Uncertain:
    values, variances = pairs.T
    whole = float(np.sum(1 / variances))
    return Uncertain(float(np.sum(values / variances)) / whole, whole**-0.5)


def _mean(values: Sequence[Uncertain]) -> Uncertain:
    """Of independent numbers."""
    many = len(values)
    return Uncertain(sum(v.value for v in values) / many, float(np.sqrt(sum(v.std**2 for v in values))) / many)


def _root(square: Uncertain, unit: str = "") -> Uncertain:
    """Of a square that may be estimated below 0."""
    root = float(np.sqrt(max(square.value, 0.0)))
    return Uncertain(root, square.std / (2 * root) if root**2 > square.std else float(np.sqrt(square.std)), unit)
