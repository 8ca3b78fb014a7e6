"""Tables of the field: terms of each channel, limits, distortion and lateral colour, screws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from labkit.field.geometry import FieldGeometry
from labkit.field.illumination import FRAME_CORNERS, RelativeIllumination
from labkit.field.limits import Judged, Numbers
from labkit.field.mount import Screws, level
from labkit.field.pair import Pair
from labkit.field.target_tilt import SeparatedTilt
from labkit.field.terms import LensTerms
from labkit.report.table import MINUS, Column, Row, Table, channel_columns, estimated
from labkit.uncertain import Uncertain

Cell = Callable[[LensTerms], Uncertain]


def field_table(terms: Sequence[LensTerms]) -> Table:
    """Return a table of the terms of each channel."""
    columns = (
        Column("", text=True),
        Column("", text=True),
        *channel_columns([each.channel for each in terms]),
    )
    return Table(columns, _rows(terms))


def _rows(terms: Sequence[LensTerms]) -> tuple[Row, ...]:
    def row(
        name: str, unit: str, cell: Cell, *, first: bool = False, beside: bool = False
    ) -> Row:
        numbers = (estimated(cell(each)) for each in terms)
        return Row((name, unit, *numbers), first=first, beside=beside)

    return (
        row("Sensor tilt, down", "µm/mm", lambda t: t.tilt.slope.down, first=True),
        row("Sensor tilt, right", "µm/mm", lambda t: t.tilt.slope.right),
        row("over the frame, corner to corner", "µm", lambda t: t.tilt.over_frame),
        row("as an angle", "arc minutes", lambda t: t.tilt.angle.magnitude, beside=True),
        row(
            "recedes from the lens towards",
            "degrees",
            lambda t: t.tilt.direction_deg,
            beside=True,
        ),
        row("Curvature, medial", "µm at the corner", _at_corner("curvature"), first=True),
        row("sagittal", "µm at the corner", _at_corner("sagittal_curvature")),
        row("tangential", "µm at the corner", _at_corner("tangential_curvature")),
        row(
            "radius of the medial surface",
            "mm",
            lambda t: t.curvature_radius_mm,
            beside=True,
        ),
        row(
            "After the best plane, RMS",
            "µm",
            lambda t: t.best_planes["medial"].rms,
            first=True,
        ),
        row("P–V", "µm", lambda t: t.best_planes["medial"].peak_to_valley),
        row("Constant coma", "waves RMS", lambda t: t.coma.magnitude, first=True),
        row("at", "degrees", lambda t: t.coma.direction_deg, beside=True),
        row("Coma that grows with height", "waves RMS/mm", lambda t: t.linear_coma),
        row(
            "Linear astigmatism",
            "waves RMS/mm",
            lambda t: t.linear_astigmatism.magnitude,
            first=True,
        ),
        row(
            "Constant astigmatism", "waves RMS", lambda t: t.constant_astigmatism.magnitude
        ),
        row(
            "Misalignment, all modes but defocus",
            "waves RMS",
            lambda t: t.misaligned.rms,
            first=True,
        ),
    )


def _at_corner(name: str) -> Cell:
    """Return the cell of a curvature, as its focus error at the corners."""
    return lambda terms: terms.at_corner_um(getattr(terms, name))


def limit_table(limits: Sequence[Judged]) -> Table:
    """Return the verdicts on the plan's limits."""
    columns = (
        Column("limit", text=True),
        Column("allowed", exact=True),
        Column("measured"),
        Column("where", text=True),
        Column("verdict", text=True),
    )
    rows = [
        Row(
            (
                one.name,
                f"{'at least' if one.is_least else 'at most'} {one.limit:g}",
                estimated(one.number),
                one.where,
                one.verdict,
            )
        )
        for one in limits
    ]
    return Table(columns, tuple(rows), strong=4)


def places_table(geometry: FieldGeometry, corners: Mapping[str, Numbers]) -> Table:
    """Return distortion and lateral colour."""
    columns = (Column("", text=True), Column("", text=True, exact=True), Column(""))
    k1 = geometry.k1_per_mm2
    rows = [Row(("Distortion, k₁", "10⁻⁶/mm²", estimated(k1, 1e6)), first=True)]
    if (k2 := geometry.k2_per_mm4) is not None:
        rows.append(Row(("k₂", "10⁻⁹/mm⁴", estimated(k2, 1e9))))
    for place, number in corners["distortion_percent"].items():
        rows.append(Row((f"{place} corner", "%", estimated(number)), beside=True))
    if (centre := geometry.centre_px) is not None:
        std = np.sqrt(np.diag(centre[1]))
        for name, value, error in zip(("row", "column"), centre[0], std, strict=True):
            number = Uncertain(float(value), float(error))
            rows.append(Row((f"its centre, {name}", "px", estimated(number))))
    for channel, colour in geometry.lateral_colour.items():
        against = f"{channel} against {geometry.model.channels[0]}"
        name = f"Lateral colour, {against}, larger by"
        rows.append(Row((name, "10⁻⁶", estimated(colour.scale, 1e6)), first=True))
        for where, number in corners["lateral_colour_um"].items():
            place, _, of = where.partition(", ")
            if of == channel:
                rows.append(Row((f"{place} corner", "µm", estimated(number)), beside=True))
    return Table(columns, tuple(rows))


def tilt_table(tilt: SeparatedTilt) -> Table:
    """Return the slope of focus that is the camera's, without the target's lean."""
    pair = Pair(tilt.value, tilt.covariance, "um/mm")
    columns = (Column("", text=True), Column("", text=True), Column(""))
    rows = [
        Row(("The camera's part, down", "µm/mm", estimated(pair.down))),
        Row(("right", "µm/mm", estimated(pair.right))),
    ]
    return Table(columns, tuple(rows))


def screw_table(tilt: Pair, screws: Screws) -> Table:
    """Return what to do at each screw, from the slope of focus alone, um/mm."""
    columns = (
        Column("screw", exact=True),
        Column("at x, y", "mm", exact=True),
        Column("height", "µm"),
        Column("shim", "µm"),
        *([Column("turn", "degrees")] if screws.pitch_mm is not None else []),
        Column("what to do", text=True),
    )
    rows = []
    for move, at in zip(level(tilt, screws), screws.places_mm, strict=True):
        turn = [] if move.turn_deg is None else [estimated(move.turn_deg)]
        place = f"{at[0]:g}, {at[1]:g}".replace("-", MINUS)
        shim = estimated(move.shim_um) if move.shim_um.std else "none"
        numbers = [estimated(move.height_um), shim, *turn]
        rows.append(Row((str(move.number), place, *numbers, move.words)))
    return Table(columns, tuple(rows))


def light_table(lights: Mapping[str, RelativeIllumination]) -> Table | None:
    """Return the light in the corners, % of the centre's; None without flats."""
    if not lights:
        return None
    columns = (Column("", text=True), *channel_columns(tuple(lights), "%"))
    corners = [light.corners for light in lights.values()]
    rows = [
        Row((f"{name} corner", *(estimated(of[name]) for of in corners)))
        for name in FRAME_CORNERS
    ]
    return Table(columns, tuple(rows))
