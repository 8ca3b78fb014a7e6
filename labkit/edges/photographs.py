"""Photographs of a scene and boxes in them, as regions and planes to be fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.calibration.stack import saturated
from labkit.edges.esfr import Plane
from labkit.edges.find import Box, FoundEdge, find_edges
from labkit.edges.region import LEAST_PIXELS, Region
from labkit.errors import DataError
from labkit.photographs.decoding import read_raw
from labkit.photographs.photograph import Mosaic
from labkit.plan import Plan
from labkit.plan.sensor import IN_COLOURS, MONO
from labkit.types import Bools, Floats

WHOLE = (slice(0, None), slice(0, None))
LEAST_SIDE_PX = 12  # of a box
DEPTH_PX = 16.0  # of a found edge's sides, in samples of its channel


@dataclass(frozen=True)
class Place:
    """A box to be fitted, and the found edge in it, where it was found."""

    box: Box
    found: FoundEdge | None = None

    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        r0, c0, r1, c1 = self.box
        return slice(r0, r1), slice(c0, c1)


@dataclass(frozen=True, eq=False)
class Photograph:
    """One decoded photograph. path: of its file."""

    path: Path
    mosaic: Mosaic

    @classmethod
    def read(cls, path: Path, plan: Plan) -> Photograph:
        """Raises RawError."""
        return cls(path, read_raw(path, plan.sensor))

    @property
    def white(self) -> float:
        """Counts above black at saturation."""
        return self.mosaic.white - float(np.mean(self.mosaic.black))

    def counts(self, channel: str) -> tuple[Floats, Bools]:
        """(rows, columns) with black removed, and which pixels are of a channel and not saturated."""
        part = self.mosaic.part(channel, WHOLE)
        return part.counts - part.black_map(), part.channel_mask(channel) & ~saturated(part)

    def rounding_variance(self, channel: str, place: Place) -> float:
        """Mean counts squared that a tone curve's steps add to the noise in a box."""
        part = self.mosaic.part(channel, WHOLE)
        if part.tone is None:
            return 0.0
        return float(np.mean(part.tone.rounding_variance(part.counts[place.slices()])))

    def has(self, channel: str) -> bool:
        """Whether the filter array has a colour."""
        return self.mosaic.pattern in (MONO, IN_COLOURS) or any(
            channel in row for row in self.mosaic.pattern
        )


def read_all(paths: Sequence[Path], plan: Plan) -> list[Photograph]:
    """Frames of one scene. Raises RawError, and DataError where they differ in size or filter array."""
    photographs = [Photograph.read(path, plan) for path in paths]
    first = photographs[0].mosaic
    for each in photographs[1:]:
        if each.mosaic.shape != first.shape or each.mosaic.pattern != first.pattern:
            raise DataError(
                f"{each.path}: of another size or filter array than {photographs[0].path}: give frames of one scene"
            )
    return photographs


def checked_box(box: Box, shape: tuple[int, int]) -> str | None:
    """What is wrong with a box for a picture (rows, columns), in one line; None where it can be used."""
    r0, c0, r1, c1 = box
    rows, columns = shape
    if r1 - r0 < LEAST_SIDE_PX or c1 - c0 < LEAST_SIDE_PX:
        spans = f"{r1 - r0} rows and {c1 - c0} columns"
        return f"the box spans {spans}: R0,C0,R1,C1 with {LEAST_SIDE_PX} of each at least is needed"
    if r0 < 0 or c0 < 0 or r1 > rows or c1 > columns:
        return (
            f"the box lies outside the image, which has {rows} rows and {columns} columns"
        )
    return None


def find_places(photograph: Photograph, channel: str, most: int) -> list[Place]:
    """Edges found in one plane of a channel."""
    counts, _ = photograph.counts(channel)
    pixels = photograph.mosaic.pixels(channel)
    row, column = pixels.places[0]
    step = pixels.period
    found = find_edges(counts[row::step, column::step], (row, column), step, most)
    return [Place(each.box, each) for each in found]


def region_of(photograph: Photograph, channel: str, place: Place, frame: int) -> Region:
    """The channel's usable pixels in a box, or around the found edge. Raises DataError for too few."""
    counts, good = photograph.counts(channel)
    rows, columns = (np.arange(s.start, s.stop, dtype=float) for s in place.slices())
    y, x = np.meshgrid(rows, columns, indexing="ij")
    used = good[place.slices()]
    r0, c0, r1, c1 = place.box
    centre = ((r0 + r1 - 1) / 2, (c0 + c1 - 1) / 2)
    if place.found is not None:
        used = used & place.found.mask(
            y, x, DEPTH_PX * photograph.mosaic.pixels(channel).period
        )
        centre = place.found.middle
    if used.sum() < LEAST_PIXELS:
        raise DataError(
            f"{used.sum()} usable pixels of channel {channel} are in it, {LEAST_PIXELS} are needed"
        )
    return Region(y[used], x[used], counts[place.slices()][used], centre, frame)


def samples_by_plane(photograph: Photograph, channel: str, place: Place) -> list[Plane]:
    """The box's samples by plane. Raises DataError where some are saturated: nothing stands for them."""
    counts, good = photograph.counts(channel)
    pixels = photograph.mosaic.pixels(channel)
    step = pixels.period
    r0, c0, r1, c1 = place.box
    planes = []
    for row, column in pixels.places:
        first_row, first_column = r0 + (row - r0) % step, c0 + (column - c0) % step
        cut = slice(first_row, r1, step), slice(first_column, c1, step)
        if not good[cut].all():
            raise DataError("clipped pixels are in the box")
        planes.append(Plane(counts[cut], (first_row, first_column), step))
    rows, columns = (min(plane.values.shape[axis] for plane in planes) for axis in (0, 1))
    return [Plane(plane.values[:rows, :columns], plane.first, step) for plane in planes]
