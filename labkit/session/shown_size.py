"""How large a display drew the target: whole panel pixels a cell, which the capture wrote into the journal."""

from __future__ import annotations

from math import isclose

import numpy as np

from labkit.plan import Plan
from labkit.session.session import Session
from labkit.target import open_target


def with_shown_size(session: Session, plan: Plan) -> Plan:
    """A plan to fit the session with, its target as large as the display drew it.

    A plan that states another size than the session's own is left as it is: the target was measured. So is one of a target
    that no display showed. A size that is off by a thousandth is a scale that is: focal length and tape take it up, and the
    f-number with them.
    """
    sizes = [event["shown_size_mm"] for event in session.events if "shown_size_mm" in event]
    asked = session.plan.target
    if not sizes or plan.target.size_mm != asked.size_mm:
        return plan
    size_mm = asked.size_mm * float(
        np.mean(np.divide(sizes[-1], open_target(asked).size_mm))
    )
    return (
        plan
        if isclose(size_mm, asked.size_mm)
        else plan.replace(target={"size_mm": size_mm})
    )
