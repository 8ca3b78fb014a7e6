"""Every figure of a report: drawn, encoded, and put into words."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from re import sub

import numpy as np
from matplotlib.figure import Figure

from labkit.optics.lens import defocus_waves
from labkit.report import charts, pictures
from labkit.report.best_focus import SHARE, BestFocus, nyquist_per_mm
from labkit.report.budget_chart import budget_chart, variance_shares
from labkit.report.camera_charts import spectrum_chart
from labkit.report.focus_charts import energy_chart, opd_picture
from labkit.report.lens_table import SOURCES, budget_name, lens_of
from labkit.report.mtf_charts import focus_mtf_chart, mtf_chart
from labkit.report.quantities import estimated, fixed, millimetres, plus_minus
from labkit.report.style import in_groups, png, styled, svg
from labkit.results import Residuals, Results, Wavefront
from labkit.types import Floats

PER_FIGURE = 6  # ranges in one figure


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure: its file's name, its width, its bytes (as SVG too where it is made of lines), and its words."""

    name: str
    width_in: float
    png: bytes
    svg: bytes | None
    alt: str
    caption: str


def draw_figures(results: Results, focused: Sequence[BestFocus]) -> dict[str, list[Drawn]]:
    """All figures, by the section of the report they belong to; a section without any is left out.

    focused: each channel at best focus.
    """
    with styled():
        sections = {
            "focus": list(_focus(results)),
            "camera": list(_camera(results)),
            "budget": list(_budget(results)),
            "best-focus": list(_at_best_focus(results, focused)),
            "fits": list(_fits(results)),
            "psf": list(_psfs(results)),
            "mtf": list(_mtfs(results)),
            "zernike": list(_zernikes(results)),
            "residuals": list(_quantiles(results)),
        }
    return {name: drawn for name, drawn in sections.items() if drawn}


def _chart(name: str, figure: Figure, alt: str, caption: str) -> Drawn:
    image = png(figure)
    figure.set_layout_engine("none")  # as it is laid out now: to do it once more for SVG takes as long as drawing it
    return Drawn(name, figure.get_figwidth(), image, svg(figure), alt, caption)


def _picture(name: str, figure: Figure, alt: str, caption: str) -> Drawn:
    return Drawn(name, figure.get_figwidth(), png(figure), None, alt, caption)


def _file_name(*parts: object) -> str:
    return sub(r"[^A-Za-z0-9.+_-]", "-", "_".join(map(str, parts)))


def _focus(results: Results) -> Iterator[Drawn]:
    if len({w.range_mm for w in results.wavefronts if w.range_mm is not None and w.defocus}) < 2:
        return
    focus, plan = results.focus, results.plan
    lens, zero_mm = lens_of(results)

    def curve(channel: str, ranges_mm: Floats) -> Floats:
        assert focus is not None
        best_mm = focus.best_focus_mm[channel].value + zero_mm
        true_mm = np.asarray(ranges_mm, float) + zero_mm
        return defocus_waves(lens, true_mm, best_mm, results.reference_wavelength_nm, plan.fit.convention)

    figure = charts.focus_chart(results, focus, curve, 1.02 * lens.focal_length_mm)
    if focus is None:
        yield _chart("focus", figure, "Defocus against range.", "Defocus of each fit. No focus fit was made.")
        return
    best = "; ".join(f"{c} {plus_minus(e.value, e.std)} mm" for c, e in focus.best_focus_mm.items())
    caption = (
        "Defocus (points), the law of the lens as it was estimated (curves), and best focus (dashed, with one standard "
        "error shaded). Positive: the target lies beyond best focus. "
    )
    caption += (
        "Below: what the fit leaves, with each defocus's standard error; points stand side by side to be seen."
        if results.lens is None
        else "The points are as the whole session has them. Below: what each fit alone measured, less that; alone, it "
        "knows its defocus only as well as the f-number of its cone. Points stand side by side to be seen."
    )
    yield _chart("focus", figure, f"Defocus against range, with fitted curves. Best focus: {best}.", caption)


def _camera(results: Results) -> Iterator[Drawn]:
    spectra = [w.spectrum for w in results if w.spectrum is not None]
    if not spectra or not results.parts_tried:
        return
    now = float(np.mean([s.power.max() for s in spectra]))
    alt = (
        f"What is left of the data, by spatial frequency: {fixed(now, 2)} times the noise where it is most, on average."
    )
    before = [s.without_parts.max() for s in spectra if s.without_parts is not None]
    if before:
        alt += f" Without the parts that were found: {fixed(float(np.mean(before)), 2)} times."
    caption = (
        "What the model leaves of the data, over the noise, by spatial frequency in the raw's pixels; each line is the mean "
        "of a channel's fits. Noise alone leaves 1."
    ) + (" Dashed: of the fits that were made before those parts were in the model." if before else "")
    yield _chart("residual_spectrum", spectrum_chart(results), alt, caption)


def _budget(results: Results) -> Iterator[Drawn]:
    if not results.budget:
        return
    each = "; ".join(
        f"{budget_name(key)[0]} "
        + ", ".join(f"{share:.0f} % {source}" for source, share in zip(SOURCES, shares, strict=True))
        for key, budget in results.budget.items()
        for shares in [variance_shares(budget)]
    )
    caption = (
        "Of each number the share of its variance by source. Squares of standard errors add up: a source of half the whole "
        "error makes a quarter of the variance."
    )
    yield _chart("budget", budget_chart(results), f"Shares of the variance: {each}.", caption)


def _at_best_focus(results: Results, focused: Sequence[BestFocus]) -> Iterator[Drawn]:
    reference_nm = results.reference_wavelength_nm
    each = "; ".join(f"{b.channel} RMS {estimated(b.rms, least=3)}" for b in focused)
    caption = (
        f"Path difference over the exit pupil without defocus, waves at {reference_nm:g} nm, one scale for all channels; "
        "x to the right along the sensor's rows, y down. P–V is from the lowest to the highest point, the rim included."
    )
    picture = opd_picture(focused, reference_nm)
    yield _picture("opd", picture, f"Wavefront maps without defocus, waves: {each}.", caption)
    each = "; ".join(
        f"{b.channel} {estimated(b.mtf50['x'])} along x, {estimated(b.mtf50['y'])} along y" for b in focused
    )
    alt = f"Modulation transfer functions at best focus. MTF50, cycles/mm: {each}."
    yield _chart("mtf_at_best_focus", focus_mtf_chart(results, focused), alt, _mtf_words(results))
    each = "; ".join(f"{b.channel} {estimated(b.energy_radius_um)}" for b in focused)
    alt = f"Encircled energy at best focus. Radius of {100 * SHARE:.0f} %, µm: {each}."
    caption = (
        "Share of all the light within circles about the image's centroid, its halo included; optics alone, without the "
        "pixel's aperture. Dotted: the diffraction limit. Shaded: one standard error, where it is wider than the line."
    )
    yield _chart("encircled_energy", energy_chart(results, focused), alt, caption)


def _fits(results: Results) -> Iterator[Drawn]:
    for fit in results.wavefronts:
        if fit.residuals is None:
            continue
        where = f"{millimetres(fit.range_mm)}, channel {fit.channel}"
        alt = f"Raw chip, model and normalised residual: {where}."
        yield _picture(
            _file_name("fit", fit.key), pictures.fit_picture(fit.residuals), alt, _fit_caption(fit, fit.residuals)
        )


def _fit_caption(fit: Wavefront, residuals: Residuals) -> str:
    frames, planes, rows, cols = residuals.data.shape
    z = residuals.normalised
    used = int(np.isfinite(z).sum())
    text = f"{millimetres(fit.range_mm)}, {fit.channel}: {rows} × {cols} pixels"
    if frames * planes == 1:
        return f"{text}, {used} used; residual {_rms(z):.3f} σ RMS."
    each = ", ".join(f"{_rms(z[f, p]):.3f}" for f in range(frames) for p in range(planes))
    counted = [f"{n} {word}{'s' if n > 1 else ''}" for n, word in ((frames, "frame"), (planes, "plane")) if n > 1]
    return (
        f"{text}; the first of {' of '.join(counted)}, fitted together ({used} used). Residual of each, σ RMS: {each}."
    )


def _rms(z: Floats) -> float:
    finite = z[np.isfinite(z)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def _psfs(results: Results) -> Iterator[Drawn]:
    half_width = pictures.psf_half_width_um(results)
    caption = (
        f"Optics alone, without the pixel's aperture. Every panel is {2 * half_width:.3g} µm wide on the sensor, rows "
        "down and columns right as there, and runs from zero (white) to its own peak on a square-root stretch. Dashed: "
        "the Airy radius, 1.22 λN. Number: the Strehl ratio, defocus included."
    )
    groups = in_groups(results.ranges_mm, PER_FIGURE)
    for k, ranges in enumerate(groups):
        figure = pictures.psf_picture(results, ranges, half_width)
        alt = f"Point-spread functions at {_listed(ranges)}, channels {', '.join(results.channels)}."
        yield _picture(_numbered("psf", k, len(groups)), figure, alt, caption)


def _mtfs(results: Results) -> Iterator[Drawn]:
    caption = f"As photographed, defocus included. {_mtf_words(results)}"
    groups = in_groups(results.ranges_mm, PER_FIGURE)
    for k, ranges in enumerate(groups):
        alt = f"Modulation transfer functions at {_listed(ranges)}."
        yield _chart(_numbered("mtf", k, len(groups)), mtf_chart(results, ranges), alt, caption)


def _mtf_words(results: Results) -> str:
    limits = [nyquist_per_mm(results, channel) for channel in results.channels]
    full, plane = limits[0][0], min(plane for _, plane in limits)
    text = (
        "Optics alone, without the pixel's aperture. Solid: along x, right on the sensor; dashed: along y, down; dotted: "
        "the diffraction limit of this f-number and wavelength. Shaded: one standard error, where it is wider than the "
        f"line. Nyquist's frequency of all pixels is {full:.0f} cycles/mm for {results.plan.sensor.pixel_pitch_um:g} µm"
    )
    return f"{text}, that of the pixels of one colour {plane:.0f}." if plane < full else f"{text}."


def _zernikes(results: Results) -> Iterator[Drawn]:
    reach = [
        abs(v) + (s if np.isfinite(s) else 0.0)
        for w in results.wavefronts
        for j, v, s in zip(w.noll, w.waves, w.std, strict=True)
        if j != 4
    ]
    measured = [w.defocus.value for w in results.wavefronts if w.defocus]
    defocus = 1.1 * min([0.0, *measured]), 1.1 * max([0.0, *measured])
    for range_mm in results.ranges_mm:
        figure = charts.zernike_chart(results, range_mm, defocus, 1.25 * max(reach, default=0.0))
        if figure is None:
            continue
        where = millimetres(range_mm)
        rms = "; ".join(f"{w.channel} {w.rms(without=(4,)).value:.4f}" for w in results.at_range(range_mm))
        alt = f"Zernike coefficients at {where}. RMS without defocus, waves: {rms}."
        errors = np.concatenate([w.std for w in results.at_range(range_mm)])
        caption = f"{where.capitalize()}. Defocus has a scale of its own. Black: one standard error, {_span(errors)}."
        yield _chart(_file_name("zernike", "none" if range_mm is None else f"{range_mm:g}"), figure, alt, caption)


def _quantiles(results: Results) -> Iterator[Drawn]:
    ranges_with = [r for r in results.ranges_mm if any(w.residuals for w in results.at_range(r))]
    caption = (
        "Normalised residuals of all pixels against the normal law, thinned in the middle and complete in the tails. "
        "On the line: the noise is as the model has it. Shaded: where each point falls in 99 of 100 cases."
    )
    groups = in_groups(ranges_with, PER_FIGURE)
    for k, ranges in enumerate(groups):
        alt = f"Q-Q plot of the normalised residuals at {_listed(ranges)}."
        yield _chart(_numbered("residuals", k, len(groups)), charts.quantile_chart(results, ranges), alt, caption)


def _span(values: Floats) -> str:
    finite = values[np.isfinite(values)]
    return f"{finite.min():.1g} to {finite.max():.1g} waves" if finite.size else "not known"


def _listed(ranges: Sequence[float | None]) -> str:
    return ", ".join(millimetres(r) for r in ranges)


def _numbered(name: str, k: int, count: int) -> str:
    return name if count == 1 else f"{name}_{k + 1}"
