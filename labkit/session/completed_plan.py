"""Complete a session's plan: by the filters of the body that took its photographs, and by the target's size as displayed."""

from __future__ import annotations

from math import isclose

import numpy as np

from labkit.errors import RawError
from labkit.photographs.container import recognise
from labkit.plan import Plan
from labkit.session.session import Session
from labkit.spectra import TYPICAL, body_of
from labkit.target.target import open_target


def with_body_filters(session: Session, plan: Plan) -> Plan:
    """Return a plan with the filters of the body that the session's photographs name.

    A plan that states its filters, or names no light, stays as it is. A channel without a
    stated wavelength gets the mean of the light through these filters.
    """
    if plan.sensor.filters is not None or not any(c.light for c in plan.channel):
        return plan
    filters = {"filters": body_of(_camera(session)) or TYPICAL}
    seen = plan.replace(sensor=filters)
    channels = []
    for channel in seen.channel:
        stated = channel.model_dump(exclude_unset=True)
        named = seen.named_light(channel.name)
        if named is not None and "wavelength_nm" not in stated:
            nm, std = named.mean.value, named.mean.std
            stated = {"wavelength_std_nm": round(std, 1), **stated}
            stated["wavelength_nm"] = round(nm, 1)
        channels.append(stated)
    return seen.replace(channel=channels)


def _camera(session: Session) -> str:
    """Return the body that the first photograph names; empty where it names none."""
    try:
        return recognise(session.frames[0].path).camera if session.frames else ""
    except (RawError, OSError):
        return ""


def with_shown_size(session: Session, plan: Plan) -> Plan:
    """Return a plan with the target's size as displayed, and the distance of a grid's targets.

    A plan whose size differs from the session's own is returned unchanged, because its
    target was measured; so is a plan of a target that no display showed. A size wrong by a
    thousandth makes the scale wrong by as much, and with it focal length, range zero and
    f-number.
    """
    sizes = [event["shown_size_mm"] for event in session.events if "shown_size_mm" in event]
    asked = session.plan.target
    if not sizes or plan.target.size_mm != asked.size_mm:
        return plan
    size_mm = asked.size_mm * float(
        np.mean(np.divide(sizes[-1], open_target(asked).size_mm))
    )
    shown = {} if isclose(size_mm, asked.size_mm) else {"size_mm": size_mm}
    pitches = [e["shown_pitch_mm"] for e in session.events if "shown_pitch_mm" in e]
    if plan.target.of_many and pitches and plan.target.pitch_mm == asked.pitch_mm:
        shown["pitch_mm"] = float(pitches[-1])
    return plan.replace(target=shown) if shown else plan
