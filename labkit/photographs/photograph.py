"""A photograph as a mosaic: raw numbers, black and white levels, and where the colours lie. Nothing is demosaiced.

A picture that was demosaiced by others has all its colours at every pixel: one beside the other, as in its file, they are a
mosaic too, whose cell is one row high and three columns wide and stands for one pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labkit.findings import Finding
from labkit.photographs.tone_curve import ToneCurve
from labkit.plan.sensor import IN_COLOURS, MONO, ChannelPixels, channel_pixels, places_of
from labkit.types import Counts

Cut = tuple[slice, slice]
"""Rows and columns of a frame, in pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Mosaic:
    """One photograph as the sensor saw it, in the sensor's orientation whatever the camera's.

    counts: (rows, cols) numbers as in the file, (rows, 3 cols) of a picture in colours; black: (2, 2) level of each place of
    the 2x2 cell, for mono too, (1, 3) in colours; white: the count that means saturated; pattern: the colours of the
    cell's rows, ("RG", "GB"), or ("M",) for mono, or ("RGB",) for a picture in colours. tone: what was undone in counts of a
    processed picture, None where they are as in the file; notes: what to know of how they came about; compressed: as JPEG.
    """

    counts: Counts
    black: NDArray[np.float64]
    white: float
    pattern: tuple[str, ...]
    camera: str = ""
    exposure_s: float | None = None
    iso: int | None = None
    tone: ToneCurve | None = None
    notes: tuple[Finding, ...] = ()
    compressed: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of pixels."""
        rows, cols = self.counts.shape
        return rows, cols // len(IN_COLOURS[0]) if self.pattern == IN_COLOURS else cols

    @property
    def cfa(self) -> str:
        """The pattern as a plan writes it: "RGGB", "mono" or "RGB"."""
        return "mono" if self.pattern == MONO else "".join(self.pattern)

    def black_map(self) -> NDArray[np.float64]:
        """(rows, cols) black level of each pixel."""
        (rows, cols), (high, wide) = self.counts.shape, self.black.shape
        return np.tile(self.black, (-(-rows // high), -(-cols // wide)))[:rows, :cols]

    def channel_mask(self, name: str) -> NDArray[np.bool_]:
        """Of counts' shape, True where the filter is of that colour; everywhere on a mono sensor.

        Raises RawError for a colour that the filter array lacks.
        """
        mask = np.zeros(self.counts.shape, dtype=np.bool_)
        for plane in self.planes(name):
            mask[plane] = True
        return mask

    @property
    def every_plane(self) -> tuple[Cut, ...]:
        """Slices of counts, one for each place of the filter array's cell; a single one on a mono sensor."""
        high, wide = len(self.pattern), len(self.pattern[0])
        return tuple(self._plane(row, col) for row in range(high) for col in range(wide))

    def planes(self, name: str) -> tuple[Cut, ...]:
        """Slices of counts, one for each plane of a colour: two for G of a Bayer cell, one for everything on a mono sensor."""
        return tuple(self._plane(row, col) for row, col in places_of(self.pattern, name))

    def _plane(self, row: int, col: int) -> Cut:
        high, wide = len(self.pattern), len(self.pattern[0])
        return slice(row, None, high), slice(col, None, wide)

    def black_of(self, plane: Cut) -> float:
        """Black level of one of the `planes`, counts."""
        rows, columns = plane
        return float(self.black[rows.start, columns.start])

    def pixels(self, name: str) -> ChannelPixels:
        """The pixels of a channel, in pixels of the photograph. Raises RawError for a colour that the filter array lacks."""
        return channel_pixels(self.pattern, name)

    def where(self, name: str, cut: Cut) -> Cut:
        """Slices of counts for a colour in a cut of pixels: of a picture in colours its plane, else all of the cut."""
        if self.pattern != IN_COLOURS:
            return cut
        (_, col), (rows, cols), wide = (
            places_of(self.pattern, name)[0],
            cut,
            len(IN_COLOURS[0]),
        )
        stop = None if cols.stop is None else wide * cols.stop
        return rows, slice(wide * (cols.start or 0) + col, stop, wide)

    def part(self, name: str, cut: Cut) -> Mosaic:
        """A cut of pixels, from an even row and column on; of a picture in colours only that colour, as mono.

        Raises RawError for a colour that the filter array lacks.
        """
        counts = self.counts[self.where(name, cut)]
        if self.pattern != IN_COLOURS:
            return replace(self, counts=counts)
        plane = places_of(self.pattern, name)[0][1]
        black, tone = (
            np.full((2, 2), self.black[0, plane]),
            self.tone.of(plane) if self.tone else None,
        )
        return replace(self, counts=counts, black=black, pattern=MONO, tone=tone)
