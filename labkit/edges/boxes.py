"""Boxes in photographs of a scene, as regions and planes to be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.edges.esfr import Plane
from labkit.edges.found_edges import Box, FoundEdge, find_edges
from labkit.edges.region import LEAST_REGION_PIXELS, Region
from labkit.errors import DataError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.plan.sensor import ChannelPixels
from labkit.types import Bools, Floats

LEAST_BOX_SIDE_PX = 12  # of a box
DEPTH_PX = 16.0  # of a found edge's sides, in samples of its channel


@dataclass(frozen=True)
class Place:
    """A box to be fitted, and the edge found in it, if it was searched for."""

    box: Box
    found: FoundEdge | None = None

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        r0, c0, r1, c1 = self.box
        return slice(r0, r1), slice(c0, c1)


@dataclass(frozen=True, eq=False)
class ChannelFrame:
    """One channel of a photograph: (rows, columns) counts above black, usable pixels, counts² of rounding, and its pixels."""

    name: str
    light: Floats
    usable: Bools
    rounding: Floats
    pixels: ChannelPixels

    @classmethod
    def of(cls, photograph: Photograph, name: str) -> ChannelFrame:
        """Return a channel of a photograph."""
        part = photograph.part(name)
        usable = part.channel_mask(name) & ~part.saturated
        pixels = photograph.pixels(name)
        return cls(name, part.light, usable, part.rounding_variance, pixels)

    def find_places(self, most: int) -> list[Place]:
        """Find edges in the channel's first plane, `most` at most."""
        row, column = self.pixels.places[0]
        step = self.pixels.period
        plane = self.light[row::step, column::step]
        found = find_edges(plane, (row, column), step, most)
        return [Place(each.box, each) for each in found]

    def region(self, place: Place, frame: int) -> Region:
        """Return the usable pixels in a box, or around the found edge. Raises DataError for a wrong box, and for too few."""
        if place.found is None:
            _refuse_box(place.box, self.light.shape)
        cut = place.slices
        y, x = np.mgrid[cut].astype(float)
        used = self.usable[cut]
        r0, c0, r1, c1 = place.box
        centre = ((r0 + r1 - 1) / 2, (c0 + c1 - 1) / 2)
        if place.found is not None:
            used = used & place.found.mask(y, x, DEPTH_PX * self.pixels.period)
            centre = place.found.middle
        if used.sum() < LEAST_REGION_PIXELS:
            raise DataError(
                f"{used.sum()} usable pixels of channel {self.name} are in it, {LEAST_REGION_PIXELS} are needed"
            )
        return Region(y[used], x[used], self.light[cut][used], centre, frame)

    def planes(self, place: Place) -> tuple[Plane, ...]:
        """Return a box's samples by plane, all of equal size; none if a sample is clipped."""
        step = self.pixels.period
        r0, c0, r1, c1 = place.box
        firsts = [
            (r0 + (row - r0) % step, c0 + (column - c0) % step)
            for row, column in self.pixels.places
        ]
        cuts = [np.s_[row:r1:step, column:c1:step] for row, column in firsts]
        if not all(self.usable[cut].all() for cut in cuts):
            return ()
        rows, columns = np.min([self.light[cut].shape for cut in cuts], axis=0)
        return tuple(
            Plane(self.light[cut][:rows, :columns], first, step)
            for cut, first in zip(cuts, firsts, strict=True)
        )


def read_frames(paths: Sequence[Path], plan: Plan) -> list[Photograph]:
    """Read frames of one scene. Raises RawError, and DataError where they differ in size or filter array."""
    photographs = [read_photograph(path, plan.sensor) for path in paths]
    first = photographs[0]
    for path, each in zip(paths, photographs, strict=True):
        if (each.shape, each.pattern) != (first.shape, first.pattern):
            raise DataError(
                f"{path}: of another size or filter array than {paths[0]}: give frames of one scene"
            )
    return photographs


def _refuse_box(box: Box, shape: tuple[int, ...]) -> None:
    """Raise DataError, one line, for a box too small or not in a picture of (rows, columns)."""
    r0, c0, r1, c1 = box
    rows, columns = shape
    if min(r1 - r0, c1 - c0) < LEAST_BOX_SIDE_PX:
        raise DataError(
            f"the box spans {r1 - r0} rows and {c1 - c0} columns: R0,C0,R1,C1 with {LEAST_BOX_SIDE_PX} of each at least is "
            "needed"
        )
    if min(r0, c0) < 0 or r1 > rows or c1 > columns:
        raise DataError(
            f"the box lies outside the image, which has {rows} rows and {columns} columns"
        )
