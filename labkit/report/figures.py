"""Every figure of a report, drawn and encoded; templates/figures.html.j2 has their captions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labkit.figure_style import THIRD_IN, Ink, channel_inks, styled
from labkit.optics.lens import defocus_waves
from labkit.report import charts, pictures
from labkit.report.curves import NEAREST_CURVE, ChannelFocus, Curves
from labkit.report.focus_charts import defocus_chart, energy_chart, residual_chart
from labkit.report.lens_tables import budget_name
from labkit.report.photographs import Photographs
from labkit.report.pictures import Plate, chip, drawing, picture
from labkit.report.table import bare, estimated, millimetres
from labkit.results import Results, Wavefront
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.report.field.plates import FieldArtist


@dataclass(frozen=True, slots=True)
class Artist:
    """Draws the plates of each section. A section without data has none."""

    results: Results
    curves: Sequence[Curves]
    photographs: Photographs
    field: FieldArtist | None = None

    @property
    def focused(self) -> list[ChannelFocus]:
        """Each channel at best focus."""
        return [c.focus for c in self.curves]

    @property
    def inks(self) -> dict[str, Ink]:
        """How each channel is drawn."""
        return channel_inks(self.results.channels)

    @property
    def reference_nm(self) -> float:
        """Reference wavelength."""
        return self.results.reference_wavelength_nm

    def at_best_focus(self) -> Iterator[Plate]:
        """Yield MTF, PSF and encircled energy; nothing if defocus alone was fitted."""
        curves = [c for c in self.curves if c.focus.fitted.noll]
        if not curves:
            return
        yield Plate(
            "mtf",
            [
                drawing(
                    "mtf",
                    charts.mtf_chart(self.results, c, self.inks[c.channel]),
                    c,
                    c.channel,
                )
                for c in curves
            ],
            across=3,
        )
        yield self._psfs([c.focus for c in curves])
        energy = drawing("encircled_energy", energy_chart(curves, self.inks), curves)
        yield Plate("encircled_energy", [energy])

    def _psfs(self, focused: Sequence[ChannelFocus]) -> Plate:
        half_um = pictures.FOCUSED_HALF_WIDTH_AIRY * max(
            b.fitted.wavelength_um * b.fitted.f_number for b in focused
        )
        panels = []
        for b in focused:
            title = f"{b.channel}   Strehl {estimated(b.best.strehl, least=3)}"
            figure = pictures.psf_picture({b.channel: b.fitted}, half_um, self.inks, title)
            panels.append(picture("psf", figure, b, b.channel))
        return Plate("psf", panels, across=3, width_um=2 * half_um)

    def focus(self) -> Iterator[Plate]:
        """Yield defocus against range, where several ranges were fitted."""
        ranges = {w.range_mm for w in self.results if w.defocus} - {None}
        if len(ranges) < 2:
            return
        focus = self.results.focus
        shortest_mm = NEAREST_CURVE * self.results.thin_lens.focal_length_mm
        figure = defocus_chart(self.results, focus, self._law, shortest_mm)
        panels = [drawing("focus", figure)]
        if focus is not None:
            rest = residual_chart(self.results, focus, shortest_mm)
            panels.append(drawing("focus_residuals", rest))
        yield Plate("focus", panels)

    def _law(self, channel: str, ranges_mm: Floats) -> Floats:
        """Return the fitted defocus of a channel at stated ranges."""
        results = self.results
        assert results.focus is not None
        zero_mm = results.range_zero_mm
        return defocus_waves(
            results.thin_lens,
            np.asarray(ranges_mm, float) + zero_mm,
            results.focus.best_focus_mm[channel].value + zero_mm,
            self.reference_nm,
            results.plan.fit.convention,
        )

    def through_focus(self) -> Iterator[Plate]:
        """Yield Strehl ratio and MTF through focus."""
        strehl = charts.strehl_chart(self.curves, self.inks)
        modulation = charts.modulation_chart(self.curves, self.inks)
        yield Plate(
            "through_focus",
            [
                drawing("strehl_through_focus", strehl),
                drawing("mtf_through_focus", modulation),
            ],
        )

    def wavefronts(self) -> Iterator[Plate]:
        """Yield the path difference at best focus and as photographed, and the pupil unless round."""
        limit = pictures.map_limit([b.fitted for b in self.focused])
        panels = []
        for b in self.focused:
            figure = pictures.opd_picture({b.channel: b.fitted}, limit, self.reference_nm)
            panels.append(picture("opd", figure, b, b.channel))
        yield Plate("opd", panels, across=3)
        limit = pictures.map_limit([w.fitted for w in self.results])
        panels = []
        for range_mm, fits in self._by_range():
            figure = pictures.opd_picture(
                {w.channel: w.fitted for w in fits},
                limit,
                self.reference_nm,
                millimetres(range_mm),
            )
            panels.append(picture("opd_photographed", figure, range_mm, bare(range_mm)))
        yield Plate("opd_photographed", panels, across=3)
        first = self.results.wavefronts[0]
        if not first.rim.is_round and first.tile is None:
            yield Plate("pupil", [drawing("pupil", charts.pupil_chart(first.rim))])

    def _by_range(self) -> list[tuple[float | None, Sequence[Wavefront]]]:
        return [(r, self.results.at_range(r)) for r in self.results.ranges_mm]

    def modes(self) -> Iterator[Plate]:
        """Yield the modes at best focus."""
        figure = charts.zernike_chart(self.focused, self.reference_nm, self.inks)
        if figure is not None:
            yield Plate("zernike", [drawing("zernike", figure)])

    def camera(self) -> Iterator[Plate]:
        """Yield the spectrum of the residuals, where parts of the camera were tested for."""
        spectra = [s for w in self.results if (s := w.residual_spectrum) is not None]
        if not spectra or not self.results.parts_tried:
            return
        without = [s.without_parts for s in spectra if s.without_parts is not None]
        most = [
            float(np.mean([power.max() for power in powers])) if powers else None
            for powers in ([s.power for s in spectra], without)
        ]
        figure = charts.spectrum_chart(self.results)
        yield Plate("residual_spectrum", [drawing("residual_spectrum", figure, most)])

    def budget(self) -> Iterator[Plate]:
        """Yield the sources of the errors."""
        if self.results.budget:
            shares = [
                (budget_name(key)[0], charts.variance_shares(budget))
                for key, budget in self.results.budget.items()
            ]
            figure = charts.budget_chart(self.results)
            yield Plate("budget", [drawing("budget", figure, shares)])

    def place(self) -> Iterator[Plate]:
        """Yield the target's place in the frame."""
        figure = pictures.place_picture(self.results, self.photographs)
        if figure is not None:
            where = "the frame" if self.photographs.size_px else "the part that was fitted"
            yield Plate("place", [picture("place", figure, where)])

    def psfs_photographed(self) -> Iterator[Plate]:
        """Yield the PSFs of each range, defocus included."""
        half_um = pictures.psf_half_width_um(self.results.wavefronts)
        panels = []
        for range_mm, fits in self._by_range():
            of = {w.channel: w.fitted for w in fits}
            title = millimetres(range_mm)
            figure = pictures.psf_picture(of, half_um, self.inks, title)
            panels.append(picture("psf_photographed", figure, range_mm, bare(range_mm)))
        yield Plate("psf_photographed", panels, across=3, width_um=2 * half_um)

    def fits(self) -> Iterator[Plate]:
        """Yield data, model and residual of each fit."""
        panels = [chip(w, w.residuals) for w in self.results if w.residuals is not None]
        if panels:
            yield Plate("fit", panels)

    def quantiles(self) -> Iterator[Plate]:
        """Yield the quantiles of the residuals of each range."""
        panels = []
        for range_mm, fits in self._by_range():
            values = {w.channel: w.residuals.normalised for w in fits if w.residuals}
            if values:
                figure = charts.quantile_chart(
                    millimetres(range_mm), values, self.inks, "residuals", (THIRD_IN, 2.9)
                )
                panels.append(drawing("residuals", figure, range_mm, bare(range_mm)))
        if panels:
            yield Plate("residuals", panels, across=3)


def _of_field(
    draw: Callable[[FieldArtist, Artist], Iterable[Plate]],
) -> Callable[[Artist], Iterable[Plate]]:
    """Return a drawer of the field's plates, which are none without its model."""
    return lambda artist: draw(artist.field, artist) if artist.field is not None else ()


DRAWN_SECTIONS: dict[str, tuple[str, Callable[[Artist], Iterable[Plate]]]] = {
    "field-focus": ("focus over the frame", _of_field(lambda field, _: field.focus())),
    "field-contrast": ("MTF over the frame", _of_field(lambda field, _: field.contrast())),
    "field-shapes": (
        "aberrations over the frame",
        _of_field(lambda field, _: field.shapes()),
    ),
    "field-light": ("illumination", _of_field(lambda field, _: field.light())),
    "field-places": ("distortion", _of_field(lambda field, _: field.places())),
    "field-tiles": (
        "tiles",
        _of_field(lambda field, artist: field.tiles(artist.photographs)),
    ),
    "field-others": (
        "other channels over the frame",
        _of_field(lambda field, _: field.others()),
    ),
    "best-focus": ("best focus", Artist.at_best_focus),
    "focus": ("focus", Artist.focus),
    "depth": ("through focus", Artist.through_focus),
    "maps": ("wavefronts", Artist.wavefronts),
    "modes": ("modes", Artist.modes),
    "camera": ("camera", Artist.camera),
    "budget": ("errors", Artist.budget),
    "place": ("target", Artist.place),
    "psf": ("PSFs as photographed", Artist.psfs_photographed),
    "fits": ("data and residuals", Artist.fits),
    "residuals": ("residuals' quantiles", Artist.quantiles),
}
"""Sections of the page with figures: their names in words, and their drawers."""


def draw_figures(
    artist: Artist, begin: Callable[[str], None] = lambda words: None
) -> dict[str, list[Plate]]:
    """Return all plates by section; sections without any are left out.

    begin: called with the name of each section before its figures are drawn
    """
    drawn = dict[str, list[Plate]]()
    with styled():
        for section, (words, draw) in DRAWN_SECTIONS.items():
            begin(f"drawing {words}")
            drawn[section] = list(draw(artist))
    return {section: plates for section, plates in drawn.items() if plates}
