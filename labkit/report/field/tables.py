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
from labkit.report.table import (
    MINUS,
    Column,
    Quantity,
    Row,
    Table,
    channel_columns,
    compared,
    estimated,
)
from labkit.uncertain import Uncertain


def field_table(terms: Sequence[LensTerms]) -> Table:
    """Return a table of the terms of each channel."""
    return compared(terms, FIELD_QUANTITIES)


def _at_corner(name: str) -> Callable[[LensTerms], Uncertain]:
    """Return what reads a curvature, as its focus error at the corners."""
    return lambda terms: terms.at_corner_um(getattr(terms, name))


FIELD_QUANTITIES = (
    Quantity("Sensor tilt, down", "µm/mm", lambda t: t.tilt.slope.down, first=True),
    Quantity("Sensor tilt, right", "µm/mm", lambda t: t.tilt.slope.right),
    Quantity("over the frame, corner to corner", "µm", lambda t: t.tilt.over_frame),
    Quantity("as an angle", "arc minutes", lambda t: t.tilt.angle.magnitude, beside=True),
    Quantity(
        "recedes from the lens towards",
        "degrees",
        lambda t: t.tilt.direction_deg,
        beside=True,
    ),
    Quantity("Curvature, medial", "µm at the corner", _at_corner("curvature"), first=True),
    Quantity("sagittal", "µm at the corner", _at_corner("sagittal_curvature")),
    Quantity("tangential", "µm at the corner", _at_corner("tangential_curvature")),
    Quantity(
        "radius of the medial surface",
        "mm",
        lambda t: t.curvature_radius_mm,
        beside=True,
    ),
    Quantity(
        "After the best plane, RMS",
        "µm",
        lambda t: t.best_planes["medial"].rms,
        first=True,
    ),
    Quantity("P–V", "µm", lambda t: t.best_planes["medial"].peak_to_valley),
    Quantity("Constant coma", "waves RMS", lambda t: t.coma.magnitude, first=True),
    Quantity("at", "degrees", lambda t: t.coma.direction_deg, beside=True),
    Quantity("Coma that grows with height", "waves RMS/mm", lambda t: t.linear_coma),
    Quantity(
        "Linear astigmatism",
        "waves RMS/mm",
        lambda t: t.linear_astigmatism.magnitude,
        first=True,
    ),
    Quantity(
        "Constant astigmatism", "waves RMS", lambda t: t.constant_astigmatism.magnitude
    ),
    Quantity(
        "Misalignment, all modes but defocus",
        "waves RMS",
        lambda t: t.misaligned.rms,
        first=True,
    ),
)


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
    """Return the slope of focus that is the camera's, without the target's tilt."""
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
