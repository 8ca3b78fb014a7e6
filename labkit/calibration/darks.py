"""Reduce darks: the offset of each pixel, and the pixels that are too hot or too noisy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from labkit.calibration.masters import clipped_mean, outliers, shrunk
from labkit.calibration.photon_transfer import (
    OUTLIER_PROBABILITY,
    ROUNDING_VARIANCE,
    Scatter,
)
from labkit.calibration.stack import Stack
from labkit.findings.findings import Finding, found
from labkit.session.frame import Frame
from labkit.types import Bools, Floats32


@dataclass(frozen=True, slots=True, eq=False)
class Dark:
    """offset: (rows, cols) counts without light; usable: (rows, cols) neither hot nor noisy; scatter: of each channel."""

    offset: Floats32
    usable: Bools
    scatter: Mapping[str, tuple[Scatter, ...]]


def reduce_darks(stack: Stack, names: Sequence[str]) -> Dark:
    """Return the dark level of each plane, single pixels' reliable deviations included, and the hot pixels.

    names: of the channels
    """
    mean = clipped_mean(stack.counts)
    offset = np.empty(mean.shape, dtype=np.float32)
    usable = np.ones(mean.shape, dtype=np.bool_)
    frames = len(stack.counts)
    for plane in stack.first.every_plane:
        values = mean[plane]
        good = ~outliers(values, np.ones(values.shape, dtype=np.bool_), least=1.0)
        if frames > 1:
            variance = stack.counts[(slice(None), *plane)].var(
                axis=0, ddof=1, dtype=np.float64
            )
            typical = float(np.median(variance) / (chdtri(frames - 1, 0.5) / (frames - 1)))
            limit = chdtri(frames - 1, OUTLIER_PROBABILITY) / (frames - 1)
            good &= variance <= limit * max(typical, ROUNDING_VARIANCE)
            offset[plane] = shrunk(values, float(variance[good].mean()) / frames)[0]
        else:
            offset[plane] = values[
                good
            ].mean()  # one frame cannot separate a pixel's offset from noise
        usable[plane] = good
    where = {name: stack.first.channel_mask(name) & usable for name in names}
    return Dark(
        offset,
        usable,
        {name: tuple(stack.scatter(where[name], offset, lit=False)) for name in names},
    )


def dark_findings(kinds: Mapping[str, Sequence[Frame]]) -> Iterable[Finding]:
    """Return the assumptions about the dark level made for missing frames.

    kinds: the session's frames by kind
    """
    if not kinds["dark"] and not kinds["bias"]:
        yield found("no-dark-frames")
        return
    if not kinds["dark"]:
        yield found("bias-instead-of-darks")
    exposures = {
        frame.exposure_s
        for frame in (*kinds["dark"], *kinds["target"])
        if frame.exposure_s is not None
    }
    if kinds["dark"] and exposures and max(exposures) > 1.05 * min(exposures):
        yield found("dark-exposure-differs", least_s=min(exposures), most_s=max(exposures))
