"""The words and numbers of a report, ready to be set: everything but the figures."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from labkit.optics.mtf import mtf50
from labkit.optics.orders import noll_to_fringe, noll_to_osa
from labkit.optics.zernike import mode_name
from labkit.plan import Plan
from labkit.report.best_focus import BestFocus
from labkit.report.camera_table import missing_words, part_rows, tried_rows
from labkit.report.focus_table import focus_table
from labkit.report.lens_table import SOURCES, budget_rows, lens_rows
from labkit.report.quantities import MINUS, PLUS_MINUS, UNKNOWN, estimated, fixed, millimetres, plus_minus
from labkit.report.style import channel_inks
from labkit.results import Focus, OptimumTest, Results, Wavefront
from labkit.uncertain import Uncertain, decimals

SECTIONS = {
    "focus": "Focus",
    "lens": "The lens",
    "camera": "The camera",
    "budget": "Errors",
    "best-focus": "At best focus",
    "wavefronts": "Wavefronts",
    "psf": "PSF",
    "mtf": "MTF",
    "fits": "Data",
    "residuals": "Residuals",
    "tables": "Tables",
    "provenance": "Provenance",
}
ALWAYS = {"wavefronts", "tables", "provenance"}


def contents(results: Results, focused: Sequence[BestFocus], drawn: set[str]) -> dict[str, Any]:
    """What the template asks for; focused: each channel at best focus; drawn: the sections that have figures."""
    m, plan, focus = results, results.plan, results.focus
    lens = lens_rows(m)
    shown = drawn | ALWAYS | ({"lens"} if lens else set()) | ({"camera"} if m.parts_tried else set())
    sections = [(name, label) for name, label in SECTIONS.items() if name in shown]
    if m.warnings:
        sections.insert(0, ("warnings", f"Warnings ({len(m.warnings)})"))
    rms = _wavefront_rms(focused, m.reference_wavelength_nm)
    nanometres = ", ".join(f"{row['channel']} {row['nm']}" for row in rms)
    return {
        "m": m,
        "inks": channel_inks(m.channels),
        "sections": sections,
        "title": _title(m),
        "lede": _lede(m, plan),
        "reference": f"{m.reference_wavelength_nm:g} nm",
        "best_focus": _best_focus(m, focus) if focus else [],
        "magnification": _split(focus.pupil_magnification) if focus else None,
        "lens_rows": lens,
        "part_rows": part_rows(m),
        "tried_rows": tried_rows(m),
        "missing": missing_words(m),
        "sources": SOURCES,
        "budget_rows": budget_rows(m),
        "wavefront_rms": rms,
        "nanometres": f"; beyond defocus {nanometres} nm" if rms else "",
        "focus_table": focus_table(focused, m.reference_wavelength_nm),
        "checks": _checks(m),
        "fits": _fit_rows(m),
        "modes": [_mode_table(m, r) for r in m.ranges_mm],
        "focus_rows": _focus_rows(m, focus) if focus else [],
        "provenance": _provenance(m, plan),
    }


def _title(m: Results) -> str:
    if m.folder is None:
        return "Lens measurement"
    session = m.folder.resolve()
    if session.parent.name != "results":
        return session.name
    name = session.parent.parent.name
    return name if session.name == "latest" else f"{name}, {session.name}"


def _lede(m: Results, plan: Plan) -> str:
    ranges = [r for r in m.ranges_mm if r is not None]
    if len(ranges) > 6:
        where = f"{len(ranges)} ranges from {ranges[0]:g} to {ranges[-1]:g} mm"
    elif ranges:
        where = f"range{'s' if len(ranges) > 1 else ''} {', '.join(format(r, 'g') for r in ranges)} mm"
    else:
        where = "range not known"
    count = len(m.wavefronts)
    lens = f"{plan.lens.focal_length_mm:g} mm f/{plan.lens.f_number:g}"
    return f"{lens} · {where} · {count} wavefront{'' if count == 1 else 's'} · {m.created}"


def _split(estimate: Uncertain, places: int | None = None) -> dict[str, str]:
    value, _, error = plus_minus(estimate.value, estimate.std, places).partition(PLUS_MINUS)
    return {"value": value, "error": f"{PLUS_MINUS}{error}" if error else ""}


def _best_focus(m: Results, focus: Focus) -> list[dict[str, str]]:
    wavelengths = {w.channel: f"{w.wavelength_nm:g} nm" for w in m.wavefronts}
    return [{"channel": c, "wavelength": wavelengths.get(c, "")} | _split(e) for c, e in focus.best_focus_mm.items()]


def _wavefront_rms(focused: Sequence[BestFocus], reference_nm: float) -> list[dict[str, str]]:
    """For each channel, its fit of least defocus."""
    rows = []
    for best in focused:
        fit, beyond = best.photographed, _split(best.rms, max(4, decimals(best.rms.std)))
        row = {"channel": best.channel, "range": millimetres(fit.range_mm), "total": fixed(fit.rms().value, 4)}
        row |= {"nm": fixed(best.rms.value * reference_nm, 1), "beyond": beyond["value"], "error": beyond["error"]}
        rows.append(row)
    return rows


def _checks(m: Results) -> list[dict[str, Any]]:
    """Whether the numbers above can be trusted, a line each."""
    checks = []
    tested = [w for w in m.wavefronts if w.test]
    rejected = [w for w in tested if w.test and not w.test.accepted]
    if rejected:
        names = ", ".join(f"{millimetres(w.range_mm)} {w.channel}" for w in rejected)
        text = f"{len(rejected)} of {len(tested)} optima rejected as local minima: {names}"
        checks.append({"good": False, "text": text})
    elif tested:
        checks.append({"good": True, "text": _no_sign(len(tested))})
    unexplained = [w for w in tested if w.test and not w.test.explains]
    if unexplained:
        names = ", ".join(f"{millimetres(w.range_mm)} {w.channel}" for w in unexplained)
        text = (
            f"the model does not explain the pixels of {len(unexplained)} of {len(tested)} fits to their noise: {names}"
        )
        checks.append({"good": False, "text": text})
    untested = len(m.wavefronts) - len(tested)
    if untested:
        checks.append({"good": False, "text": f"{untested} optim{'um' if untested == 1 else 'a'} untested"})
    chi2 = [w.chi2_per_pixel for w in m.wavefronts if np.isfinite(w.chi2_per_pixel)]
    if chi2:
        good = min(chi2) > CHI2_USUAL[0] and max(chi2) < CHI2_USUAL[1]
        span = " to ".join(dict.fromkeys(fixed(c, 2) for c in (min(chi2), max(chi2))))
        words = "" if good else ": the model does not describe the pixels to their noise"
        checks.append({"good": good, "text": f"χ² per pixel {span}{words}"})
    if m.focus and m.focus.residual_waves:
        rest = np.array([r for values in m.focus.residual_waves.values() for r in values])
        text = f"focus fit leaves {fixed(1e3 * float(np.sqrt(np.mean(rest**2))), 1)} milliwaves RMS"
        checks.append({"good": True, "text": text})
    return [*checks, *_joint_check(m)]


def _joint_check(m: Results) -> list[dict[str, Any]]:
    """How far a climb over all frames at once moved the session's numbers, where there was one."""
    if not m.joint:
        return []
    most = max(abs(moved) for moved in m.joint.values())
    text = f"one climb over all frames moves no number by more than {fixed(most, 2)} standard errors"
    return [{"good": most <= 1, "text": text}]


def _no_sign(count: int) -> str:
    return f"no sign of a wrong optimum in {'the fit' if count == 1 else f'any of {count} fits'}"


CHI2_USUAL = (0.9, 1.5)


def _fit_rows(m: Results) -> list[dict[str, Any]]:
    return [{"first": k == 0} | _fit_row(fit) for range_mm in m.ranges_mm for k, fit in enumerate(m.at_range(range_mm))]


def _fit_row(fit: Wavefront) -> dict[str, Any]:
    along_x, along_y = (mtf50(fit.fitted, direction) for direction in ("x", "y"))
    verdict = fit.test
    return {
        "range": UNKNOWN if fit.range_mm is None else f"{fit.range_mm:g}",
        "channel": fit.channel,
        "total": _waves(fit.rms()),
        "defocus": _waves(fit.defocus),
        "blur": estimated(fit.blur, least=2),
        "beyond": _waves(fit.rms(without=(4,))),
        "mtf50_x": estimated(along_x),
        "mtf50_y": estimated(along_y),
        "chi2": fixed(fit.chi2_per_pixel, 3),
        "verdict": "not tested" if verdict is None else "accepted" if verdict.accepted else "rejected",
        "rejected": verdict is not None and not verdict.accepted,
        "test": _test(verdict),
        "gain": fixed(fit.gain, 4),
        "read_noise": fixed(fit.read_noise, 2),
        "seconds": fixed(fit.seconds, 1),
        "frames": ", ".join(fit.frames) or UNKNOWN,
        "poses": _poses(fit),
    }


def _waves(estimate: Uncertain | None) -> str:
    if estimate is None:
        return UNKNOWN
    return plus_minus(estimate.value, estimate.std, max(4, decimals(estimate.std, 5)))


def _test(verdict: OptimumTest | None) -> str:
    if verdict is None:
        return "none"
    words = [verdict.name or "unnamed"]
    words += [f"p = {verdict.p_value:.2g}"] if np.isfinite(verdict.p_value) else []
    words += [f"{verdict.starts} start{'' if verdict.starts == 1 else 's'}"] if verdict.starts is not None else []
    if np.isfinite(verdict.next_below):
        words += [f"next optimum {verdict.next_below:.0f} lower in log-likelihood"]
    return ", ".join(words)


def _poses(fit: Wavefront) -> list[list[str]]:
    return [[f"{v:.4g}".replace("-", MINUS) for v in pose] for pose in fit.poses]


def _mode_table(m: Results, range_mm: float | None) -> dict[str, Any]:
    fits = m.at_range(range_mm)
    errors = np.concatenate([w.std for w in fits])
    usual = float(np.median(errors[np.isfinite(errors)])) if np.isfinite(errors).any() else float("nan")
    places = max(4, decimals(usual, 5))
    rows = [
        {
            "index": (j, noll_to_osa(j), noll_to_fringe(j)),
            "name": mode_name(j),
            "cells": [_mode_cell(w, j, places, m.reference_wavelength_nm) for w in fits],
        }
        for j in sorted({j for w in fits for j in w.noll})
    ]
    return {"range": millimetres(range_mm), "channels": [w.channel for w in fits], "rows": rows}


def _mode_cell(fit: Wavefront, j: int, places: int, reference_nm: float) -> dict[str, str]:
    if j not in fit.noll:
        return {"waves": UNKNOWN, "nm": UNKNOWN}
    value, std = (float(numbers[fit.noll.index(j)]) for numbers in (fit.waves, fit.std))
    return {"waves": plus_minus(value, std, places), "nm": fixed(value * reference_nm, 1)}


def _focus_rows(m: Results, focus: Focus) -> list[dict[str, str]]:
    return [
        {
            "channel": channel,
            "best": plus_minus(best.value, best.std),
            "residuals": ", ".join(fixed(1e3 * r, 2) for r in focus.residual_waves.get(channel, ())) or UNKNOWN,
        }
        for channel, best in focus.best_focus_mm.items()
    ]


def _provenance(m: Results, plan: Plan) -> list[tuple[str, str]]:
    sensor, target = plan.sensor, plan.target
    conventions = {
        "corrected": "corrected: the sagitta is taken about the exit pupil",
        "thesis": "thesis: equation (4.40) as it is printed",
    }
    order = "" if target.order is None else f" of order {target.order}"
    frames = sorted({f for w in m.wavefronts for f in w.frames})
    return [
        ("labkit", m.labkit_version),
        ("Results made", m.created),
        ("Results folder", UNKNOWN if m.folder is None else str(m.folder.resolve())),
        ("Plan, SHA-256", m.plan_sha256),
        ("Lens", f"focal length {plan.lens.focal_length_mm:g} mm, f/{plan.lens.f_number:g}"),
        ("Sensor", f"{sensor.pixel_pitch_um:g} µm pitch, fill factor {sensor.fill_factor:g}"),
        ("Target", f"{target.kind}{order}, {target.size_mm:g} mm, {target.surround} around it"),
        ("Reference wavelength", f"{m.reference_wavelength_nm:g} nm"),
        ("Focus convention", conventions.get(plan.fit.convention, plan.fit.convention)),
        (
            "Zernike modes",
            "Noll's order, unit RMS over the pupil; piston, tip and tilt belong to the pose",
        ),
        ("Pupil axes", "x to the right along the sensor's rows, y down its columns; angles run from x towards y"),
        (
            "Signs",
            "optical path difference; positive defocus: the target lies beyond best focus. A wavefront and its twin, "
            "turned by half a turn and negated, give the same image: the common sign of all modes of even order is "
            "chosen, so that defocus grows with range where there are several",
        ),
        ("Standard errors", _origin_of_errors(m)),
        ("Frames", f"{len(frames)}, listed above under “How they were fitted”" if frames else UNKNOWN),
    ]


def _origin_of_errors(m: Results) -> str:
    fits = "from the inverse Fisher information of the identifiable parameters"
    if m.lens is None:
        return fits
    return f"{fits} of each fit, and all that the plan states with an error, through one estimate of the whole session"
