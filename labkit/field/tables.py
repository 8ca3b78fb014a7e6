"""A field as rows of text: tilt, terms, focal surfaces, MTF, limits and tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from labkit.field.curves import Band
from labkit.field.geometry import FieldGeometry
from labkit.field.illumination import FRAME_CORNERS, RelativeIllumination
from labkit.field.limits import Judged
from labkit.field.mount import ScrewMove
from labkit.field.pair import Pair
from labkit.field.session_geometry import corner_numbers
from labkit.field.summary import FieldSummary
from labkit.field.symmetry import Share
from labkit.field.terms import LensTerms
from labkit.storage.spreadsheet import csv_text
from labkit.types import Floats
from labkit.uncertain import Uncertain

Rows = list[list[str]]

UNCLEAR_DEG = 60.0
"""Standard error from which a direction says nothing."""

LEAST_TOLD = 1e-4
"""Probabilities below are given as less than this."""


def text(number: Uncertain) -> str:
    """Return a number with its error for a cell whose row has the unit."""
    return str(Uncertain(number.value, number.std)) if np.isfinite(number.value) else "–"


def headline(summary: FieldSummary) -> str:
    """Return the tilt of the sensor in one sentence."""
    tilt = summary.terms[summary.channel].tilt
    slope = tilt.slope.magnitude
    if not np.isfinite(slope.value):
        return "the sensor's tilt is not determined: the field has one order only"
    return (
        f"sensor tilt in {summary.channel}: {text(slope)} µm/mm, "
        f"{text(tilt.angle.magnitude)} arcmin, {text(tilt.over_frame)} µm over the frame; "
        f"{_towards(tilt.direction_deg, sign_open=summary.sign_open)}"
    )


def coverage(covered: tuple[float, float]) -> str:
    """Return the part of the frame that the tiles cover, (height, width), in a sentence."""
    down, right = covered
    return (
        f"the tiles cover {right:.0%} of the frame's width and {down:.0%} of its height; "
        "numbers beyond them are extrapolated"
    )


def _towards(direction: Uncertain, *, sign_open: bool) -> str:
    if not direction.std < UNCLEAR_DEG:
        return "the errors leave its direction open"
    towards = f"{direction.value:.0f}° ± {direction.std:.0f}°"
    if sign_open:
        towards += ", or the opposite way"
    return f"the sensor recedes from the lens towards {towards} (0° right, 90° down)"


def term_rows(summary: FieldSummary) -> Rows:
    """Return the terms of all channels: the lens's own, then those of misalignment."""
    channels = list(summary.terms.values())
    rows = [["quantity", "unit", *summary.terms]]
    for name, unit, number in TERM_ROWS:
        rows.append([name, unit, *(_cell(number(terms)) for terms in channels)])
    return rows


TERM_ROWS: tuple[tuple[str, str, Callable[[LensTerms], Uncertain | Share]], ...] = (
    ("field curvature", "mm/mm²", lambda t: t.curvature),
    ("radius of the focal surface", "mm", lambda t: t.curvature_radius_mm),
    ("field curvature at the corner", "µm", lambda t: t.at_corner_um(t.curvature)),
    (
        "sagittal curvature at the corner",
        "µm",
        lambda t: t.at_corner_um(t.sagittal_curvature),
    ),
    (
        "tangential curvature at the corner",
        "µm",
        lambda t: t.at_corner_um(t.tangential_curvature),
    ),
    ("linear coma", "waves/mm", lambda t: t.linear_coma),
    ("spherical aberration, mean", "waves", lambda t: t.spherical),
    ("sensor tilt, down", "µm/mm", lambda t: t.tilt.slope.down),
    ("sensor tilt, right", "µm/mm", lambda t: t.tilt.slope.right),
    ("sensor tilt", "arcmin", lambda t: t.tilt.angle.magnitude),
    ("sensor tilt, left to right", "µm", lambda t: t.tilt.across["left to right"]),
    ("sensor tilt, top to bottom", "µm", lambda t: t.tilt.across["top to bottom"]),
    (
        "sensor tilt, top left to bottom right",
        "µm",
        lambda t: t.tilt.across["top left to bottom right"],
    ),
    (
        "sensor tilt, bottom left to top right",
        "µm",
        lambda t: t.tilt.across["bottom left to top right"],
    ),
    ("or curvature's centre, down", "mm", lambda t: t.level_at.down),
    ("or curvature's centre, right", "mm", lambda t: t.level_at.right),
    ("constant coma, down", "waves", lambda t: t.coma.down),
    ("constant coma, right", "waves", lambda t: t.coma.right),
    ("linear astigmatism, down", "waves/mm", lambda t: t.linear_astigmatism.down),
    ("linear astigmatism, right", "waves/mm", lambda t: t.linear_astigmatism.right),
    ("constant astigmatism", "waves", lambda t: t.constant_astigmatism.magnitude),
    ("best plane leaves, RMS", "µm", lambda t: t.best_planes["medial"].rms),
    (
        "best plane leaves, peak to valley",
        "µm",
        lambda t: t.best_planes["medial"].peak_to_valley,
    ),
    ("decentring in all, RMS", "waves", lambda t: t.misaligned),
    ("neither axis nor decentring, RMS", "waves", lambda t: t.rest),
)
"""Name, unit and number of each row. Curvature is never a shim: tilt alone is what screws change."""


def _cell(number: Uncertain | Share) -> str:
    if isinstance(number, Uncertain):
        return text(number)
    return f"{text(number.rms)} (p {probability(number.p_value)})"


def probability(value: float) -> str:
    """Return a probability in two digits."""
    if not np.isfinite(value):
        return "unknown"
    return f"< {LEAST_TOLD:g}" if value < LEAST_TOLD else f"= {value:.2g}"


def significance_rows(summary: FieldSummary) -> Rows:
    """Return how probable misalignment as large would be in an aligned lens, by term and channel."""
    vectors: dict[str, Callable[[LensTerms], Pair]] = {
        "sensor tilt": lambda t: t.tilt.slope,
        "constant coma": lambda t: t.coma,
        "linear astigmatism": lambda t: t.linear_astigmatism,
    }
    rows = [["if there were none, as large by chance", *summary.terms]]
    for name, vector in vectors.items():
        cells = (probability(vector(t).p_value) for t in summary.terms.values())
        rows.append([name, *(cell.removeprefix("= ") for cell in cells)])
    return rows


def point_rows(summary: FieldSummary) -> Rows:
    """Return MTF and focus at the frame's centre, edges and corners, sagittal and tangential."""
    frequencies = [f"MTF at {f:g}/mm" for f in summary.frequency_per_mm]
    rows = [["place", "detail", *frequencies, "MTF50/(cycles/mm)", "focus error/µm"]]
    for point in summary.points:
        values = zip(point.mtf.value, point.mtf.std, strict=True)
        cells = [text(Uncertain(value, std)) for value, std in values]
        row = [point.place, point.surface, *cells]
        rows.append([*row, text(point.mtf50), text(point.focus_um)])
    return rows


def best_rows(summary: FieldSummary) -> Rows:
    """Return the movement of the sensor, away from the lens, to the highest MTF at each point and frequency."""
    frequencies = [f"{f:g}/mm" for f in summary.frequency_per_mm]
    rows = [["sharpest with the sensor moved by/µm", "detail", *frequencies]]
    best: dict[tuple[str, str], list[str]] = {}
    for curve in summary.through_focus:
        best.setdefault((curve.place, curve.surface), []).append(text(curve.best_um))
    return rows + [[*labels, *cells] for labels, cells in best.items()]


def place_rows(geometry: FieldGeometry) -> Rows:
    """Return distortion and lateral colour, and what they are in the frame's corners."""
    rows = [["where the lens puts the target", "unit", "value"]]
    rows.append(["distortion, k1", "1/mm²", text(geometry.k1_per_mm2)])
    if geometry.k2_per_mm4 is not None:
        rows.append(["distortion, k2", "1/mm⁴", text(geometry.k2_per_mm4)])
    corners = corner_numbers(geometry)
    for corner, number in corners["distortion_percent"].items():
        rows.append([f"distortion, {corner}", "%", text(number)])
    for channel, colour in geometry.lateral_colour.items():
        name = (
            f"lateral colour of {channel} against {geometry.model.channels[0]}, larger by"
        )
        rows.append([name, "", text(colour.scale)])
    for corner, number in corners["lateral_colour_um"].items():
        rows.append([f"lateral colour, {corner}", "µm", text(number)])
    return rows


def light_rows(lights: Mapping[str, RelativeIllumination]) -> Rows:
    """Return the light in the corners of the frame by the flats, % of the centre's."""
    rows = [["relative illumination", "unit", *lights]]
    corners = [light.corners for light in lights.values()]
    return rows + [
        [name, "%", *(text(of[name]) for of in corners)] for name in FRAME_CORNERS
    ]


def screw_rows(screws: Sequence[ScrewMove]) -> Rows:
    """Return what to do at each screw, by the sensor's tilt alone."""
    rows = [["screw", "height/µm", "shim/µm", "what to do"]]
    for move in screws:
        rows.append(
            [str(move.number), text(move.height_um), text(move.shim_um), move.words]
        )
    return rows


def limit_rows(limits: Sequence[Judged]) -> Rows:
    """Return the verdicts on the plan's limits."""
    rows = [["limit", "at", "measured", "where", "verdict"]]
    for one in limits:
        bound = f"{'≥' if one.is_least else '≤'} {one.limit:g}"
        rows.append([one.name, bound, text(one.number), one.where, one.verdict])
    return rows


def tile_rows(summary: FieldSummary) -> Rows:
    """Return the tiles with their fits, agreement with the model, and remarks."""
    rows = [["tile", "middle/px", "fits", "accepted", "pull", "remarks"]]
    for tile in summary.tiles:
        known = np.all(np.isfinite(tile.centre_px))
        middle = "{:.0f}, {:.0f}".format(*tile.centre_px) if known else "–"
        pull = f"{tile.pull:.1f}" if np.isfinite(tile.pull) else "–"
        name = "{}, {}".format(*tile.tile)
        counts = [str(tile.fits), str(tile.accepted)]
        rows.append([name, middle, *counts, pull, "; ".join(tile.remarks)])
    return rows


CSV_HEADING = (
    *("curve", "channel", "place", "azimuth_deg", "surface"),
    *("frequency_per_mm", "height_mm", "shift_um", "value", "std"),
)


def curves_csv(summary: FieldSummary) -> str:
    """Return all curves of the leading channel, one value a line."""
    return csv_text([CSV_HEADING, *_curve_rows(summary)])


def _curve_rows(summary: FieldSummary) -> Iterator[list[str]]:
    """Yield a row for each value of all curves."""
    for profile in summary.profiles:
        start = (profile.channel, "", f"{profile.azimuth_deg:.6g}", profile.surface)
        height = profile.height_mm
        for k, frequency in enumerate(profile.frequency_per_mm):
            band = Band(profile.mtf.value[k], profile.mtf.std[k])
            end = (f"{frequency:g}",)
            yield from _lines("mtf", *start, *end, along=(height, None), band=band)
        for name, band in (("mtf50", profile.mtf50_per_mm), ("focus_um", profile.focus_um)):
            yield from _lines(name, *start, "", along=(height, None), band=band)
    for curve in summary.through_focus:
        start = (curve.channel, curve.place, "", curve.surface)
        end = (f"{curve.frequency_per_mm:g}",)
        along = (None, curve.shift_um)
        yield from _lines("through_focus", *start, *end, along=along, band=curve.mtf)


def _lines(
    *labels: str, along: tuple[Floats | None, Floats | None], band: Band
) -> Iterable[list[str]]:
    """Yield a line for each value of a curve along heights or shifts."""
    for k, (value, std) in enumerate(zip(band.value, band.std, strict=True)):
        at = ["" if axis is None else f"{axis[k]:.6g}" for axis in along]
        yield [*labels, *at, f"{value:.6g}", f"{std:.3g}"]
