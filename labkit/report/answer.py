"""What a customer looks for first: the lens without defocus, its colour, and the place in the field that was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labkit.report.best_focus import MTF_DIRECTIONS, ChannelFocus
from labkit.report.photographs import Photographs, off_centre
from labkit.report.quantities import NO_ERROR, PLUS_MINUS, estimated, fixed
from labkit.results import ColourShift, Results
from labkit.results.tables import NOT_FITTED
from labkit.uncertain import Uncertain


@dataclass(frozen=True, slots=True)
class Number:
    """A value and its error as they are printed, the error with its sign."""

    value: str
    error: str


@dataclass(frozen=True, slots=True)
class Card:
    """Numbers of one kind.

    rows: a channel or words, and its numbers; head: what each column holds; strong: how many columns lead; big: words in
    place of rows.
    """

    title: str
    note: str
    rows: tuple[tuple[str, tuple[Number, ...]], ...] = ()
    head: tuple[str, ...] = ()
    strong: int = 1
    big: str = ""


def answer(
    results: Results, focused: Sequence[ChannelFocus], photographs: Photographs
) -> list[Card]:
    """Return the cards that lead the report."""
    colour = results.longitudinal_colour()
    return [
        _strehl(focused),
        _rms(focused),
        _mtf50(focused),
        _best_focus(results),
        *([_colour(results, colour)] if colour else []),
        _place(results, photographs),
    ]


def _strehl(focused: Sequence[ChannelFocus]) -> Card:
    rows = [(b.channel, (_of(b, b.best.strehl, least=3),)) for b in focused]
    note = "1 is the diffraction limit of this pupil, 0.8 and above is called diffraction limited."
    return Card("Strehl ratio without defocus", note, tuple(rows))


def _rms(focused: Sequence[ChannelFocus]) -> Card:
    rows = [
        (b.channel, (_of(b, b.best.rms_nm), _of(b, b.best.rms_own_waves, least=4)))
        for b in focused
    ]
    light = ", ".join(f"{b.channel} {b.photographed.wavelength_nm:g} nm" for b in focused)
    note = (
        f"Path difference over the pupil; waves are of each channel's own light, {light}."
    )
    return Card("RMS wavefront without defocus", note, tuple(rows), ("nm", "waves"))


def _mtf50(focused: Sequence[ChannelFocus]) -> Card:
    rows = [
        (b.channel, tuple(_of(b, b.mtf50(direction)) for direction in MTF_DIRECTIONS))
        for b in focused
    ]
    note = (
        "Lowest spatial frequency on the sensor, cycles/mm, at which the MTF of the optics "
        "is one half."
    )
    head = ("along x, cycles/mm", "along y")
    return Card("MTF50 without defocus", note, tuple(rows), head, strong=2)


def _best_focus(results: Results) -> Card:
    focus = results.focus
    if focus is None:
        why = ": see the warnings below" if results.warnings else ""
        note = f"These fits do not give best focus{why}. Each defocus is in the tables."
        return Card("Best focus", note, big="not fitted")
    rows = [(c, (_number(best),)) for c, best in focus.best_focus_mm.items()]
    note = "Range of the target that the lens is focused at, ± one standard error."
    return Card("Best focus", note, tuple(rows), ("mm",))


def _colour(results: Results, colour: Sequence[ColourShift]) -> Card:
    rows = []
    for shift in colour:
        each = [shift.range_shift, *([shift.sensor_shift] if shift.sensor_shift else [])]
        rows.append((shift.name, tuple(_signed(number) for number in each)))
    known = results.focus is not None and results.focus.covariance is not None
    error = "of the difference" if known else "as if the channels' were independent"
    note = f"Best focus less that of {colour[0].reference}, ± one standard error {error}."
    on_sensor = [shift for shift in colour if shift.sensor_shift]
    if on_sensor:
        note += " On the sensor: how far behind it the image is."
    head = ("range, mm", *(["on the sensor, µm"] if on_sensor else []))
    return Card("Longitudinal colour", note, tuple(rows), head)


def _place(results: Results, photographs: Photographs) -> Card:
    title, note = "Place in the field", "All numbers are of this one place."
    away = off_centre(results, photographs)
    if away is None:
        return Card(title, f"{note} The frame is not at hand.", big="not known")
    mm, percent = (
        _span(values, places) for values, places in zip(away, (2, 0), strict=True)
    )
    note = (
        f"From the frame's centre to the target's, on the sensor: {percent}\N{NO-BREAK SPACE}% of the half diagonal. "
        + note
    )
    return Card(title, note, big=f"{mm} mm off centre")


def _span(values: Sequence[float], places: int) -> str:
    """Return the least and the greatest, one number where they print alike."""
    ends = (float(np.min(values)), float(np.max(values)))
    return " to ".join(dict.fromkeys(fixed(end, places) for end in ends))


def _of(b: ChannelFocus, number: Uncertain, *, least: int = 0) -> Number:
    """Return a number of the lens, or that it was not fitted: no mode was but defocus."""
    return _number(number, least=least) if b.fitted.noll else Number(NOT_FITTED, "")


def _number(number: Uncertain, *, least: int = 0) -> Number:
    value, mark, error = estimated(number, least=least).partition(PLUS_MINUS)
    if not mark and value.endswith(NO_ERROR):
        return Number(value.removesuffix(NO_ERROR), NO_ERROR)
    return Number(value, f"{mark}{error}")


def _signed(number: Uncertain) -> Number:
    """Return a number with its sign, a plus too."""
    printed = _number(number)
    return Number(f"+{printed.value}", printed.error) if number.value > 0 else printed
