"""Boxes in photographs of a scene, as regions and planes to be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labkit.edges.esfr import Plane
from labkit.edges.found_edges import DEEP, Box, FoundEdge, find_edges
from labkit.edges.region import LEAST_REGION_PIXELS, Region
from labkit.errors import DataError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.plan.sensor import ChannelPixels
from labkit.types import Bools, Counts, Floats

LEAST_BOX_SIDE_PX = 12  # of a box
LEAST_PILE = 0.02  # of the bright pixels, at one count
MOST_TOP = 3.0  # of the next counts' pixels, which noise alone leaves at the highest
NEXT_BELOW = 3  # counts
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


class BoxPixels(NamedTuple):
    """Pixels (rows, columns) of a box.

    Attributes
    ----------
    light, rounding : counts above black, and counts² of rounding
    usable : whether usable for a channel
    counts : (n,) of all of the channel's, black included
    """

    light: Floats
    usable: Bools
    rounding: Floats
    counts: Counts

    @property
    def pile(self) -> Pile | None:
        """Highest count where clipping piled many up; None otherwise."""
        return find_pile(self.counts)


@dataclass(frozen=True, eq=False)
class ChannelFrame:
    """One channel of a photograph, whose numbers are made box by box: of a whole frame they would take many times its size.

    Attributes
    ----------
    part : the photograph, of a picture in colours this colour alone
    pixels : the channel's
    """

    name: str
    part: Photograph
    pixels: ChannelPixels

    @classmethod
    def of(cls, photograph: Photograph, name: str) -> ChannelFrame:
        """Return a channel of a photograph."""
        return cls(name, photograph.part(name), photograph.pixels(name))

    def first_plane(self) -> Floats:
        """Return counts above black (rows, columns) of the channel's first plane."""
        (row, column), step = self.pixels.places[0], self.pixels.period
        cell = ((first + step * np.arange(2)) % 2 for first in (row, column))
        black = self.part.black[np.ix_(*cell)]
        counts = self.part.counts[row::step, column::step]
        return replace(self.part, counts=counts, black=black).light

    def found_at(self, edge: FoundEdge) -> Place:
        """Return the place of an edge found in the first plane, in samples."""
        found = edge.on(self.pixels.places[0], self.pixels.period)
        (rows, columns), (r0, c0, r1, c1) = self.part.shape, found.box
        # the last sample of a plane need not have a whole cell
        return Place((r0, c0, min(r1, rows), min(c1, columns)), found)

    def find_places(self, most: int) -> list[Place]:
        """Find edges in the channel's first plane, `most` at most."""
        return [self.found_at(edge) for edge in find_edges(self.first_plane(), most)]

    def read(self, place: Place) -> BoxPixels:
        """Return the pixels of a place's box."""
        cell = max(2, self.pixels.period)
        starts = [side.start // cell * cell for side in place.slices]
        whole = tuple(map(slice, starts, place.box[2:]))
        around = replace(self.part, counts=self.part.counts[whole])
        own = around.channel_mask(self.name)
        usable = own & ~around.saturated
        (r0, c0), (top, left) = place.box[:2], starts
        inside = np.s_[r0 - top :, c0 - left :]
        return BoxPixels(
            around.light[inside],
            usable[inside],
            around.rounding_variance[inside],
            around.counts[inside][own[inside]],
        )

    def region(self, place: Place, frame: int) -> Region:
        """Return the usable pixels in a box, or around the found edge. Raises DataError for a wrong box, and for too few."""
        if place.found is None:
            _refuse_box(place.box, self.part.shape)
        pixels = self.read(place)
        if (pile := pixels.pile) is not None:
            raise DataError(
                f"its bright side is clipped: {pile.share:.0%} of it is at one count, {pile.level}; expose less"
            )
        light, used = pixels.light, pixels.usable
        y, x = np.mgrid[place.slices].astype(float)
        r0, c0, r1, c1 = place.box
        centre = ((r0 + r1 - 1) / 2, (c0 + c1 - 1) / 2)
        if place.found is not None:
            used = used & place.found.mask(y, x, DEPTH_PX * self.pixels.period)
            centre = place.found.middle
        if used.sum() < LEAST_REGION_PIXELS:
            raise DataError(
                f"{used.sum()} usable pixels of channel {self.name} are in it, {LEAST_REGION_PIXELS} are needed"
            )
        return Region(y[used], x[used], light[used], centre, frame)

    def planes(self, place: Place) -> tuple[Plane, ...]:
        """Return a box's samples by plane, all of equal size, in lines along an edge found; none if a sample is
        clipped.
        """
        pixels = self.read(place)
        if pixels.pile is not None:
            return ()
        light, usable = pixels.light, pixels.usable
        step = self.pixels.period
        r0, c0, *_ = place.box
        light = np.where(usable, light, np.nan)
        index = np.arange(light.size).reshape(light.shape)
        planes = []
        for row, column in self.pixels.places:
            down, right = (row - r0) % step, (column - c0) % step
            cut = np.s_[down::step, right::step]
            plane = Plane(light[cut], (r0 + down, c0 + right), step, index=index[cut])
            planes.append(plane if place.found is None else lines_along(plane, place.found))
        if any(np.isnan(plane.values).any() for plane in planes):
            return ()
        rows, columns = np.min([plane.values.shape for plane in planes], axis=0)
        return tuple(
            replace(
                plane,
                values=plane.values[:rows, :columns],
                shifts=plane.shifts[:rows],
                index=plane.index[:rows, :columns],
            )
            for plane in planes
        )


def lines_along(plane: Plane, found: FoundEdge) -> Plane:
    """Return the lines of a plane that cross a found edge, each as far as the edge's sides are known to be even.

    A rectangle about a slanted edge would hold the corners where its sides end.
    """
    row, column = found.middle
    angle = found.angle
    if abs(np.sin(angle)) > abs(np.cos(angle)):
        plane = plane.turned
        row, column = -column, row
        angle = float(np.arctan2(-np.cos(angle), np.sin(angle)))
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    width = plane.values.shape[1]
    off = plane.rows - row
    middle = np.rint((column - off * np.tan(angle) - plane.first[1]) / plane.step)
    border = np.minimum(middle, width - 1 - middle)
    half = min(int(DEEP / cosine), int(border[np.argmin(np.abs(off))]))
    inside = np.abs(off) / cosine + half * plane.step * sine <= found.length_px / 2
    inside &= border >= half
    kept = slice(np.argmax(inside), inside.size - np.argmax(inside[::-1]))
    begins = middle[kept].astype(int).clip(half, width - 1 - half) - half
    at = begins[:, None] + np.arange(2 * half + 1)
    values = np.take_along_axis(plane.values[kept], at, axis=1)
    index = plane.index
    if index.size:
        index = np.take_along_axis(index[kept], at, axis=1)
    first = (float(plane.rows[kept][0]), plane.first[1])
    return Plane(values, first, plane.step, np.asarray(begins, np.float64), index)


class Pile(NamedTuple):
    """Counts that are all one: the count, and its share of an edge's bright pixels."""

    level: int
    share: float


def find_pile(counts: Counts) -> Pile | None:
    """Return the highest count of an edge where clipping piled it up, None otherwise.

    Noise would spread it: fewer pixels have the highest count than the next below, or the dark side has none either.
    """
    if not counts.size:
        return None
    values, many = np.unique(counts, return_counts=True)
    lowest = float(values[0])
    highest = float(values[-1])
    middle = (lowest + highest) / 2
    bright = many[values > middle]
    if not bright.size:
        return None
    share = float(bright[-1] / bright.sum())
    dark = counts[counts <= middle].astype(float)
    low, high = np.percentile(dark, (25, 75))
    if share < LEAST_PILE or high == low:
        return None
    below = bright[-1 - NEXT_BELOW : -1]
    most = MOST_TOP * below.max(initial=0)
    return Pile(int(highest), share) if bright[-1] > most else None


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
