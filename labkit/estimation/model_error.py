"""Model error: the bias of a session whose model lacks a camera part that its frames show.

A sandwich covariance describes how residuals that are not noise scatter an estimate, but not a bias common to all fits. The
bias follows from the same fits with the part. Estimates are not corrected; their standard errors include the bias.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Measured
from labkit.estimation.estimate import Estimate
from labkit.estimation.local import Optimum
from labkit.estimation.select import exact_lens
from labkit.estimation.settings import SETTINGS
from labkit.optics.wavefront import DEFOCUS
from labkit.types import Floats


def shift(optimum: Optimum, with_missing: Optimum) -> tuple[Floats, float]:
    """Return the change of a wavefront due to missing parts: (modes,) waves RMS, and ln of the ratio of working f-numbers.

    Of two twins the nearer counts.
    """
    near = with_missing.nearest_to(optimum)
    return near.waves - optimum.waves, float(
        np.log(near.optics.f_number / optimum.optics.f_number)
    )


def confirmed(session: Estimate, index: int) -> bool:
    """Whether a fit is at the optimum that explains its frames once the missing parts are in the model."""
    optimum = session.fits[index].optimum
    complete = session.with_all_parts(index)
    if optimum is complete or not complete.verdict.accepted:
        return False
    modes, _ = shift(optimum, complete)
    others = np.array(optimum.noll) != DEFOCUS
    return float(np.linalg.norm(modes[others])) < SETTINGS.sure_waves


def with_model_error(session: Estimate) -> Estimate:
    """Include the bias due to missing parts in the errors of the lens.

    The bias is the change of the lens to that of the same fits with the parts, under the same laws. A disagreement of the
    fits that the parts explain does not raise the Birge ratio.
    """
    lens = session.lens
    if lens is None or not any(session.with_missing):
        return session
    chosen: list[Measured | None] = [None] * len(lens.model.readings)
    for k in session.members:
        complete = session.with_all_parts(k).nearest_to(session.fits[k].optimum)
        chosen[session.row(k)] = complete.candidate.measured
    model = lens.model
    members = lens.measured.used
    complete_lens = exact_lens(
        model.readings, chosen, members, model.stated, laws=model.laws
    )
    values = {
        (c.kind, c.name): v
        for c, v in zip(complete_lens.model.columns, complete_lens.theta, strict=True)
    }
    there = np.array(
        [values.get((c.kind, c.name), 0.0) for c in lens.model.columns]
    )  # a part that gave way is 0
    bias = Point(there - lens.theta, complete_lens.solved.point.own - lens.solved.point.own)
    bias_chi2 = complete_lens.solved.chi2 - lens.solved.chi2
    return replace(session, lens=replace(lens, bias=bias, bias_chi2=bias_chi2))
