"""Results as tables: the lens in each channel, rows of text for a terminal, HTML for a notebook."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.optics.wavefront import DEFOCUS
from labkit.results.model import Focus, Lens, Wavefront
from labkit.results.verdicts import confirmed, model_word, optimum_word, stated
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results


from collections.abc import Mapping
from dataclasses import replace
from html import escape
from math import sqrt

from labkit.results.model import PartTried
from labkit.uncertain import decimals

REFERENCE = "G"


@dataclass(frozen=True, slots=True)
class ColourShift:
    """Best focus of a channel less that of the reference channel.

    Attributes
    ----------
    channel, reference : names of the channels
    range_shift : difference of the two ranges of best focus, mm; positive where the channel focuses farther away
    sensor_shift : how far the channel's image of a target at the reference's best focus is behind the sensor, um; None where
        no lens was estimated
    """

    channel: str
    reference: str
    range_shift: Uncertain
    sensor_shift: Uncertain | None

    @property
    def name(self) -> str:
        """The two channels, such as "R - G", with a minus sign."""
        return f"{self.channel} \N{MINUS SIGN} {self.reference}"


def longitudinal_colour(focus: Focus | None, lens: Lens | None) -> tuple[ColourShift, ...]:
    """Return the longitudinal colour of a session, with correlated errors.

    The channels of a session share ranges, focal length and f-number, so that errors of their best focus are alike: the error
    of a difference is mostly smaller than that of either.

    Parameters
    ----------
    focus : best focus of each channel, with its covariance; without one, errors count as independent
    lens : the session's lens, for shifts on the sensor

    Returns
    -------
    A shift for every channel but the reference, "G" or else the first; empty with fewer than two channels.

    Notes
    -----
    A target at range r, in a lens whose sensor is d behind the rear principal plane and whose channel focuses at r_c, has its
    image at d_c, 1/d_c - 1/d = 1/r_c - 1/r: to first order d_c - d = d^2 (1/r - 1/r_c).
    """
    if focus is None or len(focus.best_focus_mm) < 2:
        return ()
    names = list(focus.best_focus_mm)
    reference = REFERENCE if REFERENCE in names else names[0]
    return tuple(
        _shift(focus, lens, name, reference) for name in names if name != reference
    )


def _shift(focus: Focus, lens: Lens | None, name: str, reference: str) -> ColourShift:
    best, origin = focus[name], focus[reference]
    names = list(focus.best_focus_mm)
    at = [names.index(name), names.index(reference)]
    covariance = (
        np.diag([best.std**2, origin.std**2])
        if focus.covariance is None
        else focus.covariance[np.ix_(at, at)]
    )
    difference = Uncertain(best.value - origin.value, _std(covariance, 1.0, -1.0), "mm")
    on_sensor = None if lens is None else _on_sensor(best, origin, covariance, lens)
    return ColourShift(name, reference, difference, on_sensor)


def _on_sensor(
    best: Uncertain, origin: Uncertain, covariance: Floats, lens: Lens
) -> Uncertain | None:
    """Return the shift of the image, um; None where the reference has no image."""
    focal_mm, zero_mm = lens.focal_length.value, lens.range_zero.value
    near, far = origin.value + zero_mm, best.value + zero_mm
    if not min(near, far) > focal_mm:
        return None
    distance_mm = focal_mm * near / (near - focal_mm)
    scale = 1e3 * distance_mm**2
    shift = scale * (1 / near - 1 / far)
    of_ranges = _std(covariance, scale / far**2, -scale / near**2)
    of_lens = 2 * shift * lens.focal_length.std / focal_mm
    return Uncertain(shift, float(np.hypot(of_ranges, of_lens)), "um")


def _std(covariance: Floats, *gradient: float) -> float:
    slope = np.array(gradient)
    return float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def focus_slopes(wavefronts: Sequence[Wavefront]) -> dict[str, float]:
    """Return how defocus changes with the wavelength within each channel, by the channels' defocus at several stations.

    Parameters
    ----------
    wavefronts : those of one range are of one lens at one place: their defocus differs by longitudinal colour alone

    Returns
    -------
    Waves RMS of Noll mode 4, at the reference wavelength, per nm, by channel: the slope of the parabola through the defocus of
    three channels and more, of the line through that of two; means over the ranges. Channels whose sign is open, and those
    alone in their ranges, are left out.
    """
    together = defaultdict[tuple[object, ...], list[Wavefront]](list)
    for w in wavefronts:
        if w.defocus is not None and not w.sign_open:
            together[w.range_mm, w.tile].append(w)
    slopes = defaultdict[str, list[float]](list)
    for group in together.values():
        nm = np.array([w.wavelength_nm for w in group])
        different = np.unique(nm).size
        if different < 2:
            continue
        values = [w[DEFOCUS].value for w in group]
        curve = np.polynomial.Polynomial.fit(nm, values, min(different - 1, 2)).deriv()
        for w in group:
            slopes[w.channel].append(float(curve(w.wavelength_nm)))
    return {channel: float(np.mean(each)) for channel, each in slopes.items()}


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """The lens at best focus, in one channel.

    Attributes
    ----------
    channel : name of the channel
    wavefront : that from which the numbers are, the nearest to focus
    strehl, rms_nm, rms_waves, mtf50_x, mtf50_y : Strehl ratio, RMS in nm and in waves at the channel's own wavelength, MTF50 of
        the optics along x and y, cycles/mm; all without defocus. Their errors are nan where they are not known. None where no
        mode but defocus was fitted
    best_focus : range of best focus, mm; None where it was not fitted
    colour : best focus less that of the reference channel; None for that channel and without it
    """

    channel: str
    wavefront: Wavefront
    strehl: Uncertain | None
    rms_nm: Uncertain | None
    rms_waves: Uncertain | None
    mtf50_x: Uncertain | None
    mtf50_y: Uncertain | None
    best_focus: Uncertain | None
    colour: ColourShift | None

    def as_row(self) -> dict[str, Any]:
        """Return numbers and standard errors by name, with the unit at the end of each name."""
        w = self.wavefront
        numbers = {
            "strehl": self.strehl,
            "rms_nm": self.rms_nm,
            "rms_waves": self.rms_waves,
            "mtf50_x_per_mm": self.mtf50_x,
            "mtf50_y_per_mm": self.mtf50_y,
            "best_focus_mm": self.best_focus,
            "colour_mm": None if self.colour is None else self.colour.range_shift,
            "colour_um": None if self.colour is None else self.colour.sensor_shift,
        }
        row: dict[str, Any] = {
            "channel": self.channel,
            "wavelength_nm": w.wavelength_nm,
            "range_mm": w.range_mm,
        }
        for name, number in numbers.items():
            row[name] = nan if number is None else number.value
            row[f"{name}_std"] = nan if number is None else number.std
        return row | {"optimum": optimum_word(w.test), "model": model_word(w.test)}


def channel_summary(results: Results, channel: str) -> ChannelSummary:
    """Return the summary of a channel. Raises DataError for a channel that was not fitted."""
    w = results.nearest_focus(channel)
    known = confirmed(w, results.wavefronts)
    colours = {shift.channel: shift for shift in results.longitudinal_colour()}
    best = {} if results.focus is None else results.focus.best_focus_mm
    strehl, rms_nm, rms_waves, mtf50_x, mtf50_y = (
        None if number is None else stated(number, known=known) for number in _of_optics(w)
    )
    return ChannelSummary(
        channel,
        w,
        strehl,
        rms_nm,
        rms_waves,
        mtf50_x,
        mtf50_y,
        best.get(channel),
        colours.get(channel),
    )


def _of_optics(w: Wavefront) -> tuple[Uncertain | None, ...]:
    """Return Strehl ratio, RMS in nm and waves, and MTF50 along x and y; None where defocus alone was fitted."""
    if not set(w.noll) - {DEFOCUS}:
        return (None,) * 5
    of = w.best
    return of.strehl, of.rms_nm, of.rms_own_waves, of.mtf50("x"), of.mtf50("y")


Rows = list[list[str]]

NOT_FITTED = "not fitted"


def lens_rows(channels: Sequence[ChannelSummary]) -> Rows:
    """A heading, and a row for each channel: performance of the optics at best focus."""
    rows = [
        [
            "channel",
            "Strehl ratio",
            "RMS/nm",
            "RMS/λ",
            "MTF50 x/(cycles/mm)",
            "MTF50 y/(cycles/mm)",
            "of range/mm",
        ]
    ]
    for one in channels:
        numbers = one.strehl, one.rms_nm, one.rms_waves, one.mtf50_x, one.mtf50_y
        cells = [NOT_FITTED if n is None else _to_error(n) for n in numbers]
        rows.append([one.channel, *cells, _range(one.wavefront)])
    return rows


def colour_rows(shifts: Sequence[ColourShift]) -> Rows:
    """A heading, and a row for each channel but the reference; empty with fewer than two channels."""
    rows = [
        [
            shift.name,
            _signed(shift.range_shift),
            "" if shift.sensor_shift is None else _signed(shift.sensor_shift),
        ]
        for shift in shifts
    ]
    heading = ["longitudinal colour", "best focus/mm", "on the sensor/µm"]
    return [heading, *rows] if rows else []


def wavefront_rows(wavefronts: Sequence[Wavefront], reference_wavelength_nm: float) -> Rows:
    """A heading, and a row for each range and channel: defocus, RMS of all modes, optimum, how well the model fits."""
    waves = f"waves at {reference_wavelength_nm:g} nm"
    rows = [
        [
            "range/mm",
            "channel",
            f"defocus/{waves}",
            "RMS, all modes",
            "χ²/pixel",
            "optimum",
            "model",
        ]
    ]
    for w in wavefronts:
        known = confirmed(w, wavefronts)
        defocus = None if w.defocus is None else stated(w.defocus, known=known)
        rows.append(
            [
                _range(w),
                w.channel,
                NOT_FITTED if defocus is None else _signed(defocus),
                _to_error(stated(w.rms(), known=known)),
                f"{w.chi2_per_pixel:.3f}",
                optimum_word(w.test),
                model_word(w.test),
            ]
        )
    return rows


def focus_rows(focus: Focus | None, lens: Lens | None = None) -> Rows:
    """A heading, best focus of each channel, and the lens."""
    rows = [["quantity", "estimate"]]
    pupils = None if lens is None else lens.pupil_magnification
    note = " (these ranges do not determine it)"
    if focus is None:
        rows.append(["best focus", f"{NOT_FITTED}, see the warnings"])
    else:
        rows += [
            [f"best focus {channel}", str(best)]
            for channel, best in focus.best_focus_mm.items()
        ]
        pupils = focus.pupil_magnification
        note = "" if focus.identifiable else note
    if pupils is not None:
        rows.append(["pupil magnification", f"{pupils}{note}"])
    if lens is not None:
        rows.append(["focal length", str(lens.focal_length)])
        rows.append(["f-number at infinity", str(lens.f_number)])
        rows.append(["true ranges less stated", str(lens.range_zero)])
    return rows


def budget_rows(budget: Mapping[str, Mapping[str, float]]) -> Rows:
    """A heading, and a row for each number: its standard error by source, and the whole."""
    sources = list(dict.fromkeys(source for shares in budget.values() for source in shares))
    rows = [["standard error of", *sources, "all"]]
    for name, shares in budget.items():
        whole = sqrt(sum(share**2 for share in shares.values()))
        digits = decimals(whole)
        rows.append(
            [
                name,
                *(f"{shares.get(source, 0.0):.{digits}f}" for source in sources),
                f"{whole:.{digits}f}",
            ]
        )
    return rows


def part_rows(tried: Sequence[PartTried]) -> Rows:
    """Return a heading and a row for each part and group of modes tested for; empty if none was."""
    rows = [
        [p.name.replace("_", " "), f"{p.gain:.1f}", "taken in" if p.adopted else ""]
        for p in tried
    ]
    return [["part of the camera", "log-likelihood gained", ""], *rows] if rows else []


def as_html(title: str, said: str, tables: Sequence[Rows], notes: Sequence[str]) -> str:
    """Tables under a title and a sentence, and what there is to know of them, for a notebook."""
    html = f"<p><b>{escape(title)}</b></p><p>{escape(said)}</p>"
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    html += f"<ul>{items}</ul>" if items else ""
    return html + "".join(_table(rows) for rows in tables if rows)


def _signed(value: Uncertain) -> str:
    """With its sign, if determined, to the digits of its error: never ± 0.0000."""
    return ("" if value.value < 0 or value.sign_open else "+") + _to_error(value)


def _to_error(value: Uncertain) -> str:
    return str(replace(value, unit=""))  # its unit stands in the heading


def _range(w: Wavefront) -> str:
    return "" if w.range_mm is None else f"{w.range_mm:g}"


def _table(rows: Rows) -> str:
    head, *body = rows
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in body
    )
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{lines}</tbody></table>"
