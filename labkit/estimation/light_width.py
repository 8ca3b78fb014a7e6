"""Upper limits on the spectral width of each channel's light, where the plan states no spectrum, or names a typical one.

Photographs hardly determine the width, and PSFs depend on it.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.special import ndtri

from labkit.estimation.estimate import Estimate
from labkit.estimation.laws import PART
from labkit.estimation.scores import ScoreTest
from labkit.imaging.parts import SpectrumWidth
from labkit.optics.spectrum import WIDEST_SPECTRUM
from labkit.plan import Plan

LABEL = f"{SpectrumWidth.name}.{SpectrumWidth.labels[0]}"
ONE_SIDED = float(ndtri(0.95))
"""Quantile, in standard errors, that a normal error exceeds with a probability of 5 %."""


def widest_light_nm(session: Estimate, plan: Plan) -> dict[str, float]:
    """Return upper limits, with 95 % confidence, on the standard deviation of each channel's light, nm.

    Limits follow from the score tests of all fits that belong to the session. Where the plan names the light, the width by the
    tables counts as a measurement, with the standard deviation among lights and bodies; elsewhere limits are at most `WIDEST`
    of the wavelength. Of a width that the session estimated the limit is its own. Channels whose spectrum is stated are left
    out.
    """
    open_ = {c.name: c for c in plan.channel if c.spectrum is None and c.width_nm is None}
    said = dict[str, list[ScoreTest]]()
    for k in session.trusted:
        channel, scores = session.fits[k].channel, session.with_all_parts(k).scores
        if channel in open_ and SpectrumWidth.name in scores:
            said.setdefault(channel, []).append(scores[SpectrumWidth.name])
    limits = _of_estimated(session, plan)
    for name, tests in said.items():
        test, nm = reduce(ScoreTest.__add__, tests), open_[name].wavelength_nm
        named = plan.named_light(name)
        limits[name] = nm * (
            _most(test)
            if named is None
            else _most_of_named(test, named.width.value / nm, named.width.std / nm)
        )
    return limits


def _of_estimated(session: Estimate, plan: Plan) -> dict[str, float]:
    """Return upper limits on the widths that a session estimated, nm, by channel."""
    if session.lens is None:
        return {}
    parts = {
        fit.channel: part
        for fit in session.fits
        for part in fit.optics.parts
        if isinstance(part, SpectrumWidth)
    }
    limits = dict[str, float]()
    for column in session.lens.model.columns:
        if column.kind != PART or column.name[0] != LABEL:
            continue
        name = str(column.name[1])
        part = parts.get(name, SpectrumWidth())
        excess = session.lens.value(PART, *column.name)
        variance = max(part.typical.variance + excess, 0.0)
        most = variance + ONE_SIDED * session.lens.std(PART, *column.name)
        nm = next(c.wavelength_nm for c in plan.channel if c.name == name)
        limits[name] = nm * float(np.sqrt(min(most, part.broadest.variance)))
    return limits


def _most(test: ScoreTest) -> float:
    """Return the upper limit relative to the wavelength; a negative estimate of the variance counts as 0."""
    (square,), (information,) = test.step, test.information.diagonal()
    return min(
        float(np.sqrt(max(square, 0.0) + ONE_SIDED * information**-0.5)), WIDEST_SPECTRUM
    )


def _most_of_named(test: ScoreTest, width: float, std: float) -> float:
    """Return the upper limit for light of a known width, with its standard error, all relative to the wavelength.

    The score test is for the variance in excess of that of the known width.
    """
    (slope,), (information,) = test.slope, test.information.diagonal()
    information += (2 * width * std) ** -2
    excess = slope / information + ONE_SIDED * information**-0.5
    return float(np.sqrt(max(width**2 + excess, 0.0)))
