"""The words of a report, ready to be set: its answer, its checks, and all tables by their names in the template."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.figure_style import channel_inks
from labkit.optics.wavefront import DEFOCUS
from labkit.report.curves import MTF_DIRECTIONS, ChannelFocus, Curves, full_nyquist_per_mm
from labkit.report.fit_tables import (
    fit_table,
    light_table,
    method_table,
    missing_words,
    part_table,
    residual_table,
    tried_table,
)
from labkit.report.lens_tables import (
    SOURCES,
    budget_table,
    depth_table,
    difference_table,
    focus_table,
    lens_table,
    mode_table,
    path_table,
)
from labkit.report.photographs import Photographs, off_centre, photograph_table, place_table
from labkit.report.table import (
    Card,
    Number,
    fixed,
    millimetres,
    number_of,
    signed,
)
from labkit.report.tiles import tiles_of
from labkit.results import ColourShift, Results, Wavefront
from labkit.results.tables import NOT_FITTED
from labkit.results.verdicts import CONTRADICTIONS, MOST_NAMES, explained
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.report.field.plates import FieldArtist

SECTIONS = {
    "field": "Over the field",
    "best-focus": "At best focus",
    "depth": "Through focus",
    "wavefronts": "Wavefront",
    "lens": "The lens",
    "budget": "Errors",
    "camera": "The camera",
    "photographs": "Photographs",
    "fits": "Data",
    "tables": "Fits",
    "downloads": "Files",
    "provenance": "Provenance",
}
OPTIONAL_SECTIONS = {"field", "lens", "budget", "camera", "fits"}


def contents(
    whole: Results,
    results: Results,
    curves: Sequence[Curves],
    photographs: Photographs,
    drawn: set[str],
    field: FieldArtist | None = None,
) -> dict[str, Any]:
    """Return the values of the template.

    whole: the session; results: the part that the page shows wavefront by wavefront; drawn: sections with figures;
    field: who draws the field, None without its model
    """
    focused = [c.focus for c in curves]
    lens = lens_table(results)
    shown = set(SECTIONS) - OPTIONAL_SECTIONS | (drawn & OPTIONAL_SECTIONS)
    shown |= {"field"} if field else set()
    shown |= {"lens"} if lens or results.focus else set()
    shown |= {"camera"} if results.parts_tried else set()
    return {
        "m": results,
        "tiles": tiles_of(whole),
        "tile": results.wavefronts[0].tile,
        "plan": results.plan,
        "curves": curves,
        "photographs": photographs,
        "inks": channel_inks(results.channels),
        "sections": {name: label for name, label in SECTIONS.items() if name in shown},
        "session": session_name(results),
        "folder": results.folder and str(results.folder.resolve()),
        "nyquist": full_nyquist_per_mm(results.plan.sensor),
        "cards": [
            *(field.cards() if field else ()),
            *answer(results, focused, photographs),
        ],
        "missing": missing_words(results),
        "sources": SOURCES,
        "checks": _checks(whole),
        **(field.contents() if field else {}),
        "lens_table": lens,
        "focus_table": focus_table(focused),
        "depth_table": depth_table(curves, results),
        "path_table": path_table(results),
        "bare_path_table": path_table(results, (DEFOCUS,)),
        "mode_table": mode_table(focused, "waves RMS"),
        "nm_table": mode_table(focused, "nm RMS", results.reference_wavelength_nm),
        "difference_table": difference_table(results, focused),
        "part_table": part_table(results),
        "light_table": light_table(results, focused),
        "tried_table": tried_table(results),
        "budget_table": budget_table(results),
        "photograph_table": photograph_table(photographs),
        "place_table": place_table(results, photographs),
        "fit_table": fit_table(results),
        "method_table": method_table(results),
        "residual_table": residual_table(results),
    }


def session_name(m: Results) -> str:
    """Return the name of the session, and of the results unless "latest"."""
    if m.folder is None:
        return "Lens measurement"
    session = m.folder.resolve()
    if session.parent.name != "results":
        return session.name
    name = session.parent.parent.name
    return name if session.name == "latest" else f"{name}, {session.name}"


def _checks(m: Results) -> list[dict[str, Any]]:
    """Return checks of the numbers, a line each."""
    checks = [{"good": m.holds, "text": m.headline}]
    tested = [w for w in m.wavefronts if w.test]
    if tested:
        doubted = [w for w in tested if not w.accepted]
        checks.append(_count("optimum found", doubted, len(tested)))
        unexplained = [w for w in tested if not explained(w)]
        checks.append(_count("model explains the photographs", unexplained, len(tested)))
    if is_open := [w for w in m.wavefronts if w.sign_open]:
        text = (
            "the sign of all even modes is open, that of defocus too: a twin, turned by half a turn and negated, makes the "
            f"same photographs: {_names(is_open)}"
        )
        checks.append({"good": False, "text": text})
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
    told = [f.text for f in m.findings if f.code in CONTRADICTIONS]
    checks += [{"good": False, "text": text} for text in told]
    return [*checks, *_joint_check(m)]


def _joint_check(m: Results) -> list[dict[str, Any]]:
    """Check the largest change by a joint climb over all frames; empty without a joint climb."""
    if not m.joint:
        return []
    most = max(abs(moved) for moved in m.joint.values())
    text = f"one climb over all frames moves no number by more than {fixed(most, 2)} standard errors"
    return [{"good": most <= 1, "text": text}]


def _count(what: str, but: Sequence[Wavefront], fits: int) -> dict[str, Any]:
    """Return a check that counts the fits with a property and names the others."""
    words = f"{what} in {fits - len(but)} of {fits} fits"
    return {"good": not but, "text": f"{words}, not: {_names(but)}" if but else words}


def _names(wavefronts: Sequence[Wavefront]) -> str:
    """Return the names of the first wavefronts, and the number of the others."""
    shown = [_name(w) for w in wavefronts[:MOST_NAMES]]
    more = len(wavefronts) - len(shown)
    return ", ".join(shown + ([f"and {more} more"] if more else []))


def _name(w: Wavefront) -> str:
    tile = "" if w.tile is None else f" tile {w.tile}"
    return f"{millimetres(w.range_mm)} {w.channel}{tile}"


CHI2_USUAL = (0.9, 1.5)


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
    light = ", ".join(f"{b.channel} {b.photographed.wavelength_nm:.4g} nm" for b in focused)
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
    rows = [(c, (number_of(best),)) for c, best in focus.best_focus_mm.items()]
    note = "Range of the target that the lens is focused at, ± one standard error."
    return Card("Best focus", note, tuple(rows), ("mm",))


def _colour(results: Results, colour: Sequence[ColourShift]) -> Card:
    rows = []
    for shift in colour:
        each = [shift.range_shift, *([shift.sensor_shift] if shift.sensor_shift else [])]
        rows.append((shift.name, tuple(signed(number) for number in each)))
    known = results.focus is not None and results.focus.covariance is not None
    error = "of the difference" if known else "as if the channels' were independent"
    note = f"Best focus less that of {colour[0].reference}, ± one standard error {error}."
    on_sensor = [shift for shift in colour if shift.sensor_shift]
    if on_sensor:
        note += " On the sensor: how far behind it the image is."
    head = ("range, mm", *(["on the sensor, µm"] if on_sensor else []))
    return Card("Longitudinal colour", note, tuple(rows), head)


def _place(results: Results, photographs: Photographs) -> Card:
    title = "Place in the field"
    note = (
        "All numbers but the field's are of this one place."
        if results.field
        else ("All numbers are of this one place.")
    )
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
    """Return the least and the greatest value; a single number if both print alike."""
    ends = (float(np.min(values)), float(np.max(values)))
    return " to ".join(dict.fromkeys(fixed(end, places) for end in ends))


def _of(b: ChannelFocus, number: Uncertain, *, least: int = 0) -> Number:
    """Return a number of the lens; "not fitted" if defocus is the only mode."""
    return number_of(number, least=least) if b.fitted.noll else Number(NOT_FITTED, "")
