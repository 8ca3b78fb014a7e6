"""What a session found of its camera, in the units of a data sheet, and as findings."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from labkit.analysis.lens_fit import LensFit
from labkit.analysis.lens_model import whose
from labkit.analysis.model_error import shift
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.session_results import as_focus, as_wavefronts
from labkit.finding import Finding
from labkit.findings import Moves, camera_part_found, camera_parts_missing, found, stated_model_moves
from labkit.imaging.parts import Aperture
from labkit.imaging.parts.veil import SCALE_PX
from labkit.inference.fit import twin_signs
from labkit.optics.metrics import psf_difference
from labkit.optics.wavefront import FittedWavefront
from labkit.panel_target import USUAL_APERTURE
from labkit.plan import Plan
from labkit.results import Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

LOG_SCALE = "veil.log_scale"


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


def camera_findings(
    session: SessionFits,
    wavefronts: Sequence[Wavefront],
    numbers: Mapping[str, Uncertain],
    wanted: Collection[str] = (),
) -> list[Finding]:
    """What the photographs show of the camera, and how far that moves the results.

    Parameters
    ----------
    wavefronts : of all the session's fits
    numbers : as `model_parts` returns them
    wanted : names of the parts that the plan wants fitted, which are no news
    """
    findings = list[Finding]()
    if session.missing and session.lens is not None:
        findings.append(camera_parts_missing(session.missing, _moves_by_missing(session, wavefronts)))
    change = _change(session, wavefronts)
    findings += part_findings(session, numbers, wanted, None if change is None else change[0])
    if change is not None:
        findings.append(stated_model_moves(*change))
    return findings


def part_findings(
    session: SessionFits, numbers: Mapping[str, Uncertain], wanted: Collection[str] = (), moves: Moves | None = None
) -> Iterator[Finding]:
    """Every part that was found. moves: how far the results would move without all that the plan does not state."""
    gains = {part.name: part.gain for part in session.tried if part.adopted}
    for name in dict.fromkeys(label.split(".")[0] for label in numbers):
        values = {label.split(".")[1]: value for label, value in numbers.items() if label.startswith(f"{name}.")}
        if name == Aperture.name:
            across, down = values["lit_across"], values["lit_down"]
            words = {"across": str(across), "down": str(down)}
            yield found("panel-aperture-found", None, words, lit_across=across.as_json(), lit_down=down.as_json())
        elif name not in wanted:
            yield camera_part_found(name, values, gains.get(name), moves)


def _moves_by_missing(session: SessionFits, wavefronts: Sequence[Wavefront]) -> Moves:
    """How far the parts that the model lacks would move the session's results."""
    pairs = list[tuple[FittedWavefront, FittedWavefront]]()
    for k in session.trusted:
        modes, cone = shift(session.fits[k].fit, session.fullest(k).fit)
        here = wavefronts[k].fitted
        there = replace(here, waves=here.waves + modes, f_number=here.f_number * float(np.exp(cone)))
        pairs.append((here, there))
    return _moves(pairs, {} if session.lens is None else _focus_lean(session.lens))


def _focus_lean(lens: LensFit) -> dict[str, float]:
    """By how much what the model lacks would move each best focus, mm."""
    focus = as_focus(lens)
    if focus is None or lens.lean is None:
        return {}
    return {c: float(lens.lean[lens.model.index("best focus", c)]) for c in focus.best_focus_mm}


def _change(session: SessionFits, wavefronts: Sequence[Wavefront]) -> tuple[Moves, int, int] | None:
    """How far results would move without the parts that were found, how many optima would be rejected then, and of how many.

    None where no part was found.
    """
    plain = session.without_found
    if plain is None or session.unaided(0) is None:
        return None
    others = as_wavefronts(plain)
    pairs = [(wavefronts[k].fitted, others[k].fitted) for k in session.trusted]
    rejected = sum(w.test is not None and not w.test.accepted for w in others)
    return _moves(pairs, _focus_difference(session.lens, plain.lens)), rejected, len(others)


def _moves(pairs: Sequence[tuple[FittedWavefront, FittedWavefront]], focus_mm: Mapping[str, float]) -> Moves:
    """The largest moves from the first of each pair to the second."""
    waves = max(_waves_difference(here, there) for here, there in pairs)
    psfs = max(psf_difference(here, there) for here, there in pairs)
    return Moves(focus_mm, waves, float(psfs))


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
