"""A field of random black and white squares, always the same for a seed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labkit.errors import TargetError
from labkit.target.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec


def noise_cells(cells: int, seed: int) -> Floats:
    """Return (cells, cells) radiances, 0 or 1 with even chances.

    They are a bit generator's raw words, which stay the same in every NumPy; the numbers of
    a Generator may change. A print must match its plan years later.
    """
    words = np.random.PCG64(seed).random_raw(cells * cells)
    return np.asarray(words >> np.uint64(63), dtype=np.float64).reshape(cells, cells)


def open_target(spec: TargetSpec) -> CellTarget:
    """Return ``spec.cells`` squares along each side of ``spec.size_mm``, drawn from ``spec.seed``.

    Raises TargetError without the number of squares.
    """
    if spec.cells is None:
        raise TargetError(
            '[target] kind = "noise" needs cells, the number of squares along a side'
        )
    return CellTarget(
        noise_cells(spec.cells, spec.seed),
        (spec.size_mm, spec.size_mm),
        SURROUNDS[spec.surround],
    )
