"""How wrong a session may be whose model lacks a part of the camera that its frames call for.

A sandwich tells how residuals that are not noise scatter an estimate, not where they drag all fits alike. The same fits with
the part say that. Estimates stay as the model has them, which was asked for or explains as much; their errors hold the move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.analysis.session_fits import SessionFits
from labkit.inference.fit import WavefrontFit
from labkit.inference.search import PREDICTED_WAVES
from labkit.optics.wavefront import DEFOCUS
from labkit.optics.zernike import twin_signs
from labkit.types import Floats


def shift(fit: WavefrontFit, with_missing: WavefrontFit) -> tuple[Floats, float]:
    """(modes,) waves RMS and ln of the cone by which what is missing would move a wavefront. Of two twins the nearer counts."""
    near = _near(fit, with_missing)
    return near.waves - fit.waves, float(np.log(near.f_number / fit.f_number))


def confirmed(session: SessionFits, index: int) -> bool:
    """Whether a fit is at the optimum that explains its frames once the model has what it lacks."""
    fit, fullest = session.fits[index].fit, session.fullest(index).fit
    if fit is fullest or not fullest.verdict.accepted:
        return False
    modes, _ = shift(fit, fullest)
    above_defocus = [k for k, j in enumerate(fit.noll) if j != DEFOCUS]
    return float(np.linalg.norm(modes[above_defocus])) < PREDICTED_WAVES


def with_model_error(session: SessionFits) -> SessionFits:
    """With the lens's errors as what is missing makes them."""
    if session.lens is None or not any(session.with_missing):
        return session
    shifts = [_measured_shift(session.fits[k].fit, session.fullest(k).fit) for k in session.members]
    return replace(session, lens=session.lens.leaning(shifts))


def _measured_shift(fit: WavefrontFit, with_missing: WavefrontFit) -> Floats:
    """(values,) as of `Measured`; a part that the other has no more is one of numbers 0."""
    here, there = fit.measured, _near(fit, with_missing).measured
    known = dict(zip([*there.noll, *there.parts], there.values, strict=False))
    moved = [known.get(label, 0.0) for label in (*here.noll, *here.parts)]
    return np.asarray([*moved, *there.values[-2:]]) - here.values


def _near(fit: WavefrontFit, other: WavefrontFit) -> WavefrontFit:
    """Another, or its twin, whichever is nearer."""
    even = twin_signs(fit.noll) < 0
    return other.twin() if fit.waves[even] @ other.waves[even] < 0 else other
