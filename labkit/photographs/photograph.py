"""A decoded photograph: counts, black and white levels, and the places of its colours. Nothing is demosaiced.

A picture demosaiced by another program has all colours at every pixel. Side by side, as in the file, the colours are a
mosaic with a cell of one row and three columns for each pixel.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from labkit.findings.findings import Finding
from labkit.photographs.metadata import refuse_impossible
from labkit.photographs.tone_curve import ToneCurve
from labkit.plan.sensor import IN_COLOURS, MONO, ChannelPixels, channel_pixels, places_of
from labkit.types import Bools, Counts, Floats

Cut = tuple[slice, slice]
"""Rows and columns of a frame, in pixels."""

MOST_BLACK_LEVELS = 1024
"""Of a filter array's cell, 32 by 32 pixels."""

WHOLE: Cut = (slice(0, None), slice(0, None))

SATURATION_MARGIN = 0.01
"""Distance below the white level, relative to white less black, within which noise is clipped."""


def overlap(cut: Cut, box: Cut) -> Cut:
    """Return the part of a cut of a frame that is in a box of the frame."""
    rows, columns = (
        slice(
            start := max(part.start or 0, side.start),
            max(start, side.stop if part.stop is None else min(part.stop, side.stop)),
        )
        for part, side in zip(cut, box, strict=True)
    )
    return rows, columns


def spanned(cuts: Iterable[Cut]) -> Cut:
    """Return the smallest box that holds all cuts, with an open end where one of them has that."""
    rows, columns = (
        slice(
            min(part.start for part in parts),
            None
            if any(part.stop is None for part in parts)
            else max(part.stop for part in parts),
        )
        for parts in zip(*cuts, strict=True)
    )
    return rows, columns


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
    origin_px : (row, column) in the frame of the first pixel of `counts`, both even
    whole_px : (rows, columns) of the frame where `counts` are a cut of it; None for a whole frame
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
    origin_px: tuple[int, int] = (0, 0)
    whole_px: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        refuse_impossible((self.camera, *self.pattern), (self.exposure_s, self.iso))
        wide = {len(row) for row in self.pattern}
        if len(wide) != 1 or not all(row.isalpha() for row in self.pattern):
            raise ValueError(
                f"a filter array {self.pattern}: rows of letters of one length"
            )
        if self.counts.ndim != 2 or self.counts.dtype != np.uint16:
            raise ValueError(
                f"{self.counts.dtype} counts of shape {self.counts.shape}: rows and columns of 16 bit"
            )
        if self.black.ndim != 2 or not 1 <= self.black.size <= MOST_BLACK_LEVELS:
            raise ValueError(f"black levels of shape {self.black.shape}")
        if not (np.isfinite(self.black).all() and np.isfinite(self.white)):
            raise ValueError("black or white levels that are no numbers")
        ends = zip(self.origin_px, self.shape, self.frame_px, strict=True)
        if not all(0 <= first <= first + size <= frame for first, size, frame in ends):
            raise ValueError(
                f"a cut of {self.shape} pixels at {self.origin_px} in a frame of {self.frame_px}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of pixels of `counts`."""
        rows, cols = self.counts.shape
        return rows, cols // len(IN_COLOURS[0]) if self.pattern == IN_COLOURS else cols

    @property
    def frame_px(self) -> tuple[int, int]:
        """(rows, columns) of pixels of the whole frame."""
        return self.whole_px or self.shape

    @property
    def frame_box(self) -> Cut:
        """Rows and columns of the whole frame."""
        rows, columns = self.frame_px
        return slice(0, rows), slice(0, columns)

    @property
    def box(self) -> Cut:
        """Rows and columns of the frame that `counts` show."""
        (row, column), (rows, columns) = self.origin_px, self.shape
        return slice(row, row + rows), slice(column, column + columns)

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
        light = self.counts.astype(np.float64)
        for plane, black in self._blacks():
            light[plane] -= black
        return light

    @property
    def full_light(self) -> float:
        """Mean counts above black at saturation."""
        return self.white - float(np.mean(self.black))

    @property
    def saturated(self) -> Bools:
        """(rows, cols) True where a count is at the white level, or so near that its noise is clipped."""
        saturated = np.empty(self.counts.shape, dtype=np.bool_)
        for plane, black in self._blacks():
            limit = self.white - SATURATION_MARGIN * (self.white - black)
            saturated[plane] = self.counts[plane] >= limit
        return saturated

    def _blacks(self) -> Iterator[tuple[Cut, float]]:
        """Yield slices of counts and the black level of each place of the cell: no map of a whole frame is made."""
        high, wide = self.black.shape
        for row, column in np.ndindex(high, wide):
            plane = slice(row, None, high), slice(column, None, wide)
            yield plane, float(self.black[row, column])

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

    def where(self, name: str, cut: Cut, box: Cut) -> Cut:
        """Return slices as `slices` does, for a colour: its own plane of a picture in colours."""
        rows, columns = self.slices(cut, box)
        if self.pattern != IN_COLOURS:
            return rows, columns
        ((_, column),) = places_of(self.pattern, name)
        return rows, slice(columns.start + column, columns.stop, len(IN_COLOURS[0]))

    def cropped(self, cut: Cut) -> Photograph:
        """Return a copy of a cut of the frame, from an even row and column on."""
        rows, columns = inside = overlap(cut, self.box)
        return replace(
            self,
            counts=self.counts[self.slices(inside, self.box)].copy(),
            origin_px=(rows.start, columns.start),
            whole_px=self.frame_px,
        )

    def array_shape(self, box: Cut) -> tuple[int, int]:
        """Return the shape of an array that shows a box of the frame as `counts` do."""
        rows, columns = self.slices(box, box)
        return rows.stop, columns.stop

    def slices(self, cut: Cut, box: Cut) -> Cut:
        """Return slices of an array that shows a box of the frame as `counts` do, for the pixels of a cut in the box."""
        rows, columns = (
            slice(part.start - side.start, part.stop - side.start)
            for part, side in zip(cut, box, strict=True)
        )
        wide = len(IN_COLOURS[0]) if self.pattern == IN_COLOURS else 1
        return rows, slice(wide * columns.start, wide * columns.stop)

    def part(self, name: str, cut: Cut = WHOLE) -> Photograph:
        """Return a cut of the frame from an even row and column on; of a picture in colours one colour only, as mono.

        Raises RawError for a colour that the filter array lacks.
        """
        rows, columns = inside = overlap(cut, self.box)
        this = replace(
            self,
            counts=self.counts[self.where(name, inside, self.box)],
            origin_px=(rows.start, columns.start),
            whole_px=self.frame_px,
        )
        if self.pattern != IN_COLOURS:
            return this
        ((_, plane),) = places_of(self.pattern, name)
        black = np.full((2, 2), self.black[0, plane])
        tone = self.tone.of(plane) if self.tone else None
        return replace(this, black=black, pattern=MONO, tone=tone)
