"""Whether a photograph is well exposed for what it is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from labkit.lab.raw import Mosaic
from labkit.lab.session import Kind

GLINTS = 0.03
"""Share of a channel's pixels that may be as bright as they like: hot pixels, a reflection."""

FAINTEST = 0.01
"""Share of full scale that what is lit must reach, and that a dark frame must not."""


def exposure_problem(mosaic: Mosaic, kind: Kind, channels: Iterable[str]) -> str | None:
    """What is wrong with a photograph's exposure, as the end of a sentence about it; None if it is usable.

    Raises RawError for a channel that the filter array lacks.
    """
    black = mosaic.black_map()
    for name in channels:
        mask = mosaic.channel_mask(name)
        share = (mosaic.counts[mask] - black[mask]) / (mosaic.white - black[mask])
        middle, bright = np.quantile(share, [0.5, 1 - GLINTS])
        if kind in ("dark", "bias"):
            if middle > FAINTEST:
                return "has seen light: it is no dark frame; cover the lens"
        elif bright >= 1:
            return f"is overexposed: over {GLINTS:.0%} of channel {name} is full; expose less or dim the display"
        elif bright < FAINTEST:
            return f"is black: channel {name} reaches {bright:.1%} of full scale; expose longer or light the display"
    return None
