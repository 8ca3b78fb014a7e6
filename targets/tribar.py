"""Pairs of three-bar groups, upright and lying, in octaves: each half as large as the one above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labkit.errors import TargetError
from labkit.target.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec

MOST_OCTAVES = 8
FIELD = 12
"""Side of a triple's field in cells of half a bar: bars of 2 x 10 with 2 between them, 1 of black around."""


def triple() -> Floats:
    """Return (12, 12) three upright white bars, five times as long as wide, one width apart (MIL-STD-150A)."""
    bars = np.zeros((FIELD, FIELD))
    for left in (1, 5, 9):
        bars[1:-1, left : left + 2] = 1.0
    return bars


def tribar_cells(order: int) -> Floats:
    """Return (12 2**order, same) radiances: the largest groups above, the next octave twice below."""
    upright = np.kron(triple(), np.ones((2 ** (order - 1),) * 2))
    below = np.zeros((upright.shape[0], 2 * upright.shape[0]))
    if order > 1:
        below = np.tile(tribar_cells(order - 1), 2)
    return np.concatenate([np.concatenate([upright, upright.T], axis=1), below])


def open_target(spec: TargetSpec) -> CellTarget:
    """Return ``spec.order`` octaves of bars, ``spec.size_mm`` a side.

    The widest bars are 1/12 of the side wide, bars of octave k 1/12 over 2**(k - 1). Raises
    TargetError for an order outside 1..8.
    """
    if spec.order is None or not 1 <= spec.order <= MOST_OCTAVES:
        raise TargetError(
            f"[target] order = {spec.order}: a tri-bar target has an order of 1 to {MOST_OCTAVES} octaves"
        )
    return CellTarget(
        tribar_cells(spec.order), (spec.size_mm, spec.size_mm), SURROUNDS[spec.surround]
    )
