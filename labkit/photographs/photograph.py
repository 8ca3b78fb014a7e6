"""A decoded photograph: counts, black and white levels, and the places of its colours. Nothing is demosaiced.

A picture demosaiced by another program has all colours at every pixel. Side by side, as in the file, the colours are a
mosaic with a cell of one row and three columns for each pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.findings import Finding
from labkit.photographs.tone_curve import ToneCurve
from labkit.plan.sensor import IN_COLOURS, MONO, ChannelPixels, channel_pixels, places_of
from labkit.types import Bools, Counts, Floats

Cut = tuple[slice, slice]
"""Rows and columns of a frame, in pixels."""

WHOLE: Cut = (slice(0, None), slice(0, None))

SATURATION_MARGIN = 0.01
"""Distance below the white level, relative to white less black, within which noise is clipped."""


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """A photograph as the sensor recorded it, in the sensor's orientation.

    Attributes
    ----------
    counts : (rows, cols) numbers as in the file; (rows, 3 cols) of a picture in colours
    black : black level of each place of the cell: (2, 2), for mono too; (1, 3) in colours
    white : count of saturation
    pattern : colours of the cell's rows: ("RG", "GB"); ("M",) for mono; ("RGB",) for a picture in colours
    camera, exposure_s, iso : as the file states them
    tone : tone curve that was undone in `counts`; None for counts as in the file
    notes : findings about the origin of the counts
    compressed : whether the file is a JPEG
    """

    counts: Counts
    black: Floats
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

    @property
    def black_map(self) -> Floats:
        """(rows, cols) black level of each pixel, counts."""
        (rows, cols), (high, wide) = self.counts.shape, self.black.shape
        return np.tile(self.black, (-(-rows // high), -(-cols // wide)))[:rows, :cols]

    @property
    def light(self) -> Floats:
        """(rows, cols) counts above black."""
        return self.counts - self.black_map

    @property
    def full_light(self) -> float:
        """Mean counts above black at saturation."""
        return self.white - float(np.mean(self.black))

    @property
    def saturated(self) -> Bools:
        """(rows, cols) True where a count is at the white level, or so near that its noise is clipped."""
        range_ = self.white - self.black_map
        return np.asarray(self.counts >= self.white - SATURATION_MARGIN * range_)

    @property
    def rounding_variance(self) -> Floats:
        """(rows, cols) variance of rounding through the tone curve, counts²; for photographs of one colour."""
        if self.tone is None:
            return np.zeros(self.counts.shape)
        return self.tone.rounding_variance(self.counts)

    @property
    def every_plane(self) -> tuple[Cut, ...]:
        """Slices of counts, one for each place of the filter array's cell."""
        high = len(self.pattern)
        wide = len(self.pattern[0])
        places = ((row, col) for row in range(high) for col in range(wide))
        return tuple(self._plane(*place) for place in places)

    def planes(self, name: str) -> tuple[Cut, ...]:
        """Return slices of counts for each plane of a colour. Raises RawError for a colour outside the filter array."""
        return tuple(self._plane(*place) for place in places_of(self.pattern, name))

    def _plane(self, row: int, col: int) -> Cut:
        high = len(self.pattern)
        wide = len(self.pattern[0])
        return slice(row, None, high), slice(col, None, wide)

    def channel_mask(self, name: str) -> Bools:
        """Return the mask of a colour's pixels, of the shape of `counts`. Raises RawError for an unknown colour."""
        mask = np.zeros(self.counts.shape, dtype=np.bool_)
        for plane in self.planes(name):
            mask[plane] = True
        return mask

    def black_of(self, plane: Cut) -> float:
        """Return the black level of one of the `planes`, counts."""
        rows, columns = plane
        return float(self.black[rows.start, columns.start])

    def has(self, name: str) -> bool:
        """Return whether the filter array has a colour."""
        any_colour = self.pattern in (MONO, IN_COLOURS)
        return any_colour or any(name in row for row in self.pattern)

    def pixels(self, name: str) -> ChannelPixels:
        """Return the pixels of a channel; RawError for a colour that the filter array lacks."""
        return channel_pixels(self.pattern, name)

    def where(self, name: str, cut: Cut) -> Cut:
        """Return slices of counts for a colour in a cut of pixels: its plane of a picture in colours, else the cut."""
        if self.pattern != IN_COLOURS:
            return cut
        rows, cols = cut
        ((_, col),), wide = places_of(self.pattern, name), len(IN_COLOURS[0])
        stop = None if cols.stop is None else wide * cols.stop
        return rows, slice(wide * (cols.start or 0) + col, stop, wide)

    def part(self, name: str, cut: Cut = WHOLE) -> Photograph:
        """Return a cut of pixels from an even row and column on; for a picture in colours the requested colour only, as mono.

        Raises RawError for a colour that the filter array lacks.
        """
        counts = self.counts[self.where(name, cut)]
        if self.pattern != IN_COLOURS:
            return replace(self, counts=counts)
        ((_, plane),) = places_of(self.pattern, name)
        black = np.full((2, 2), self.black[0, plane])
        tone = self.tone.of(plane) if self.tone else None
        return replace(self, counts=counts, black=black, pattern=MONO, tone=tone)
