"""The body that took a session's photographs, where its colour filters are in the table."""

from __future__ import annotations

from labkit.errors import RawError
from labkit.photographs.container import recognise
from labkit.plan import Plan
from labkit.session.session import Session
from labkit.spectra import TYPICAL, body_of


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
