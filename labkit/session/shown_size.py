"""The target's size as displayed: whole panel pixels a cell, recorded by the capture in the journal."""

from __future__ import annotations

from math import isclose

import numpy as np

from labkit.plan import Plan
from labkit.session.session import Session
from labkit.target import open_target


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
