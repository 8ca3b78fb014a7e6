"""Fields of several sessions: a screw turned between two of them, or the lens turned on its mount."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from labkit.errors import DataError, InputError
from labkit.field.mount import KnownMove, Screws, check_move
from labkit.field.pair import Pair
from labkit.field.split import Split, check_angles, split
from labkit.field.terms import LensTerms, lens_terms
from labkit.optics.field import FieldModel
from labkit.plan import Plan

USUAL_CHANNEL = "G"

MISALIGNMENTS: Mapping[str, Callable[[LensTerms], Pair]] = {
    "sensor_tilt": lambda terms: terms.tilt.slope,
    "coma": lambda terms: terms.coma,
    "linear_astigmatism": lambda terms: terms.linear_astigmatism,
}
"""Misalignments of the first order, by name."""


def planned_screws(plan: Plan) -> Screws:
    """Return the screws of a plan's [mount] table. Raises InputError for a plan without them."""
    mount = plan.mount
    if mount.screws_mm is None:
        raise InputError(
            "the plan has no mount.screws_mm: the places [x, y] of three or four screws, in mm, are needed"
        )
    return Screws(mount.screws_mm, mount.screw_pitch_mm, mount.clockwise)


def check_screw_move(
    before: FieldModel,
    after: FieldModel,
    plan: Plan,
    screw: int,
    turn_deg: float,
    channel: str | None = None,
) -> KnownMove:
    """Compare the sensor's tilt before and after a screw was turned by a known angle.

    Parameters
    ----------
    before, after : fields of two sessions
    plan : with the screws
    screw : number, from 1
    turn_deg : clockwise
    channel : G, or the first, for None

    Raises
    ------
    InputError : no screws, no such screw or channel, or no turn

    >>> labkit.check_screw_move(before.field, after.field, before.plan, screw=1, turn_deg=90)
    """
    screws = planned_screws(plan)
    tilts = [_terms(model, channel).tilt.slope for model in (before, after)]
    try:
        return check_move(tilts[0], tilts[1], screws, screw, turn_deg)
    except ValueError as error:
        raise InputError(str(error)) from error


def split_fields(
    models: Sequence[FieldModel],
    turned_deg: Sequence[float],
    channel: str | None = None,
) -> dict[str, Split]:
    """Split tilt, coma and linear astigmatism into the body's part and the lens's, by name.

    A misalignment whose modes were not fitted is left out.

    Parameters
    ----------
    models : fields of the sessions
    turned_deg : angle of the lens in each, clockwise as seen from behind the camera
    channel : G, or the first, for None

    Raises
    ------
    InputError : angles that split nothing, waves of different wavelengths, or no such channel

    >>> labkit.split_fields([upright.field, turned.field], [0, 180])["tilt"].lens
    """
    try:
        check_angles(len(models), turned_deg)
    except ValueError as error:
        raise InputError(str(error)) from error
    lengths = sorted({model.reference_nm for model in models})
    if len(lengths) > 1:
        shown = " and ".join(f"{nm:g}" for nm in lengths)
        raise InputError(
            f"the sessions' waves are of {shown} nm: give their plans one fit.reference_wavelength_nm, and fit again"
        )
    terms = [_terms(model, channel) for model in models]
    found = {}
    for name, of in MISALIGNMENTS.items():
        measured = [of(each) for each in terms]
        if all(np.all(np.isfinite(pair.value)) for pair in measured):
            found[name] = split(measured, turned_deg)
    return found


def _terms(model: FieldModel, channel: str | None) -> LensTerms:
    """Return the terms of a channel. Raises DataError for a channel that the field lacks."""
    if channel is None:
        usual = USUAL_CHANNEL in model.channels
        channel = USUAL_CHANNEL if usual else model.channels[0]
    try:
        return lens_terms(model, channel)
    except ValueError as error:
        raise DataError(str(error)) from error
