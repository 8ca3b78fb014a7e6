"""Upper limits on the spectral width of each channel's light, where the plan does not state the spectrum.

Photographs hardly determine the width, and PSFs depend on it.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.special import ndtri

from labkit.estimation.estimate import Estimate
from labkit.estimation.scores import ScoreTest
from labkit.imaging.parts import SpectrumWidth
from labkit.optics.spectrum import WIDEST_SPECTRUM
from labkit.plan import Plan

ONE_SIDED = float(ndtri(0.95))
"""Quantile, in standard errors, that a normal error exceeds with a probability of 5 %."""


def widest_light_nm(session: Estimate, plan: Plan) -> dict[str, float]:
    """Return upper limits, with 95 % confidence, on the standard deviation of each channel's light, nm.

    Limits follow from the score tests of all fits that belong to the session, and are at most `WIDEST` of the wavelength.
    Channels whose spectrum is stated or fitted are left out.
    """
    silent = {
        c.name: c.wavelength_nm
        for c in plan.channel
        if c.spectrum is None and c.width_nm is None
    }
    said = dict[str, list[ScoreTest]]()
    for k in session.trusted:
        channel, scores = session.fits[k].channel, session.with_all_parts(k).scores
        if channel in silent and SpectrumWidth.name in scores:
            said.setdefault(channel, []).append(scores[SpectrumWidth.name])
    return {
        name: silent[name] * _most(reduce(ScoreTest.__add__, tests))
        for name, tests in said.items()
    }


def _most(test: ScoreTest) -> float:
    """Return the upper limit relative to the wavelength; a negative estimate of the variance counts as 0."""
    (square,), (information,) = test.step, test.information.diagonal()
    return min(
        float(np.sqrt(max(square, 0.0) + ONE_SIDED * information**-0.5)), WIDEST_SPECTRUM
    )
