"""The lit part of a panel's stripes: no part of the camera's blur but of what is drawn, estimated beside its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from labkit.panel_target import USUAL_APERTURE
from labkit.types import AnyFloats

LEAST = 0.02
"""An aperture that a step would make smaller than this is drawn as this: it has to be above 0."""


@dataclass(frozen=True, slots=True)
class Aperture:
    """By how much more of its width and of its length a stripe is lit than usual, shares: `labkit.panel_target`.

    It leaves the transfer function alone: `labkit.imaging.scene` draws by it.
    """

    across: float = 0.0
    down: float = 0.0

    name: ClassVar[str] = "panel_pixels"
    labels: ClassVar[tuple[str, ...]] = ("across", "down")
    usual: ClassVar[tuple[float, ...]] = (0.15, 0.15)

    @property
    def values(self) -> tuple[float, ...]:
        return self.across, self.down

    @property
    def lit(self) -> tuple[float, float]:
        """Across and down: shares of a third of a pixel, and of a pixel."""
        return max(USUAL_APERTURE + self.across, LEAST), max(USUAL_APERTURE + self.down, LEAST)

    def at(self, values: Sequence[float]) -> Self:
        across, down = values
        return replace(self, across=float(across), down=float(down))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return np.ones(np.broadcast_shapes(rows.shape, columns.shape))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        none = np.zeros(np.broadcast_shapes(rows.shape, columns.shape))
        return none, none
