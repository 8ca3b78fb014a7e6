"""Model error: the bias of a session whose model lacks a camera part that its frames show.

A sandwich covariance describes how residuals that are not noise scatter an estimate, but not a bias common to all fits. The
bias follows from the same fits with the part. Estimates are not corrected; their standard errors include the bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.candidate import Measured
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Optimum
from labkit.estimation.settings import SETTINGS
from labkit.optics.wavefront import DEFOCUS
from labkit.optics.zernike import twin_signs
from labkit.types import Floats


def shift(optimum: Optimum, with_missing: Optimum) -> tuple[Floats, float]:
    """Return the change of a wavefront due to missing parts: (modes,) waves RMS, and ln of the ratio of working f-numbers.

    Of two twins the nearer counts.
    """
    near = _near(optimum, with_missing)
    return near.waves - optimum.waves, float(np.log(near.optics.f_number / optimum.optics.f_number))


def confirmed(session: Estimate, index: int) -> bool:
    """Whether a fit is at the optimum that explains its frames once the missing parts are in the model."""
    optimum, complete = session.fits[index].optimum, session.with_all_parts(index)
    if optimum is complete or not complete.verdict.accepted:
        return False
    modes, _ = shift(optimum, complete)
    above_defocus = [k for k, j in enumerate(optimum.noll) if j != DEFOCUS]
    return float(np.linalg.norm(modes[above_defocus])) < SETTINGS.sure_waves


def with_model_error(session: Estimate) -> Estimate:
    """Include the bias due to missing parts in the errors of the lens."""
    if session.lens is None or not any(session.with_missing):
        return session
    model = session.lens.model
    shifts = np.zeros_like(session.lens.measured.values)
    for k in session.members:
        row = session.rows[k]
        assert row is not None
        shifts[row] = _measured_shift(session.fits[k].optimum, session.with_all_parts(k), (*model.noll, *model.parts))
    return replace(session, lens=session.lens.with_bias(shifts))


def _measured_shift(optimum: Optimum, with_missing: Optimum, labels: Sequence[str | int]) -> Floats:
    """Return the change (values,) due to missing parts; a part that is absent from one of the optima counts as 0."""
    here, there = optimum.measured, _near(optimum, with_missing).measured
    before, after = _by_label(here), _by_label(there)
    moved = [after.get(label, 0.0) - before.get(label, 0.0) for label in labels]
    return np.array([*moved, *(there.values[-2:] - here.values[-2:])])


def _by_label(measured: Measured) -> dict[str | int, float]:
    labels: list[str | int] = [*measured.noll, *measured.parts]
    return dict(zip(labels, measured.values.tolist(), strict=False))


def _near(optimum: Optimum, other: Optimum) -> Optimum:
    """Return another optimum or its twin, whichever is nearer."""
    even = twin_signs(optimum.noll) < 0
    return other.twin() if optimum.waves[even] @ other.waves[even] < 0 else other
