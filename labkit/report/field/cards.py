"""The cards of the field, which lead the report: tilt, curvature, decentre."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from labkit.field.terms import LensTerms
from labkit.report.table import Card, Number, fixed, number_of, signed
from labkit.uncertain import Uncertain


def field_cards(terms: Sequence[LensTerms]) -> list[Card]:
    """Return the cards of a field by the terms of its channels."""
    return [_tilt(terms), _curvature(terms), _coma(terms)]


def _tilt(terms: Sequence[LensTerms]) -> Card:
    rows = [
        (t.channel, (number_of(t.tilt.over_frame), number_of(t.tilt.angle.magnitude)))
        for t in terms
    ]
    note = (
        f"From corner to corner. The sensor recedes from the lens towards {_towards(terms)}; "
        "0° is right, 90° down."
    )
    return Card("Sensor tilt", note, tuple(rows), ("µm", "arc minutes"))


def _curvature(terms: Sequence[LensTerms]) -> Card:
    def row(t: LensTerms) -> tuple[str, tuple[Number, ...]]:
        at_corner = t.at_corner_um(t.curvature)
        left: Uncertain = t.best_planes["medial"].rms
        return t.channel, (signed(at_corner), number_of(left))

    note = "Focus error at the corners less that at the centre, and RMS after the best plane. No shim changes it."
    head = ("at the corners, µm", "left, µm RMS")
    return Card("Field curvature", note, tuple(map(row, terms)), head)


def _coma(terms: Sequence[LensTerms]) -> Card:
    rows = [(t.channel, (number_of(t.coma.magnitude),)) for t in terms]
    note = "Coma that is equal all over the frame, the mark of a decentred lens."
    return Card("Decentre", note, tuple(rows), ("constant coma, waves RMS",))


def _towards(terms: Sequence[LensTerms]) -> str:
    """Return the direction of each channel's tilt; once where all print alike."""
    each = {t.channel: _degrees(t.tilt.direction_deg) for t in terms}
    if len(set(each.values())) == 1:
        return each.popitem()[1]
    return ", ".join(f"{channel} {angle}" for channel, angle in each.items())


def _degrees(angle: Uncertain) -> str:
    """Return an angle in whole degrees, with its error; in words if any angle is possible."""
    if not isfinite(angle.value):
        return "any direction"
    return f"{fixed(angle.value, 0)}\N{PLUS-MINUS SIGN}{max(round(angle.std), 1)}°"
