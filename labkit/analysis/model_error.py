"""How wrong a session may be whose model lacks a part of the camera that its frames call for.

A sandwich tells how residuals that are not noise scatter an estimate, not where they drag all fits alike. The part that is
called for most says that: to first order it would move each fit, and with them the lens, by so much. Estimates stay as the
model has them, which was asked for or explains as much; their errors hold the move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.analysis.local_fits import LocalFit
from labkit.analysis.session_fits import SessionFits
from labkit.types import Floats


def shift(local: LocalFit, session: SessionFits) -> Floats:
    """(values,) by which the part that a session lacks would move what a fit measures, as of `Measured`; 0 where none is."""
    none = np.zeros(len(local.fit.measured.values))
    call = None if session.missing is None else local.fit.calls.get(session.missing)
    numbers = session.missing_numbers.get(local.channel)
    if call is None or numbers is None or len(call.moves) != len(none):
        return none
    return np.asarray(call.moves @ numbers)


def with_model_error(session: SessionFits) -> SessionFits:
    """With the lens's errors as the missing part makes them."""
    if session.missing is None or session.lens is None:
        return session
    shifts = [shift(session.fits[k], session) for k in session.members]
    return replace(session, lens=session.lens.leaning(shifts))
