"""Every figure of a report: drawn, encoded, and put into words."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from labkit.figure_style import channel_inks, styled
from labkit.optics.lens import defocus_waves
from labkit.optics.rim import Rim
from labkit.report import charts, pictures
from labkit.report.charts import (
    budget_chart,
    modulation_chart,
    mtf_chart,
    pupil_chart,
    spectrum_chart,
    strehl_chart,
    variance_shares,
)
from labkit.report.curves import (
    MTF_DIRECTIONS,
    NEAREST_CURVE,
    ChannelFocus,
    Curves,
    full_nyquist_per_mm,
)
from labkit.report.focus_charts import defocus_chart, energy_chart, residual_chart
from labkit.report.lens_tables import SOURCES, budget_name
from labkit.report.photographs import Photographs
from labkit.report.pictures import Panel, Plate, chip, drawing, picture
from labkit.report.table import estimated, fixed, millimetres, plus_minus
from labkit.results import Residuals, Results, Wavefront
from labkit.types import Floats


def draw_figures(
    results: Results,
    curves: Sequence[Curves],
    photographs: Photographs,
    begin: Callable[[str], None] = lambda words: None,
) -> dict[str, list[Plate]]:
    """Draw all plates, by the section of the report they belong to; a section without any is left out.

    begin: called with what is drawn next, `DRAWINGS` times.
    """
    drawn = dict[str, list[Plate]]()
    with styled():
        for section, (words, draw) in _sections(results, curves, photographs).items():
            begin(f"drawing {words}")
            drawn[section] = list(draw())
    return {section: plates for section, plates in drawn.items() if plates}


def _sections(
    results: Results, curves: Sequence[Curves], photographs: Photographs
) -> dict[str, tuple[str, Callable[[], Iterable[Plate]]]]:
    """Return what is drawn in each section, in words, and what draws it."""
    focused = [c.focus for c in curves]
    return {
        "best-focus": ("best focus", lambda: _at_best_focus(results, curves)),
        "focus": ("focus", lambda: _focus(results)),
        "depth": ("through focus", lambda: [_through(results, curves)]),
        "maps": ("wavefronts", lambda: _wavefronts(results, focused)),
        "modes": ("modes", lambda: _modes(results, focused)),
        "camera": ("camera", lambda: _camera(results)),
        "budget": ("errors", lambda: _budget(results)),
        "place": ("target", lambda: _place(results, photographs)),
        "psf": ("PSFs as photographed", lambda: [_psfs_photographed(results)]),
        "fits": ("data and residuals", lambda: _fits(results)),
        "residuals": ("residuals' quantiles", lambda: _quantiles(results)),
    }


DRAWINGS = 11
"""Number of sections that are drawn."""


def _at_best_focus(results: Results, curves: Sequence[Curves]) -> Iterator[Plate]:
    """Yield what the lens does; nothing where no mode but defocus was fitted."""
    curves = [c for c in curves if c.focus.fitted.noll]
    if not curves:
        return
    yield _mtfs(results, curves)
    yield _psfs([c.focus for c in curves])
    yield _energy(results, curves)


def _wavefronts(results: Results, focused: Sequence[ChannelFocus]) -> Iterator[Plate]:
    yield _maps(results, focused)
    yield _maps_photographed(results)
    if not results.wavefronts[0].rim.is_round:
        yield _pupil(results.wavefronts[0])


def _pupil(wavefront: Wavefront) -> Plate:
    clear, outer = (
        estimated(number)
        for number in (wavefront.working_f_number, wavefront.outer_f_number)
    )
    alt = f"The pupil as found: f/{clear} by its clear area, f/{outer} by the circle around it."
    caption = (
        "The pupil as found, x to the right along the sensor's rows, y down. Dashed: the circle of equal clear area, by which "
        f"the f-number is counted ({clear} at the sensor) and over which the modes are Zernike's; grey: the full pupil "
        f"({outer}). {_vignetting(wavefront.rim)}RMS, Strehl ratio, MTF and diffraction limits are those of the clear part."
    )
    return Plate((drawing("pupil", pupil_chart(wavefront.rim), alt),), caption)


def _vignetting(rim: Rim) -> str:
    """Return a sentence on the light that a cat's eye leaves; empty without one."""
    if rim.area == 1:
        return ""
    return f"A cat's eye leaves {rim.area:.0%} of the light; f-number and modes stay those of the pupil before the cut. "


def _mtfs(results: Results, curves: Sequence[Curves]) -> Plate:
    inks = channel_inks(results.channels)
    panels = []
    for c in curves:
        halves = ", ".join(
            f"{estimated(c.focus.mtf50(d))} along {d}" for d in MTF_DIRECTIONS
        )
        alt = f"MTF of channel {c.channel} at best focus. MTF50, cycles/mm: {halves}."
        panels.append(
            drawing(f"mtf_{c.channel}", mtf_chart(results, c, inks[c.channel]), alt)
        )
    full = full_nyquist_per_mm(results.plan.sensor)
    plane = min(c.focus.nyquist_per_mm for c in curves)
    caption = (
        "MTF at best focus. Solid: along x, right on the sensor; dashed: along y, down; shaded: one standard error, where "
        "it is wider than the line. Dotted: the diffraction limit of this f-number and light. Pale: with the pixel's "
        f"aperture. Grey, upright: Nyquist's frequency of all pixels, {full:.0f} cycles/mm"
    )
    caption += (
        f", and dashed that of the pixels of one colour, {plane:.0f}."
        if plane < full
        else "."
    )
    return Plate(tuple(panels), caption, 3)


def _psfs(focused: Sequence[ChannelFocus]) -> Plate:
    inks = channel_inks(focus.channel for focus in focused)
    width = pictures.FOCUSED_HALF_WIDTH_AIRY * max(
        b.fitted.wavelength_um * b.fitted.f_number for b in focused
    )
    panels = []
    for focus in focused:
        alt = f"Point-spread function of channel {focus.channel} at best focus; Strehl ratio {estimated(focus.best.strehl)}."
        title = f"{focus.channel}   Strehl {estimated(focus.best.strehl, least=3)}"
        figure = pictures.psf_picture({focus.channel: focus.fitted}, width, inks, title)
        panels.append(picture(f"psf_{focus.channel}", figure, alt))
    caption = (
        f"Point-spread functions at best focus: optics alone, {2 * width:.2g} µm wide, rows down and columns right as on the "
        "sensor, from zero (white) to each one's peak on a square-root stretch. Dashed: the Airy radius, 1.22 λN."
    )
    return Plate(tuple(panels), caption, 3)


def _energy(results: Results, curves: Sequence[Curves]) -> Plate:
    within = "; ".join(
        f"{c.channel} {estimated(c.focus.best.energy_radius())}" for c in curves
    )
    alt = f"Encircled energy at best focus. Radius of 80 % of the energy, µm: {within}."
    caption = (
        "Encircled energy at best focus: the share of all light within circles about the image's centroid, its halo "
        "included; optics alone. "
        "Dotted: the diffraction limit. Shaded: one standard error, where it is wider than the line."
    )
    return Plate(
        (
            drawing(
                "encircled_energy",
                energy_chart(curves, channel_inks(results.channels)),
                alt,
            ),
        ),
        caption,
    )


def _focus(results: Results) -> Iterator[Plate]:
    if len({w.range_mm for w in results if w.range_mm is not None and w.defocus}) < 2:
        return
    focus = results.focus
    plan = results.plan
    lens = results.thin_lens
    zero_mm = results.range_zero_mm

    def curve(channel: str, ranges_mm: Floats) -> Floats:
        assert focus is not None
        best_mm = focus.best_focus_mm[channel].value + zero_mm
        true_mm = np.asarray(ranges_mm, float) + zero_mm
        return defocus_waves(
            lens, true_mm, best_mm, results.reference_wavelength_nm, plan.fit.convention
        )

    shortest_mm = NEAREST_CURVE * lens.focal_length_mm
    figure = defocus_chart(results, focus, curve, shortest_mm)
    if focus is None:
        panel = drawing("focus", figure, "Defocus against range.")
        yield Plate((panel,), "Defocus of each fit. No focus fit was made.")
        return
    best = "; ".join(
        f"{c} {plus_minus(e.value, e.std)} mm" for c, e in focus.best_focus_mm.items()
    )
    caption = (
        "Defocus (points), the law of the lens as it was estimated (curves), and best focus (dashed, with one standard "
        "error shaded). Positive: the target lies beyond best focus. A defocus residual is what a fit alone measured less "
        "the curve, with one standard error; points of one range are drawn next to each other."
    )
    if results.lens is not None:
        caption += " The points are the whole session's estimates."
    alt = f"Defocus against range, with fitted curves. Best focus: {best}."
    rest = drawing(
        "focus_residuals",
        residual_chart(results, focus, shortest_mm),
        "Defocus residuals of the focus fit, by range.",
    )
    yield Plate((drawing("focus", figure, alt), rest), caption)


def _through(results: Results, curves: Sequence[Curves]) -> Plate:
    inks = channel_inks(results.channels)
    highest = ", ".join(
        f"{c.channel} {fixed(float(c.strehl.value.max()), 3)}" for c in curves
    )
    where = "range" if curves[0].in_ranges else "shift of the sensor"
    panels = (
        drawing(
            "strehl_through_focus",
            strehl_chart(curves, inks),
            f"Strehl ratio against {where}; highest: {highest}.",
        ),
        drawing(
            "mtf_through_focus",
            modulation_chart(curves, inks),
            f"MTF at {curves[0].through_per_mm:.3g} cycles/mm along x and y against {where}.",
        ),
    )
    caption = (
        "Strehl ratio through focus, with bars for the depth of focus, in which it is at least 0.8 of its highest, and a mark "
        "at the highest; and MTF of the optics at half of Nyquist's frequency of all pixels, solid along x, dashed "
        "along y. Shaded: one standard error, where it is wider than the line. All modes but defocus are as at best focus."
    ) + _if_open(results, " The sign of defocus is open: curves may as well be mirrored.")
    return Plate(panels, caption)


def _maps(results: Results, focused: Sequence[ChannelFocus]) -> Plate:
    limit = pictures.map_limit([focus.fitted for focus in focused])
    panels = []
    for focus in focused:
        rms, span = (
            estimated(number, least=3)
            for number in (focus.best.rms, focus.best.peak_to_valley)
        )
        alt = f"Path difference of channel {focus.channel} without defocus: RMS {rms}, P–V {span} waves."
        figure = pictures.opd_picture(
            {focus.channel: focus.fitted}, limit, results.reference_wavelength_nm
        )
        panels.append(picture(f"opd_{focus.channel}", figure, alt))
    caption = (
        f"Path difference over the exit pupil without defocus, in waves at {results.reference_wavelength_nm:g} nm and in nm, "
        "one scale for all; x to the right along the sensor's rows, y down."
    ) + _if_open(results, " As likely is the twin: turned by half a turn, and negated.")
    return Plate(tuple(panels), caption, 3)


def _maps_photographed(results: Results) -> Plate:
    limit = pictures.map_limit([w.fitted for w in results])
    panels = []
    for range_mm in results.ranges_mm:
        fits = results.at_range(range_mm)
        rms = ", ".join(f"{w.channel} {estimated(w.rms(), least=4)}" for w in fits)
        alt = f"Path difference as photographed at {millimetres(range_mm)}, defocus included. RMS, waves: {rms}."
        figure = pictures.opd_picture(
            {w.channel: w.fitted for w in fits},
            limit,
            results.reference_wavelength_nm,
            millimetres(range_mm),
        )
        panels.append(picture(f"opd_photographed_{_place_name(range_mm)}", figure, alt))
    return Plate(
        tuple(panels),
        "The same as photographed at each range, defocus included; another scale.",
        3,
    )


def _modes(results: Results, focused: Sequence[ChannelFocus]) -> Iterator[Plate]:
    figure = charts.zernike_chart(
        focused, results.reference_wavelength_nm, channel_inks(results.channels)
    )
    if figure is not None:
        rms = "; ".join(f"{f.channel} {estimated(f.best.rms)}" for f in focused)
        alt = f"Zernike coefficients without defocus. RMS, waves: {rms}."
        caption = (
            "Zernike modes at best focus, by Noll's numbers. Black: one standard error."
            + _if_open(results, " Pale: the twin, which is as likely.")
        )
        yield Plate((drawing("zernike", figure, alt),), caption)


def _if_open(results: Results, words: str) -> str:
    """Return words for results in which a wavefront's sign is open."""
    return words if any(w.sign_open for w in results) else ""


def _camera(results: Results) -> Iterator[Plate]:
    spectra = [w.residual_spectrum for w in results if w.residual_spectrum is not None]
    if not spectra or not results.parts_tried:
        return
    now = float(np.mean([s.power.max() for s in spectra]))
    alt = f"What is left of the data, by spatial frequency: {fixed(now, 2)} times the noise where it is most, on average."
    before = [s.without_parts.max() for s in spectra if s.without_parts is not None]
    if before:
        alt += (
            f" Without the parts that were found: {fixed(float(np.mean(before)), 2)} times."
        )
    caption = (
        "What the model leaves of the data, over the noise, by spatial frequency in the raw's pixels; each line is the mean "
        "of a channel's fits. Noise alone leaves 1."
    ) + (" Dashed: of the model as the plan states it." if before else "")
    yield Plate((drawing("residual_spectrum", spectrum_chart(results), alt),), caption)


def _budget(results: Results) -> Iterator[Plate]:
    if not results.budget:
        return
    each = "; ".join(
        f"{budget_name(key)[0]} "
        + ", ".join(
            f"{share:.0f} % {source}" for source, share in zip(SOURCES, shares, strict=True)
        )
        for key, budget in results.budget.items()
        for shares in [variance_shares(budget)]
    )
    caption = (
        "Of each number the share of its variance by source. Squares of standard errors add up: a source of half the whole "
        "error makes a quarter of the variance."
    )
    yield Plate(
        (drawing("budget", budget_chart(results), f"Shares of the variance: {each}."),),
        caption,
    )


def _place(results: Results, photographs: Photographs) -> Iterator[Plate]:
    figure = pictures.place_picture(results, photographs)
    if figure is not None:
        where = "the frame" if photographs.size_px else "the part that was fitted"
        alt = f"Where the target stood in {where} at {_listed(results.ranges_mm)}."
        caption = f"The target's outline as fitted at each range (yellow: the longest) in {where}; +: its centre."
        yield Plate((picture("place", figure, alt),), caption)


def _psfs_photographed(results: Results) -> Plate:
    inks = channel_inks(results.channels)
    width = pictures.psf_half_width_um(results.wavefronts)
    panels = []
    for range_mm in results.ranges_mm:
        fits = {w.channel: w.fitted for w in results.at_range(range_mm)}
        alt = f"Point-spread functions as photographed at {millimetres(range_mm)}, channels {', '.join(fits)}."
        figure = pictures.psf_picture(fits, width, inks, millimetres(range_mm))
        panels.append(picture(f"psf_photographed_{_place_name(range_mm)}", figure, alt))
    caption = (
        f"As photographed, defocus included: every square is {2 * width:.3g} µm wide on the sensor, each stretched to its own "
        "peak. It is these that were fitted; what the lens does is what it does at best focus."
    )
    return Plate(tuple(panels), caption, 3)


def _fits(results: Results) -> Iterator[Plate]:
    panels = [_fit(w, w.residuals) for w in results if w.residuals is not None]
    if panels:
        yield Plate(
            tuple(panels),
            "Each from left to right: raw counts; the model, on the same scale; the residual.",
        )


def _fit(fit: Wavefront, residuals: Residuals) -> Panel:
    content, low, high = pictures.chip_image(residuals)
    where = f"{millimetres(fit.range_mm)}, {fit.channel}"
    frames, planes, rows, cols = residuals.data.shape
    z = residuals.normalised
    each = ", ".join(f"{_rms(z[f, p]):.3f}" for f in range(frames) for p in range(planes))
    counted = [
        f"{n} {word}{'s' if n > 1 else ''}"
        for n, word in ((frames, "frame"), (planes, "plane"))
        if n > 1
    ]
    first = f"; the first of {' of '.join(counted)}" if counted else ""
    heading = (
        f"{where}: {rows} × {cols} pixels{first}. Black {low:.0f}, white {high:.0f} counts. Residual, σ RMS "
        f"(1 is noise): {each}."
    )
    return chip(
        f"fit_{fit.key}",
        content,
        f"Raw chip, model and normalised residual: {where}.",
        heading,
    )


def _rms(z: Floats) -> float:
    finite = z[np.isfinite(z)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def _quantiles(results: Results) -> Iterator[Plate]:
    ranges = [r for r in results.ranges_mm if any(w.residuals for w in results.at_range(r))]
    panels = []
    for range_mm in ranges:
        alt = f"Q-Q plot of the normalised residuals at {millimetres(range_mm)}."
        panels.append(
            drawing(
                f"residuals_{_place_name(range_mm)}",
                charts.quantile_chart(results, range_mm),
                alt,
            )
        )
    caption = (
        "Normalised residuals of all pixels against the normal law, thinned in the middle and complete in the tails. "
        "On the line: the noise is as the model has it. Shaded: where each point falls in 99 of 100 cases."
    )
    if panels:
        yield Plate(tuple(panels), caption, 3)


def _place_name(range_mm: float | None) -> str:
    return "none" if range_mm is None else f"{range_mm:g}"


def _listed(ranges: Sequence[float | None]) -> str:
    return ", ".join(millimetres(r) for r in ranges)
