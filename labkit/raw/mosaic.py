"""A photograph as a mosaic: raw numbers, black and white levels, and where the colours lie. Nothing is demosaiced."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.errors import RawError
from labkit.types import Counts

MONO = ("M",)


@dataclass(frozen=True, slots=True, eq=False)
class Mosaic:
    """One photograph as the sensor saw it, in the sensor's orientation whatever the camera's.

    counts: (rows, cols) numbers as in the file; black: (2, 2) level of each place of the 2x2 cell, for mono too;
    white: the count that means saturated; pattern: the colours of the cell's rows, ("RG", "GB"), or ("M",) for mono.
    """

    counts: Counts
    black: NDArray[np.float64]
    white: float
    pattern: tuple[str, ...]
    camera: str = ""
    exposure_s: float | None = None
    iso: int | None = None

    @property
    def cfa(self) -> str:
        """The pattern as a plan writes it: "RGGB" or "mono"."""
        return "mono" if self.pattern == MONO else "".join(self.pattern)

    def black_map(self) -> NDArray[np.float64]:
        """(rows, cols) black level of each pixel."""
        rows, cols = self.counts.shape
        return np.tile(self.black, (-(-rows // 2), -(-cols // 2)))[:rows, :cols]

    def channel_mask(self, name: str) -> NDArray[np.bool_]:
        """(rows, cols) True where the filter is of that colour; everywhere on a mono sensor.

        Raises RawError for a colour that the filter array lacks.
        """
        mask = np.zeros(self.counts.shape, dtype=np.bool_)
        for row, col in self.places(name):
            mask[row::2, col::2] = True
        return mask

    def places(self, name: str) -> tuple[tuple[int, int], ...]:
        """(row, col) of a colour in the 2x2 cell: two for G of a Bayer cell, all four on a mono sensor."""
        cell = tuple((row, col) for row in range(2) for col in range(2))
        if self.pattern == MONO:
            return cell
        places = tuple((row, col) for row, col in cell if self.pattern[row][col] == name)
        if not places:
            raise RawError(f"no channel {name} in this filter array: {self.cfa}")
        return places
