"""Camera parts that a session estimated, in data-sheet units, and upper limits on the width of each channel's light.

Photographs hardly determine the width, on which PSFs depend.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np
from scipy.special import ndtri

from labkit.estimation.estimate import Estimate
from labkit.estimation.laws import PART
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.scores import ScoreTest
from labkit.imaging.estimated import Estimated
from labkit.imaging.parts import ESTIMATED, OPTIONAL_PARTS, SpectrumWidth
from labkit.optics.spectrum import WIDEST_SPECTRUM
from labkit.plan import Plan
from labkit.types import Floats
from labkit.uncertain import Uncertain


def model_parts(session: Estimate, plan: Plan) -> dict[str, Uncertain]:
    """Return the data-sheet quantities of all fitted parts of camera and panel, by key."""
    numbers = _of_lens(session.lens) if session.lens is not None else _of_fits(session)
    groups = dict[tuple[str, ...], list[Uncertain]]()
    for (label, *channel), number in numbers.items():
        groups.setdefault((label.partition(".")[0], *channel), []).append(number)
    channels = {channel.name: channel for channel in plan.channel}
    names = list(dict.fromkeys(name for name, *_ in groups))
    quantities = dict[str, Uncertain]()
    for name, *channel in sorted(groups, key=lambda of: names.index(of[0])):
        of = channels[channel[0]] if channel else None
        part = _group(session, name, channel)
        quantities |= part.quantities(groups[name, *channel], of)
    return quantities


def in_words(parts: Collection[str]) -> dict[str, str]:
    """Return camera parts in words, by name."""
    return {name: OPTIONAL_PARTS[name].words for name in parts}


def _group(session: Estimate, name: str, channel: Sequence[str]) -> Estimated:
    """Return a group of numbers as the fits have it, of a channel if the numbers are a channel's own."""
    for fit in session.fits:
        for group in fit.optics.estimated:
            if group.name == name and (not channel or fit.channel == channel[0]):
                return group
    return ESTIMATED[name]


def _of_lens(lens: LensFit) -> dict[tuple[str, ...], Uncertain]:
    """Return numbers of all parts with standard errors, by label, and by channel for parts of single channels."""
    return {
        tuple(map(str, column.name)): lens.uncertain(PART, *column.name)
        for column in lens.model.columns
        if column.kind == PART
    }


def _of_fits(session: Estimate) -> dict[tuple[str, ...], Uncertain]:
    """Return numbers of all parts of fits without a common lens: means weighted by their errors, keys as in `_of_lens`."""
    seen = dict[tuple[str, ...], list[tuple[float, float]]]()
    for local in session.fits:
        measured, modes = local.optimum.measured, len(local.optimum.noll)
        for k, label in enumerate(measured.parts, modes):
            own = ESTIMATED[label.partition(".")[0]].per_channel
            name = (label, local.channel) if own else (label,)
            seen.setdefault(name, []).append(
                (measured.values[k], measured.covariance[k, k])
            )
    return {name: _weighted(np.array(pairs)) for name, pairs in seen.items()}


def _weighted(pairs: Floats) -> Uncertain:
    """Return the weighted mean of values and variances (n, 2)."""
    values, variances = pairs.T
    whole = float(np.sum(1 / variances))
    return Uncertain(float(np.sum(values / variances)) / whole, whole**-0.5)


LABEL = f"{SpectrumWidth.name}.{SpectrumWidth.labels[0]}"


ONE_SIDED = float(ndtri(0.95))
"""Quantile, in standard errors, that a normal error exceeds with a probability of 5 %."""


def widest_light_nm(session: Estimate, plan: Plan) -> dict[str, float]:
    """Return upper limits, with 95 % confidence, on the standard deviation of each channel's light, nm, to a tenth.

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
    return {name: round(nm, 1) for name, nm in limits.items()}


def _of_estimated(session: Estimate, plan: Plan) -> dict[str, float]:
    """Return upper limits on estimated widths, nm, by channel."""
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
