"""The pixels of each colour: the cell of a colour filter array, repeated over the sensor.

A pattern lists the colours in the rows of a cell: ``("RG", "GB")`` for a Bayer array.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

from labkit.errors import RawError

if TYPE_CHECKING:
    from labkit.types import Bools

MONO = ("M",)
"""Pattern of a sensor without filters."""

IN_COLOURS = ("RGB",)
"""Pattern of a picture with every colour at every pixel, one colour beside the other as in its file."""

Pattern = tuple[str, ...]
Place = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ChannelPixels:
    """The pixels of one channel: (row, column) of each plane in a cell that repeats every `period` pixels."""

    places: tuple[Place, ...]
    period: int

    @property
    def spacing_px(self) -> float:
        """Side of the square that each pixel of the channel has for itself."""
        return self.period / sqrt(len(self.places))

    def mask(self, shape: tuple[int, ...]) -> Bools:
        """Return an array of `shape` (..., rows, columns), True for the channel's pixels."""
        import numpy as np  # a plan is checked without it

        mask = np.zeros(shape, dtype=np.bool_)
        for row, column in self.places:
            mask[..., row :: self.period, column :: self.period] = True
        return mask


def pattern_of(cfa: str) -> Pattern:
    """Return the pattern of a filter array as a plan writes it: "RGGB", "mono" or "RGB"."""
    return {"mono": MONO, "RGB": IN_COLOURS}.get(cfa, (cfa[:2], cfa[2:]))


def places_of(pattern: Pattern, name: str) -> tuple[Place, ...]:
    """Return (row, column) of each pixel of a colour in the cell.

    A mono sensor has a single pixel in the cell, whatever the name. Raises RawError for a
    colour that the filter array lacks.
    """
    if pattern == MONO:
        return ((0, 0),)
    places = tuple(
        (row, column)
        for row, colours in enumerate(pattern)
        for column, colour in enumerate(colours)
        if colour == name
    )
    if not places:
        raise RawError(f"no channel {name} in this filter array: {''.join(pattern)}")
    return places


def channel_pixels(pattern: Pattern, name: str) -> ChannelPixels:
    """Return the pixels of a colour: all of them on a mono sensor or in a picture in colours.

    Raises RawError for a colour that the filter array lacks.
    """
    if pattern in (MONO, IN_COLOURS):
        return ChannelPixels(((0, 0),), 1)
    return ChannelPixels(places_of(pattern, name), len(pattern))
