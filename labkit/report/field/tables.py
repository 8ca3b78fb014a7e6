"""Tables of the field: tilt, curvature, coma and astigmatism of each channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from labkit.field.terms import LensTerms
from labkit.report.table import Column, Row, Table, channel_columns, estimated
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
