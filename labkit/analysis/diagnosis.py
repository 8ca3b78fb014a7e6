"""Which parts of a camera a session calls for that its model lacks, by its fits together; and what was tried."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce

import numpy as np
from scipy.linalg import block_diag

from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.inference.cone import Measured
from labkit.inference.missing_parts import Call
from labkit.inference.search import CALLED_FOR

ALIKE = 4.0
"""Log-likelihood by which one part must be called for more than another that is more common: by one number more it gains as
much by chance once in 200 times."""

BLURS = ("low_pass_filter", "diffusion", "smear", "low_pass_filter_turned")
"""Parts that blur alike to first order, the most common first."""

DROPPED = 8.0
"""Log-likelihood that a part must be worth; below, it is taken out again."""


def lacks(optics: Iterable[Optics]) -> list[str]:
    """Parts that none of some optics have."""
    names = [of.lacking for of in optics]
    return [name for name in names[0] if all(name in others for others in names)]


def together(every: Sequence[Mapping[str, Call]], channels: Sequence[str]) -> dict[str, Call]:
    """Of fits that share the camera, by name, where all lack the part. channels: theirs, which have some parts of their own."""
    names = [name for name in every[0] if all(name in of for of in every)]
    return {name: _summed([of[name] for of in every], channels if KNOWN[name].per_channel else "") for name in names}


def _summed(calls: Sequence[Call], channels: Sequence[str]) -> Call:
    """Of one part, the calls of all fits. channels: theirs, if each channel has numbers of its own."""
    if not channels:
        return reduce(Call.__add__, calls)
    each = [
        reduce(Call.__add__, (call for call, of in zip(calls, channels, strict=True) if of == one))
        for one in dict.fromkeys(channels)
    ]
    return Call(np.concatenate([c.slope for c in each]), block_diag(*(c.information for c in each)))


def called_for(summed: Mapping[str, Call]) -> str | None:
    """The part that is called for most, a more common one before another that gains as much; None where none is."""
    gains = {name: call.gain for name, call in summed.items()}
    best = max(gains.values(), default=0.0)
    return next((name for name, gain in gains.items() if gain > max(best - ALIKE, CALLED_FOR)), None)


def commoner(name: str, optics: Optics) -> list[str]:
    """Parts that blur much like another, are more common, and that optics lack; the most common first."""
    if name not in BLURS:
        return []
    return [other for other in BLURS[: BLURS.index(name)] if other in optics.lacking]


def numbers(names: Sequence[str]) -> int:
    """That parts have, together."""
    return sum(len(KNOWN[name].labels) for name in names)


def worth(fits: Sequence[Measured]) -> dict[str, float]:
    """Of the parts of the camera that fits have, by name, the log-likelihood that they would lose without, to second order."""
    worths = dict[str, float]()
    for measured in fits:
        names = [label.split(".")[0] for label in measured.parts]
        for name in dict.fromkeys(name for name in names if name in KNOWN):
            at = len(measured.noll) + np.flatnonzero([n == name for n in names])
            values, covariance = measured.values[at], measured.covariance[np.ix_(at, at)]
            worths[name] = worths.get(name, 0.0) + 0.5 * float(values @ np.linalg.solve(covariance, values))
    return worths


def idle(fits: Sequence[Measured]) -> list[str]:
    """Parts whose numbers are none but for chance, all fits together."""
    return [name for name, value in worth(fits).items() if value < DROPPED]
