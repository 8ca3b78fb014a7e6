"""A checkerboard of black and white squares, the top left one white."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labkit.errors import TargetError
from labkit.target.target import SURROUNDS, CellTarget

if TYPE_CHECKING:
    from labkit.plan import TargetSpec


def open_target(spec: TargetSpec) -> CellTarget:
    """Return ``spec.cells`` squares along each side of ``spec.size_mm``.

    Raises TargetError without the number of squares.
    """
    if spec.cells is None:
        raise TargetError(
            '[target] kind = "checkerboard" needs cells, the number of squares along a side'
        )
    squares = 1.0 - np.indices((spec.cells, spec.cells)).sum(axis=0) % 2
    return CellTarget(squares, (spec.size_mm, spec.size_mm), SURROUNDS[spec.surround])
