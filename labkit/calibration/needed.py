"""The part of the frame that photographs of a target need of darks and flats, and where the target is in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from sys import maxsize

import numpy as np

from labkit.finder.cut import cut_around, outline
from labkit.photographs.photograph import WHOLE, Cut, Photograph, spanned
from labkit.types import Bools, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Needed:
    """A part of the frame.

    Attributes
    ----------
    cut : rows and columns, which may end beyond the frame
    outlines : corners (4, 2) of the targets in it, [row, column] in the frame; without any the whole part counts
    """

    cut: Cut = WHOLE
    outlines: tuple[Floats, ...] = ()

    @classmethod
    def by_targets(cls, outlines: Iterable[Floats]) -> Needed:
        """Return what photographs of some targets need, each with the surround that a fit looks at."""
        corners = tuple(outlines)
        return cls(cut_around(corners, (maxsize, maxsize)), corners)

    @classmethod
    def by_all(cls, parts: Iterable[Needed]) -> Needed:
        """Return what all parts need."""
        every = tuple(parts)
        outlines = tuple(corners for part in every for corners in part.outlines)
        return cls(spanned(part.cut for part in every), outlines)

    def target_mask(self, photograph: Photograph) -> Bools:
        """Return the mask of the counts that see a target; of all of them without targets."""
        mask = np.full(photograph.shape, not self.outlines)
        for corners in self.outlines:
            mask |= outline(corners - photograph.origin_px, photograph.shape) > 0
        return np.repeat(mask, photograph.counts.shape[1] // photograph.shape[1], axis=1)


EVERYTHING = Needed()
"""The whole frame."""
