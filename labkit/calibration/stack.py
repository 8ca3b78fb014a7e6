"""Read photographs of one kind into one stack, and measure their scatter from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.calibration.photon_transfer import Scatter, scatter_of
from labkit.errors import DataError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Sensor
from labkit.session.frame import Frame
from labkit.types import Bools, Counts, Floats, Floats32

NOISE_PIXELS = 400_000
"""Pixels of a channel that photon transfer looks at: enough for 0.2 % from two flats."""


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Frames of one kind, or a box of them.

    counts: (frames, rows, cols); first: the first frame, for the properties they share;
    saturated: (rows, cols) pixels saturated in any frame.
    """

    counts: Counts
    first: Photograph
    saturated: Bools

    def scatter(
        self, where: Bools, offset: Floats32 | Floats, *, lit: bool
    ) -> Iterator[Scatter]:
        """Yield the scatter from frame to frame of a sample of the pixels `where`; nothing for a single frame."""
        chosen = np.flatnonzero(where)
        if len(self.counts) > 1 and chosen.size:
            chosen = chosen[:: -(-chosen.size // NOISE_PIXELS)]
            counts = self.counts.reshape(len(self.counts), -1)[:, chosen]
            found = scatter_of(counts - offset.ravel()[chosen].astype(np.float64), lit=lit)
            if (tone := self.first.tone) is None:
                yield found
            else:  # what rounding adds is known, pixel by pixel, and is no photon's
                rounding = tone.of(int(chosen[0]) % 3).rounding_variance(
                    counts.mean(axis=0)
                )
                yield replace(found, variance=found.variance - rounding)


class Stacks:
    """Reads one stack after another, all of one sensor.

    frame_px: (rows, columns) of every frame read so far, None before the first.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._first = ""
        self._pattern: tuple[str, ...] = ()
        self.frame_px: tuple[int, int] | None = None

    def read(self, frames: Sequence[Frame], cut: Cut = WHOLE) -> Stack:
        """Read a cut of frames, each decoded once.

        Raises RawError for a file that cannot be read, DataError for frames of different
        sensors.
        """
        first = self._photograph(frames[0], cut)
        counts = np.empty((len(frames), *first.counts.shape), dtype=np.uint16)
        counts[0] = first.counts
        saturated = first.saturated
        for place, frame in enumerate(frames[1:], start=1):
            photograph = self._photograph(frame, cut)
            counts[place] = photograph.counts
            saturated |= photograph.saturated
        return Stack(counts, replace(first, counts=counts[0]), saturated)

    def _photograph(self, frame: Frame, cut: Cut) -> Photograph:
        photograph = read_photograph(frame.path, self._sensor, cut)
        if self.frame_px is None:
            self._first = frame.file
            self._pattern = photograph.pattern
            self.frame_px = photograph.frame_px
        if (photograph.frame_px, photograph.pattern) != (self.frame_px, self._pattern):
            size = "×".join(map(str, photograph.frame_px))
            raise DataError(
                f"{frame.file} is of another sensor than {self._first}: {size} pixels, {photograph.cfa}"
            )
        return photograph
