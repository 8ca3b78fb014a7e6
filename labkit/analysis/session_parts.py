"""Camera parts that a session estimated, in data-sheet units, and findings about them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labkit.analysis.session_results import as_focus, as_wavefronts
from labkit.estimation.doubts import shift
from labkit.estimation.estimate import Estimate
from labkit.estimation.laws import PART
from labkit.estimation.lens_fit import LensFit
from labkit.findings import (
    Finding,
    Moves,
    camera_part_found,
    camera_parts_missing,
    found,
    stated_model_moves,
)
from labkit.imaging.estimated import Estimated
from labkit.imaging.parts import ESTIMATED, OPTIONAL_PARTS, SpectrumWidth
from labkit.imaging.parts.aperture import Aperture
from labkit.optics.metrics import psf_difference, rms
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import twin_signs
from labkit.plan import Plan
from labkit.results import Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain


def model_parts(session: Estimate, plan: Plan) -> dict[str, Uncertain]:
    """Return the data-sheet quantities of all fitted parts of camera and panel, by key."""
    numbers = _of_lens(session.lens) if session.lens is not None else _of_fits(session)
    groups = dict[tuple[str, ...], list[Uncertain]]()
    for (label, *channel), number in numbers.items():
        groups.setdefault((label.partition(".")[0], *channel), []).append(number)
    channels = {channel.name: channel for channel in plan.channel}
    names = list(dict.fromkeys(name for name, *_ in groups))
    quantities = dict[str, Uncertain]()
    for name, *channel in sorted(groups, key=lambda of: names.index(of[0])):
        of = channels[channel[0]] if channel else None
        part = _group(session, name, channel)
        quantities |= part.quantities(groups[name, *channel], of)
    return quantities


def in_words(parts: Collection[str]) -> dict[str, str]:
    """Return camera parts in words, by name."""
    return {name: OPTIONAL_PARTS[name].words for name in parts}


def _group(session: Estimate, name: str, channel: Sequence[str]) -> Estimated:
    """Return a group of numbers as the fits have it, of a channel if it is one channel's."""
    for fit in session.fits:
        for group in fit.optics.estimated:
            if group.name == name and (not channel or fit.channel == channel[0]):
                return group
    return ESTIMATED[name]


def camera_findings(
    session: Estimate,
    wavefronts: Sequence[Wavefront],
    numbers: Mapping[str, Uncertain],
    wanted: Collection[str] = (),
) -> list[Finding]:
    """Report camera parts that the photographs show, and changes of the results due to these parts.

    Parameters
    ----------
    session : the estimate
    wavefronts : wavefronts of all the session's fits
    numbers : estimated quantities, see `model_parts`
    wanted : names of parts that the plan requests to fit, which are not reported
    """
    findings = list[Finding]()
    if session.missing and session.lens is not None:
        findings.append(
            camera_parts_missing(
                in_words(session.missing), _moves_by_missing(session, wavefronts)
            )
        )
    change = _change(session, wavefronts)
    findings += part_findings(
        session, numbers, wanted, None if change is None else change[0]
    )
    if change is not None:
        findings.append(stated_model_moves(*change))
    return findings


def part_findings(
    session: Estimate,
    numbers: Mapping[str, Uncertain],
    wanted: Collection[str] = (),
    moves: Moves | None = None,
) -> Iterator[Finding]:
    """Report every added part.

    Parameters
    ----------
    session, numbers, wanted : see `camera_findings`
    moves : changes of the results without the parts that the plan does not state
    """
    gains = {part.name: part.gain for part in session.tried if part.adopted}
    for name in dict.fromkeys(label.split(".")[0] for label in numbers):
        values = {
            label.split(".")[1]: value
            for label, value in numbers.items()
            if label.startswith(f"{name}.")
        }
        if name == Aperture.name:
            across, down = values["lit_across"], values["lit_down"]
            words = {"across": str(across), "down": str(down)}
            yield found(
                "panel-aperture-found",
                None,
                words,
                lit_across=across.as_json(),
                lit_down=down.as_json(),
            )
        elif name == SpectrumWidth.name and (named := _named_widths(session)):
            yield _light_contradicted(values, named)
        elif name not in wanted:
            yield camera_part_found(
                name, OPTIONAL_PARTS[name].words, values, gains.get(name), moves
            )


def _light_contradicted(
    values: Mapping[str, Uncertain], named_nm: Mapping[str, float]
) -> Finding:
    """Report widths of the light, nm by channel, other than those of the light that the plan names."""
    words = [f"{c} {values[c]} in place of {nm:.0f} nm" for c, nm in named_nm.items()]
    return found(
        "light-contradicted",
        None,
        {"list": ", ".join(words)},
        found_nm={c: values[c].as_json() for c in named_nm},
        named_nm=dict(named_nm),
    )


def _named_widths(session: Estimate) -> dict[str, float]:
    """Return the standard deviation of the light that the plan names, nm, by channel."""
    return {
        fit.channel: 1e3
        * fit.optics.wavelength_um
        * math.sqrt(fit.optics.spectrum.variance)
        for fit in session.fits
        if fit.optics.typical and fit.optics.spectrum is not None
    }


def higher_modes(wavefronts: Sequence[Wavefront], plan: Plan) -> Iterator[Finding]:
    """Report the modes that were added to the plan's, with their RMS in the wavefront that determines them best."""
    best = min(wavefronts, key=lambda w: float(np.sum(w.std)))
    added = [j for j in best.noll if j not in plan.fit.noll]
    if added:
        whole = rms(best.fitted, without=plan.fit.noll)
        yield found(
            "higher-modes-found",
            None,
            {"waves_words": str(whole)},
            first_noll=min(added),
            last_noll=max(added),
            waves_rms=whole.as_json(),
        )


def _moves_by_missing(session: Estimate, wavefronts: Sequence[Wavefront]) -> Moves:
    """Return changes of the session's results due to parts that the model lacks."""
    pairs = list[tuple[FittedWavefront, FittedWavefront]]()
    for k in session.trusted:
        modes, cone = shift(session.fits[k].optimum, session.with_all_parts(k))
        here = wavefronts[k].fitted
        there = replace(
            here, waves=here.waves + modes, f_number=here.f_number * float(np.exp(cone))
        )
        pairs.append((here, there))
    return _moves(pairs, {} if session.lens is None else _focus_bias(session.lens))


def _focus_bias(lens: LensFit) -> dict[str, float]:
    """Return the change of each best focus, mm, due to parts that the model lacks."""
    focus = as_focus(lens)
    if focus is None or lens.bias is None:
        return {}
    return {
        c: float(lens.model.best_focus(c) @ lens.bias.theta) for c in focus.best_focus_mm
    }


def _change(
    session: Estimate, wavefronts: Sequence[Wavefront]
) -> tuple[Moves, int, int] | None:
    """Compare with the stated camera, without the added parts; None if no part was added.

    Returns
    -------
    changes of all results, number of optima that would be rejected, number of all optima
    """
    plain = session.stated_camera
    if plain is None or session.with_stated_camera(0) is None:
        return None
    others = as_wavefronts(plain)
    pairs = [(wavefronts[k].fitted, others[k].fitted) for k in session.trusted]
    rejected = sum(w.test is not None and not w.test.accepted for w in others)
    return _moves(pairs, _focus_difference(session.lens, plain.lens)), rejected, len(others)


def _moves(
    pairs: Sequence[tuple[FittedWavefront, FittedWavefront]], focus_mm: Mapping[str, float]
) -> Moves:
    """Return the largest changes from the first of each pair to the second."""
    waves = max(_waves_difference(here, there) for here, there in pairs)
    psfs = max(psf_difference(here, there) for here, there in pairs)
    return Moves(focus_mm, waves, float(psfs))


def _focus_difference(lens: LensFit | None, other: LensFit | None) -> dict[str, float]:
    """Return differences of best focus, mm, for channels with a best focus in both lenses."""
    here, there = (None if of is None else as_focus(of) for of in (lens, other))
    if here is None or there is None:
        return {}
    return {
        c: there[c].value - at.value
        for c, at in here.best_focus_mm.items()
        if c in there.best_focus_mm
    }


def _waves_difference(wavefront: FittedWavefront, other: FittedWavefront) -> float:
    """Return the distance of two wavefronts, waves RMS. Of two twins the nearer counts."""
    twin = other.waves * twin_signs(other.noll)
    return min(
        float(np.linalg.norm(waves - wavefront.waves)) for waves in (other.waves, twin)
    )


def _of_lens(lens: LensFit) -> dict[tuple[str, ...], Uncertain]:
    """Return numbers of all parts with standard errors, by label, and by channel for parts of single channels."""
    return {
        tuple(map(str, column.name)): lens.uncertain(PART, *column.name)
        for column in lens.model.columns
        if column.kind == PART
    }


def _of_fits(session: Estimate) -> dict[tuple[str, ...], Uncertain]:
    """Return numbers of all parts of fits without a common lens: means weighted by their errors, keys as in `_of_lens`."""
    seen = dict[tuple[str, ...], list[tuple[float, float]]]()
    for local in session.fits:
        measured, modes = local.optimum.measured, len(local.optimum.noll)
        for k, label in enumerate(measured.parts, modes):
            own = ESTIMATED[label.partition(".")[0]].per_channel
            name = (label, local.channel) if own else (label,)
            seen.setdefault(name, []).append(
                (measured.values[k], measured.covariance[k, k])
            )
    return {name: _weighted(np.array(pairs)) for name, pairs in seen.items()}


def _weighted(pairs: Floats) -> Uncertain:
    """Return the weighted mean of values and variances (n, 2)."""
    values, variances = pairs.T
    whole = float(np.sum(1 / variances))
    return Uncertain(float(np.sum(values / variances)) / whole, whole**-0.5)
