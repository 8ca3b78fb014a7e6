"""How well a plan's numbers are known: wavelengths that are exact, numbers that are far off, and errors that allow for both.

A wavelength stated without an error has a typical one, or that of rounding. Photographs tell which holds.

A mistake is a stated number that is wrong beyond its standard error: another aperture, another colour, another target. The
photographs determine the cone times the wavelength over the pixel pitch, the size of the target over the pixel pitch, and
blur over range. So a mistake contradicts the other numbers. Each number that may be mistaken is a model of its own. The
evidence of the models gives their probabilities, and the errors contain the spread among the models: J. A. Hoeting et al.,
Stat. Sci. 14, 382 (1999).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.laws import (
    F_NUMBER,
    FOCAL_LENGTH,
    PIXEL_PITCH,
    RANGE_ZERO,
    SIZE,
    WAVELENGTH,
    Place,
)
from labkit.estimation.lens_fit import LensFit, fit_lens
from labkit.estimation.settings import SETTINGS


def possible_mistakes(channels: Sequence[str]) -> Iterator[Place]:
    """Yield the column of each number that may be a mistake; the wavelengths of several channels may be so together."""
    for kind in (F_NUMBER, FOCAL_LENGTH, SIZE, PIXEL_PITCH, RANGE_ZERO):
        yield kind, ()
    for channel in channels:
        yield WAVELENGTH, (channel,)
    if len(channels) > 1:
        yield WAVELENGTH, ()


def with_mistakes(lens: LensFit) -> Iterator[LensFit]:
    """Yield the estimate under each possible mistake, and otherwise the same laws."""
    for column in possible_mistakes(lens.model.channels):
        yield under(lens, column)


def under(lens: LensFit, column: Place | None) -> LensFit:
    """Return the estimate from the same measurements if the number of `column` is mistaken."""
    laws = replace(lens.model.laws, mistaken=column)
    if laws == lens.model.laws:
        return lens
    return fit_lens(replace(lens.model, laws=laws), lens.measured)


def exact_light(lens: LensFit) -> LensFit:
    """Return the estimate from the same measurements if all wavelengths are as stated, but for rounding."""
    laws = replace(lens.model.laws, exact_light=True)
    return fit_lens(replace(lens.model, laws=laws), lens.measured, lens.solved.point)


def models(lens: LensFit, explained: bool = True) -> list[tuple[float, LensFit]]:
    """Return probability and estimate of all models, the most probable first.

    Wavelengths stated without errors are as likely to be exact as they are to have the usual errors; mistakes are
    rare. The fits of a field's tiles are not asked for mistakes. Differences of evidence are divided by the square of the
    Birge ratio: misfits of all models do not count as evidence.

    Parameters
    ----------
    lens : the estimate, with or without a mistake
    explained : whether most fits are explained; otherwise what the frames' model lacks moves wavelengths, and tells nothing
    """
    plain = under(lens, None)
    right = [exact_light(plain)] if plain.model.stated.light_may_be_exact else []
    right.append(plain)
    mistaken = [] if lens.model.tiled else [f for one in right for f in with_mistakes(one)]
    fits = [*right, *mistaken]
    evidence = np.array([fit.log_evidence for fit in fits])
    if not explained:
        evidence[: len(right)] = evidence[: len(right)].max()
    best = fits[int(np.argmax(evidence))]
    weights = np.exp((evidence - evidence.max()) / best.birge_ratio**2)
    weights[len(right) :] *= SETTINGS.mistake_odds
    found = zip((weights / weights.sum()).tolist(), fits, strict=True)
    return sorted(found, key=lambda one: -one[0])


def with_doubts(lens: LensFit, explained: bool = True) -> LensFit:
    """Return the likeliest estimate, with a mistake only if one is nearly sure; errors allow for all others. See `models`."""
    every = models(lens, explained)
    right = [one for one in every if one[1].model.laws.mistaken is None]
    doubtful = sum(chance for chance, _ in right) > SETTINGS.mistake_odds
    likeliest = right[0][1] if doubtful else every[0][1]
    others = tuple(one for one in every if one[1] is not likeliest)
    return replace(likeliest, others=others)
