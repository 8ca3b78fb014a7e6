"""Fields of several sessions: a screw turned between two of them, or the lens turned on its mount.

A session's tilt is the camera's, without the target's tilt, where the places of the target's
tiles show the tilt: a target tilted differently in the second session moves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from labkit.errors import DataError, InputError
from labkit.field.mount import KnownMove, Screws, check_move
from labkit.field.pair import Pair
from labkit.field.session_geometry import camera_tilt, session_geometry
from labkit.field.split import Split, check_angles, split
from labkit.field.terms import LensTerms, lens_terms
from labkit.field.tiles import sign_is_open
from labkit.optics.field import FieldModel
from labkit.plan import Plan
from labkit.results import Results

USUAL_CHANNEL = "G"


def planned_screws(plan: Plan) -> Screws:
    """Return the screws of a plan's [mount] table. Raises InputError for a plan without them."""
    mount = plan.mount
    if mount.screws_mm is None:
        raise InputError(
            "the plan has no mount.screws_mm: the places [x, y] of three or four screws, in mm, are needed"
        )
    return Screws(mount.screws_mm, mount.screw_pitch_mm, mount.clockwise)


def tilt_of(results: Results, channel: str | None = None) -> Pair:
    """Return the slope of focus over the sensor, µm/mm, without the target's tilt where the tiles' places show it.

    Raises
    ------
    DataError : results without a field or without the channel, or an open sign
    """
    terms = _terms(results, channel)
    if sign_is_open(results):
        raise DataError(
            f"{_name(results)}: the sign of the tilt is open, as of one range: photograph the target at two ranges or more"
        )
    camera = camera_tilt(results, session_geometry(results))
    return terms.tilt.slope if camera is None else camera.slope


MISALIGNMENTS: Mapping[str, Callable[[Results, str | None], Pair]] = {
    "sensor_tilt": tilt_of,
    "coma": lambda results, channel: _terms(results, channel).coma,
    "linear_astigmatism": lambda results, channel: (
        _terms(results, channel).linear_astigmatism
    ),
}
"""Misalignments of the first order, by name."""


def check_screw_move(
    before: Results,
    after: Results,
    screw: int,
    turn_deg: float,
    plan: Plan | None = None,
    channel: str | None = None,
) -> KnownMove:
    """Compare the sensor's tilt before and after a screw was turned by a known angle.

    Parameters
    ----------
    before, after : results of two sessions
    screw : number, from 1
    turn_deg : clockwise
    plan : with the screws; that of `after` for None
    channel : G, or the first, for None

    Raises
    ------
    InputError : no screws, no such screw, or no turn
    DataError : no field, no such channel, or a session whose sign is open

    >>> labkit.check_screw_move(before, after, screw=1, turn_deg=90)
    """
    screws = planned_screws(after.plan if plan is None else plan)
    tilts = [tilt_of(results, channel) for results in (before, after)]
    try:
        return check_move(tilts[0], tilts[1], screws, screw, turn_deg)
    except ValueError as error:
        raise InputError(str(error)) from error


def split_fields(
    sessions: Sequence[Results],
    turned_deg: Sequence[float],
    channel: str | None = None,
) -> dict[str, Split]:
    """Split tilt, coma and linear astigmatism into the body's part and the lens's, by name.

    A misalignment whose modes were not fitted is left out.

    Parameters
    ----------
    sessions : results of each
    turned_deg : angle of the lens in each, clockwise as seen from behind the camera
    channel : G, or the first, for None

    Raises
    ------
    InputError : angles that split nothing, or waves of different wavelengths
    DataError : no field, no such channel, or a session whose sign is open

    >>> labkit.split_fields([upright, turned], [0, 180])["sensor_tilt"].lens
    """
    try:
        check_angles(len(sessions), turned_deg)
    except ValueError as error:
        raise InputError(str(error)) from error
    lengths = sorted({_field(results).reference_nm for results in sessions})
    if len(lengths) > 1:
        shown = " and ".join(f"{nm:g}" for nm in lengths)
        raise InputError(
            f"the sessions' waves are of {shown} nm: give their plans one fit.reference_wavelength_nm, and fit again"
        )
    found = {}
    for name, of in MISALIGNMENTS.items():
        measured = [of(results, channel) for results in sessions]
        if all(np.all(np.isfinite(pair.value)) for pair in measured):
            found[name] = split(measured, turned_deg)
    return found


def _terms(results: Results, channel: str | None) -> LensTerms:
    """Return the terms of a channel. Raises DataError for a channel that the field lacks."""
    model = _field(results)
    if channel is None:
        usual = USUAL_CHANNEL in model.channels
        channel = USUAL_CHANNEL if usual else model.channels[0]
    try:
        return lens_terms(model, channel)
    except ValueError as error:
        raise DataError(str(error)) from error


def _field(results: Results) -> FieldModel:
    """Return the field of results. Raises DataError for results without one."""
    if results.field is None:
        raise DataError(
            f"{_name(results)}: no field was estimated, which needs several tiles: "
            "[target] grid, or [field] tiles, in the plan"
        )
    return results.field


def _name(results: Results) -> str:
    return "the session" if results.folder is None else str(results.folder)
