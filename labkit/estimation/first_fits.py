"""Which observations of a session are fitted first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labkit.estimation.observation import Observation
from labkit.plan import leading_channel


def anchors(observations: Sequence[Observation], places: Sequence[int]) -> list[int]:
    """Return the reference channel at the nearest and the farthest range; one observation if ranges are unknown.

    Of tiles, the one nearest to the middle of the frame.
    """
    channels = [observations[k].channel for k in places]
    first = leading_channel(channels)
    of = [k for k in places if observations[k].channel == first]
    inner = observations[min(of, key=lambda k: np.hypot(*observations[k].place))].tile
    of = [k for k in of if observations[k].tile == inner]
    ranges = {k: r for k in of if (r := observations[k].measured_range_mm) is not None}
    if not ranges:
        return of[:1]
    ends = min(ranges, key=ranges.__getitem__), max(ranges, key=ranges.__getitem__)
    return list(dict.fromkeys(ends))


def worst_predicted(
    observations: Sequence[Observation], variances: Mapping[int, float], most: int
) -> list[int]:
    """Return, of each channel, the observations whose defocus is predicted worst.

    Parameters
    ----------
    observations : of the session
    variances : of predicted defocus, by the place of an observation
    most : number of observations of a channel: of terms that its wavefront has over the field, 1 without tiles
    """
    ranked = sorted(variances, key=lambda k: -variances[k])
    chosen = list[int]()
    for channel in dict.fromkeys(observations[k].channel for k in variances):
        of = [k for k in ranked if observations[k].channel == channel]
        chosen += of[:most]
    return chosen
