"""What results say of the lens: a summary of each channel."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any

from labkit.optics.wavefront import DEFOCUS
from labkit.results.colour import ColourShift
from labkit.results.model import Wavefront
from labkit.results.verdicts import confirmed, model_word, optimum_word, stated
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.results.results import Results


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
