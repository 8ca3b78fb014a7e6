"""How broad the light of each channel may be, where the plan does not say: photographs hardly tell, and PSFs hang on it."""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.special import ndtri

from labkit.estimation.estimate import Estimate
from labkit.estimation.scores import ScoreTest
from labkit.imaging.parts import SpectrumWidth
from labkit.optics.spectrum import WIDEST
from labkit.plan import Plan

ONE_SIDED = float(ndtri(0.95))
"""Standard errors, above which a normal error is 5 times in 100."""


def widest_light_nm(session: Estimate, plan: Plan) -> dict[str, float]:
    """By channel, standard deviations of the light that its photographs allow, nm: the largest, with 95 % confidence.

    At most `WIDEST` of the wavelength. Of channels of which the plan states no spectrum, nor the fits have one, by the score
    tests of all fits that belong to the session.
    """
    silent = {c.name: c.wavelength_nm for c in plan.channel if c.spectrum is None and c.width_nm is None}
    said = dict[str, list[ScoreTest]]()
    for k in session.trusted:
        channel, scores = session.fits[k].channel, session.with_all_parts(k).scores
        if channel in silent and SpectrumWidth.name in scores:
            said.setdefault(channel, []).append(scores[SpectrumWidth.name])
    return {name: silent[name] * _most(reduce(ScoreTest.__add__, tests)) for name, tests in said.items()}


def _most(test: ScoreTest) -> float:
    """Relative to the wavelength. No light is less broad than one wavelength is."""
    (square,), (information,) = test.step, test.information.diagonal()
    return min(float(np.sqrt(max(square, 0.0) + ONE_SIDED * information**-0.5)), WIDEST)
