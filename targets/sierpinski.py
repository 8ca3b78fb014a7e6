"""The Sierpinski pre-carpet: squares in nine sizes' steps, edges everywhere. Thesis §3.7."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labkit.errors import TargetError
from labkit.target.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec

MOST_CARPET_ORDER = 8


def carpet_cells(order: int) -> Floats:
    """Return (3**order, 3**order) radiances of a pre-carpet: removed middle squares 1 (white), the rest 0."""
    digits = np.arange(3**order)[:, None] // 3 ** np.arange(order) % 3 == 1
    removed = np.zeros((3**order, 3**order), dtype=bool)
    for level in range(order):
        removed |= np.outer(digits[:, level], digits[:, level])
    return removed.astype(np.float64)


def open_target(spec: TargetSpec) -> CellTarget:
    """Return a carpet of ``spec.order``, ``spec.size_mm`` a side. Raises TargetError for an order outside 1..8."""
    if spec.order is None or not 1 <= spec.order <= MOST_CARPET_ORDER:
        raise TargetError(
            f"[target] order = {spec.order}: a Sierpinski carpet has an order of 1 to {MOST_CARPET_ORDER}"
        )
    return CellTarget(
        carpet_cells(spec.order), (spec.size_mm, spec.size_mm), SURROUNDS[spec.surround]
    )
