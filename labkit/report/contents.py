"""The words and numbers of a report, ready to be set: everything but the figures."""

from typing import Any

import numpy as np

from labkit.optics.zernike import mode_name
from labkit.plan import Plan
from labkit.report.charts import half_contrast, mtf
from labkit.report.quantities import MINUS, UNKNOWN, fixed, millimetres, plus_minus
from labkit.report.reading import Estimate, Focus, Measurement, Verdict, Wavefront
from labkit.report.style import channel_inks
from labkit.uncertain import decimals

SECTIONS = {
    "focus": "Focus",
    "wavefronts": "Wavefronts",
    "psf": "PSF",
    "mtf": "MTF",
    "fits": "Data and model",
    "residuals": "Residuals",
    "tables": "Tables",
    "provenance": "Provenance",
}
ALWAYS = {"wavefronts", "tables", "provenance"}


def contents(measurement: Measurement, plan: Plan, drawn: set[str]) -> dict[str, Any]:
    """What the template asks for; drawn: the sections that have figures."""
    m, focus = measurement, measurement.focus
    sections = [(name, label) for name, label in SECTIONS.items() if name in drawn | ALWAYS]
    if m.warnings:
        sections.insert(0, ("warnings", f"Warnings ({len(m.warnings)})"))
    rms = _wavefront_rms(m)
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
        "wavefront_rms": rms,
        "nanometres": f"; beyond defocus {nanometres} nm" if rms else "",
        "checks": _checks(m),
        "fits": _fit_rows(m),
        "modes": [_mode_table(m, r) for r in m.ranges_mm],
        "focus_rows": _focus_rows(m, focus) if focus else [],
        "provenance": _provenance(m, plan),
    }


def _title(m: Measurement) -> str:
    session = m.folder.resolve()
    if session.parent.name != "results":
        return session.name
    name = session.parent.parent.name
    return name if session.name == "latest" else f"{name}, {session.name}"


def _lede(m: Measurement, plan: Plan) -> str:
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


def _split(estimate: Estimate, places: int | None = None) -> dict[str, str]:
    value, _, error = plus_minus(estimate.value, estimate.std, places).partition(" ")
    return {"value": value, "error": error}


def _best_focus(m: Measurement, focus: Focus) -> list[dict[str, str]]:
    wavelengths = {w.channel: f"{w.wavelength_nm:g} nm" for w in m.wavefronts}
    return [{"channel": c, "wavelength": wavelengths.get(c, "")} | _split(e) for c, e in focus.best_mm.items()]


def _wavefront_rms(m: Measurement) -> list[dict[str, str]]:
    """For each channel, its fit of least defocus."""
    rows = []
    for channel in m.channels:
        fits = [w for w in m.wavefronts if w.channel == channel]
        fit = min(fits, key=lambda w: abs(w.defocus.value) if w.defocus else 0.0)
        beyond = fit.rms(without=(4,))
        row = {"channel": channel, "range": millimetres(fit.range_mm), "total": fixed(fit.rms().value, 4)}
        row["nm"] = fixed(beyond.value * m.reference_wavelength_nm, 1)
        rows.append(row | _split(beyond, max(4, decimals(beyond.std)) if np.isfinite(beyond.std) else 4))
    return [{("beyond" if k == "value" else k): v for k, v in row.items()} for row in rows]


def _checks(m: Measurement) -> list[dict[str, Any]]:
    """Whether the numbers above can be trusted, a line each."""
    checks = []
    tested = [w for w in m.wavefronts if w.verdict]
    rejected = [w for w in tested if w.verdict and not w.verdict.accepted]
    if rejected:
        names = ", ".join(f"{millimetres(w.range_mm)} {w.channel}" for w in rejected)
        text = f"{len(rejected)} of {len(tested)} optima rejected as local minima: {names}"
        checks.append({"good": False, "text": text})
    elif tested:
        checks.append({"good": True, "text": f"{_all(len(tested))} the test for a local minimum"})
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
    return checks


def _all(count: int) -> str:
    return "the optimum passes" if count == 1 else f"all {count} optima pass"


CHI2_USUAL = (0.9, 1.5)


def _fit_rows(m: Measurement) -> list[dict[str, Any]]:
    return [
        {"first": k == 0} | _fit_row(fit, m.psf_spacing_um)
        for range_mm in m.ranges_mm
        for k, fit in enumerate(m.at_range(range_mm))
    ]


def _fit_row(fit: Wavefront, spacing_um: float) -> dict[str, Any]:
    along_x, along_y = float("nan"), float("nan")
    if fit.psf is not None:
        frequency, *curves = mtf(fit.psf, spacing_um)
        along_x, along_y = (half_contrast(frequency, curve) for curve in curves)
    verdict = fit.verdict
    return {
        "range": UNKNOWN if fit.range_mm is None else f"{fit.range_mm:g}",
        "channel": fit.channel,
        "total": _waves(fit.rms()),
        "defocus": _waves(fit.defocus),
        "beyond": _waves(fit.rms(without=(4,))),
        "mtf50_x": fixed(along_x, 0),
        "mtf50_y": fixed(along_y, 0),
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


def _waves(estimate: Estimate | None) -> str:
    if estimate is None:
        return UNKNOWN
    return plus_minus(estimate.value, estimate.std, max(4, decimals(estimate.std, 5)))


def _test(verdict: Verdict | None) -> str:
    if verdict is None:
        return "none"
    words = [verdict.name or "unnamed"]
    words += [f"p = {verdict.p_value:.2g}"] if np.isfinite(verdict.p_value) else []
    words += [f"{verdict.starts} start{'' if verdict.starts == 1 else 's'}"] if verdict.starts is not None else []
    if np.isfinite(verdict.next_below):
        words += [f"next optimum seen {verdict.next_below:.0f} lower in log-likelihood"]
    return ", ".join(words)


def _poses(fit: Wavefront) -> list[list[str]]:
    poses = np.atleast_2d(fit.pose) if fit.pose.size else np.empty((0, 0))
    return [[f"{v:.4g}".replace("-", MINUS) for v in pose] for pose in poses]


def _mode_table(m: Measurement, range_mm: float | None) -> dict[str, Any]:
    fits = m.at_range(range_mm)
    errors = np.concatenate([w.std for w in fits])
    usual = float(np.median(errors[np.isfinite(errors)])) if np.isfinite(errors).any() else float("nan")
    places = max(4, decimals(usual, 5))
    rows = [
        {"j": j, "name": mode_name(j), "cells": [_mode_cell(w, j, places, m.reference_wavelength_nm) for w in fits]}
        for j in sorted({j for w in fits for j in w.noll})
    ]
    return {"range": millimetres(range_mm), "channels": [w.channel for w in fits], "rows": rows}


def _mode_cell(fit: Wavefront, j: int, places: int, reference_nm: float) -> dict[str, str]:
    if j not in fit.noll:
        return {"waves": UNKNOWN, "nm": UNKNOWN}
    value, std = (float(numbers[fit.noll.index(j)]) for numbers in (fit.waves, fit.std))
    return {"waves": plus_minus(value, std, places), "nm": fixed(value * reference_nm, 1)}


def _focus_rows(m: Measurement, focus: Focus) -> list[dict[str, str]]:
    return [
        {
            "channel": channel,
            "best": plus_minus(best.value, best.std),
            "residuals": ", ".join(fixed(1e3 * r, 2) for r in focus.residual_waves.get(channel, ())) or UNKNOWN,
        }
        for channel, best in focus.best_mm.items()
    ]


def _provenance(m: Measurement, plan: Plan) -> list[tuple[str, str]]:
    sensor, target = plan.sensor, plan.target
    conventions = {
        "corrected": "corrected: the sagitta is taken about the exit pupil",
        "thesis": "thesis: equation (4.40) as it is printed",
    }
    order = "" if target.order is None else f" of order {target.order}"
    frames = sorted({f for w in m.wavefronts for f in w.frames})
    return [
        ("labkit", m.version),
        ("Results made", m.created),
        ("Results folder", str(m.folder.resolve())),
        ("Plan, SHA-256", m.plan_sha256),
        ("Lens", f"focal length {plan.lens.focal_length_mm:g} mm, f/{plan.lens.f_number:g}"),
        ("Sensor", f"{sensor.pixel_pitch_um:g} µm pitch, fill factor {sensor.fill_factor:g}"),
        ("Target", f"{target.kind}{order}, {target.size_mm:g} mm, {target.surround} around it"),
        ("Reference wavelength", f"{m.reference_wavelength_nm:g} nm"),
        ("Focus convention", conventions.get(m.convention, m.convention)),
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
        ("Standard errors", "from the inverse Fisher information of the identifiable parameters"),
        ("Frames", f"{len(frames)}, listed above under “How they were fitted”" if frames else UNKNOWN),
    ]
