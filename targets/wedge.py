"""A stepped grey wedge of black and white cells alone, for measuring a camera's tone curve.

Each step is a half-tone. Once a lens has blurred the dots into an even grey, a step's light
is white's times the share of white cells, whatever the panel's gamma: the panel shows only
black and white.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labkit.target.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec

WHITE_CELLS = (0, 1, 2, 4, 6, 9, 12, 16, 20, 25, 30, 36, 42, 49, 56, 64)
"""Of the 64 cells of a step's tile: squares, so that the numbers a camera writes are about evenly spaced."""

STEP_PLACES = (
    (9, 3, 10, 2, 11, 8, 15, 13),
    (5, 1, 4, 14, 7, 12, 6, 0),
    (0, 4, 8, 3, 14, 5, 13, 2),
    (12, 9, 11, 15, 1, 7, 10, 6),
)
"""Where each step stands, twice: of 20,000 random orders that which separates uneven light best from the steps."""

TILES_ALONG_STEP = 8
"""Along a step's side."""


def thresholds() -> Floats:
    """Return (8, 8) numbers 0 to 63 each once, neighbours far apart.

    Bayer, *An optimum method for two-level rendition of continuous-tone pictures*, ICC
    1973.
    """
    order = np.zeros((1, 1))
    for _ in range(3):
        order = np.block([[4 * order, 4 * order + 2], [4 * order + 3, 4 * order + 1]])
    return order


def wedge_cells() -> Floats:
    """Return (256, 512) radiances, 0 or 1: 4 × 8 steps of 64 × 64 cells each."""
    white = np.array(WHITE_CELLS)[np.array(STEP_PLACES)]
    rows, cols = white.shape
    side = len(thresholds()) * TILES_ALONG_STEP
    tiled = np.tile(thresholds(), (rows * TILES_ALONG_STEP, cols * TILES_ALONG_STEP))
    return np.asarray(tiled < white.repeat(side, 0).repeat(side, 1), dtype=np.float64)


def open_target(spec: TargetSpec) -> CellTarget:
    """Return the wedge, ``spec.size_mm`` high and twice as wide."""
    return CellTarget(
        wedge_cells(), (spec.size_mm, 2 * spec.size_mm), SURROUNDS[spec.surround]
    )
