"""Findings about an estimate: searches, signs, the lens, the plan's numbers, the camera, and doubtful wavefronts."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import exp

import numpy as np

from labkit.analysis.session_parts import in_words
from labkit.analysis.session_results import (
    as_focus,
    as_wavefronts,
    at_bound,
    pupil_magnification,
    stations_of,
)
from labkit.estimation.candidate import mostly_unexplained
from labkit.estimation.doubts import shift
from labkit.estimation.estimate import Estimate
from labkit.estimation.laws import (
    F_NUMBER,
    FOCAL_LENGTH,
    PIXEL_PITCH,
    RANGE_ZERO,
    SIZE,
    WAVELENGTH,
    WORKING_F_NUMBER,
    Name,
)
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.settings import SETTINGS
from labkit.estimation.split import second_camp
from labkit.estimation.stated import wanted_parts
from labkit.findings.findings import (
    Finding,
    Moves,
    camera_part_found,
    camera_parts_missing,
    found,
    model_incomplete_everywhere,
    pixels_left_out,
    plan_contradicted,
    residuals_not_noise,
    stated_model_moves,
    two_camps,
    undetermined,
)
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts import KNOWN, SpectrumWidth
from labkit.key import Key
from labkit.optics.lens import TELLING_STD
from labkit.optics.metrics import psf_difference, rms
from labkit.optics.wavefront import DEFOCUS, FittedWavefront
from labkit.optics.zernike import is_even, twin_signs
from labkit.plan import Plan
from labkit.results import Wavefront
from labkit.uncertain import Uncertain

PLAN_KEYS = {
    F_NUMBER: "lens.f_number",
    FOCAL_LENGTH: "lens.focal_length_mm",
    SIZE: "target.size_mm",
    PIXEL_PITCH: "sensor.pixel_pitch_um",
    RANGE_ZERO: "the ranges",
    WAVELENGTH: "channel.wavelength_nm",
}
"""Keys of the plan, by kind of column."""


USUAL_CHI2 = (0.9, 1.5)
"""Usual chi2 per pixel of a model that describes its pixels: the noise is known to some 5 %, and small faults add up."""


def findings_of(
    session: Estimate,
    wavefronts: Sequence[Wavefront],
    numbers: Mapping[str, Uncertain],
    plan: Plan,
    patience_s: float,
) -> list[Finding]:
    """Return all findings about an estimate, in the order of the report.

    Parameters
    ----------
    session : the estimate
    wavefronts : wavefronts of all the session's fits
    numbers : estimated quantities of camera parts, see `model_parts`
    plan : the session's plan
    patience_s : processor time of a search
    """
    return [
        *(found("fit-left-out", note=words) for words in session.lost),
        *_stray_pixels(session),
        *higher_modes(session, wavefronts, plan),
        *camera_findings(session, wavefronts, numbers, wanted_parts(plan)),
        *plan_findings(session.lens, plan),
        *session_findings(session, patience_s),
        *doubtful_wavefronts(wavefronts),
    ]


def _stray_pixels(session: Estimate) -> list[Finding]:
    """Report pixels that the fits left out, by their place in the frame."""
    places = dict[tuple[int, int], dict[str, float]]()
    for fit in session.fits:
        row, column = fit.observation.origin_px
        for stray in fit.found.strays:
            files = places.setdefault((row + stray.row, column + stray.column), {})
            files[fit.observation.names[stray.frame]] = stray.residual_stds
    return [pixels_left_out(dict(sorted(places.items())))] if places else []


def session_findings(session: Estimate, patience_s: float) -> list[Finding]:
    """Report findings about searches and the session's lens.

    Parameters
    ----------
    session : the estimate
    patience_s : processor time of a search
    """
    lens = session.lens
    findings = [*_search_findings(session, patience_s), *_open_signs(session)]
    if lens is None:
        return [*findings, found("no-best-focus", why=_why_no_lens(session))]
    return [*findings, *_lens_findings(lens)]


def _open_signs(session: Estimate) -> list[Finding]:
    """Report wavefronts of open sign: a single finding for the session, else for a channel, else for each wavefront."""
    is_open = {
        fit.observation.key: k not in session.signed and k not in session.outliers
        for k, fit in enumerate(session.fits)
        if any(map(is_even, fit.optimum.noll))
    }
    if is_open and all(is_open.values()):
        where = "all wavefronts" if len(is_open) > 1 else next(iter(is_open)).label
        return [found("defocus-sign-open", None, {"where": where})]
    findings = []
    for channel in dict.fromkeys(key.channel for key in is_open):
        keys = [key for key in is_open if key.channel == channel]
        if all(is_open[key] for key in keys):
            findings.append(found("defocus-sign-open", Key(None, channel)))
        else:
            findings += [found("defocus-sign-open", key) for key in keys if is_open[key]]
    return findings


def _search_findings(session: Estimate, patience_s: float) -> list[Finding]:
    """Report fits that ended early, were refitted, or contradict the others."""
    keys = [local.observation.key for local in session.fits]
    findings = [
        found("search-cut-short", key, patience_s=patience_s, starts=local.found.starts)
        for k, (key, local) in enumerate(zip(keys, session.fits, strict=True))
        if local.found.cut_short and k not in session.members
    ]
    # a tile's first fit begins from another tile's wavefront, and is expected to be mended
    mended = [k for k in session.refitted_members if keys[k].tile is None]
    findings += [found("fit-mended", keys[k]) for k in mended]
    if second_camp(session):
        findings.append(
            two_camps(
                [keys[k] for k in session.members], [keys[k] for k in session.outliers]
            )
        )
    else:
        findings += [found("fit-does-not-belong", keys[k]) for k in session.outliers]
    return findings


def _why_no_lens(session: Estimate) -> str:
    if any(local.ranged for local in session.fits):
        return "every fit was rejected"
    if any(DEFOCUS in local.optimum.noll for local in session.fits):
        return "the frames carry no ranges"
    return "defocus was not fitted"


def _lens_findings(lens: LensFit) -> Iterator[Finding]:
    pupils = pupil_magnification(lens)
    for channel, stations in stations_of(lens).items():
        if len(stations) < 2:
            yield found("channel-without-best-focus", Key(None, channel))
    if at_bound(pupils):
        least, most = SETTINGS.magnification_bounds
        yield found("pupil-magnification-at-bound", least=least, most=most)
    elif pupils.std > TELLING_STD:
        yield found("pupil-magnification-undetermined", pupil_magnification_std=pupils.std)
    if not lens.model.laws.paraxial:
        yield found(
            "cones-contradict-one-lens",
            cone_relative_error=float(np.expm1(lens.value(WORKING_F_NUMBER))),
        )
    if not lens.model.laws.shared:
        yield found(
            "modes-differ-between-ranges", scatter_waves=lens.model.laws.mode_scatter
        )
    if lens.birge_ratio > 1:
        yield found(
            "errors-widened", factor=lens.birge_ratio, chi2_per_freedom=lens.reduced_chi2
        )


def plan_findings(lens: LensFit | None, plan: Plan) -> Iterator[Finding]:
    """Report the number of the plan that is probably a mistake.

    Parameters
    ----------
    lens : the estimate of the most probable model, with the others
    plan : states the number
    """
    if lens is None or (mistaken := lens.model.laws.mistaken) is None:
        return
    key, stated, agrees = _number(lens, *mistaken, plan)
    # each mistake is a model with exact wavelengths, and one with usual ones
    others = [(chance, other.model.laws.mistaken) for chance, other in lens.others]
    yield plan_contradicted(
        key,
        stated,
        agrees,
        1 - sum(chance for chance, column in others if column != mistaken),
        [_key(*column) for _, column in others if column not in (None, mistaken)],
    )


def _key(kind: str, name: Name) -> str:
    """Return the plan's key of a column."""
    if kind == WAVELENGTH:
        return f"{PLAN_KEYS[kind]} of {name[0] if name else 'all channels'}"
    return PLAN_KEYS[kind]


def _number(
    lens: LensFit, kind: str, name: Name, plan: Plan
) -> tuple[str, float, Uncertain]:
    """Return a mistaken number's key and stated value, and the value with which the photographs agree."""
    estimate = lens.uncertain(kind, *name, unit="" if kind == F_NUMBER else "mm")
    if kind == RANGE_ZERO:
        return "the common error of all ranges", 0.0, estimate
    if kind in (F_NUMBER, FOCAL_LENGTH):
        return _key(kind, name), float(lens.model.centre[lens.model.index(kind)]), estimate
    light = {c.name: c.wavelength_nm for c in plan.channel}
    stated, unit, sign = {
        SIZE: (plan.target.size_mm, "mm", 1.0),
        PIXEL_PITCH: (
            plan.sensor.pixel_pitch_um,
            "um",
            -1.0,
        ),  # ln of the stated over the true
        WAVELENGTH: (light[str(name[0])], "nm", 1.0) if name else (1.0, "times", 1.0),
    }[kind]
    true = stated * exp(sign * estimate.value)
    return _key(kind, name), stated, Uncertain(true, true * estimate.std, unit)


def higher_modes(
    session: Estimate, wavefronts: Sequence[Wavefront], plan: Plan
) -> Iterator[Finding]:
    """Report the modes added to the plan's, with their RMS in the wavefront with the least errors."""
    best = min(wavefronts, key=lambda w: float(np.sum(w.std)))
    weak = [] if session.lens is None else sorted(session.lens.model.weak)
    added = [j for j in best.noll if j not in (*plan.fit.noll, *weak)]
    if added:
        whole = rms(best.fitted, without=(*plan.fit.noll, *weak))
        besides = f"; weaker modes, to {weak[-1]}, were estimated with them" if weak else ""
        yield found(
            "higher-modes-found",
            None,
            {"waves_words": str(whole), "besides": besides},
            first_noll=min(added),
            last_noll=max(added),
            waves_rms=whole.as_json(),
        )


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
    findings += _rims_at_bound(session)
    change = _change(session, wavefronts)
    findings += part_findings(
        session, numbers, wanted, None if change is None else change[0]
    )
    if change is not None:
        findings.append(stated_model_moves(*change))
    return findings


def _rims_at_bound(session: Estimate) -> Iterator[Finding]:
    """Report parts of the pupil's rim that ended at the limit of a closed curve."""
    bound = {p for fit in session.fits for p in fit.optimum.optics.parts if p.at_bound}
    for title in sorted({part.title for part in bound}):
        yield found("pupil-at-bound", None, {"title": title})


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
    moves : changes of the results without the parts that the plan does not state, but for the pupil's
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
            part = KNOWN[name]
            alone = None if part.of_rim else moves
            yield camera_part_found(name, part.words, values, gains.get(name), alone)


def _light_contradicted(
    values: Mapping[str, Uncertain], named_nm: Mapping[str, float]
) -> Finding:
    """Report widths of the light, nm by channel, other than of the light named by the plan."""
    words = [f"{c} {values[c]} in place of {nm:.0f} nm" for c, nm in named_nm.items()]
    return found(
        "light-contradicted",
        None,
        {"list": ", ".join(words)},
        found_nm={c: values[c].as_json() for c in named_nm},
        named_nm=dict(named_nm),
    )


def _named_widths(session: Estimate) -> dict[str, float]:
    """Return the standard deviation of the light named by the plan, nm, by channel."""
    return {
        fit.channel: 1e3
        * fit.optics.wavelength_um
        * math.sqrt(fit.optics.spectrum.variance)
        for fit in session.fits
        if fit.optics.typical and fit.optics.spectrum is not None
    }


def _moves_by_missing(session: Estimate, wavefronts: Sequence[Wavefront]) -> Moves:
    """Return changes of the session's results due to parts absent from the model."""
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
    """Return the change of each best focus, mm, due to parts absent from the model."""
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
    changes of all results, number of optima to be rejected, number of all optima
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
    of_mode = dict(zip(other.noll, other.waves, strict=True))
    there = np.array([of_mode.get(j, 0.0) for j in wavefront.noll])
    twin = there * twin_signs(wavefront.noll)
    return min(float(np.linalg.norm(waves - wavefront.waves)) for waves in (there, twin))


def doubtful_wavefronts(wavefronts: Sequence[Wavefront]) -> Iterator[Finding]:
    """Yield findings about doubtful wavefronts; a single finding if the model is incomplete for most."""
    poor = {
        w.key
        for w in wavefronts
        if w.test is not None and w.test.accepted and not w.test.explains
    }
    together = len(wavefronts) > 1 and mostly_unexplained(
        w.key not in poor for w in wavefronts
    )
    together = together and not any(w.missing for w in wavefronts if w.key in poor)
    if together:
        chi2 = {w.key.array_name: w.chi2_per_pixel for w in wavefronts if w.key in poor}
        yield model_incomplete_everywhere(chi2, len(wavefronts))
    for w in wavefronts:
        assert w.test is not None
        shared = together and w.key in poor
        if w.test.undetermined:
            yield undetermined(w.key, w.test.undetermined)
        elif not (w.test.explains or shared):
            confirmed_by = w.test.name if w.test.accepted else None
            yield residuals_not_noise(
                w.key, w.test.p_value, w.chi2_per_pixel, in_words(w.missing), confirmed_by
            )
        low, high = USUAL_CHI2
        if not (low <= w.chi2_per_pixel <= high or shared):
            yield found(
                "chi2-unusual", w.key, chi2_per_pixel=w.chi2_per_pixel, low=low, high=high
            )
