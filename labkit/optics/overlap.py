"""The overlap of a pupil with its displaced copy: the transfer function of a perfect lens behind any outline."""

from __future__ import annotations

import numpy as np

from labkit.optics.psf import diffraction_mtf
from labkit.optics.rim import Rim
from labkit.types import Complexes, Floats

OVERLAP_ARCS = 256
"""Of an outline; its overlaps are right to 2e-5 of the clear area."""


def overlaps(rim: Rim, displacements: Floats, angles: Floats) -> Floats:
    """Return the share of the clear area that a displaced copy of the pupil has in common with it, (angles, displacements).

    Chords along a displacement shorten by it. That is exact for outlines that every line crosses twice, and as long as the
    copy's rim does not reach the obstruction.

    Parameters
    ----------
    rim : of the pupil
    displacements : (n,) over the full pupil's radius
    angles : (k,) of their directions
    """
    outline = rim.edges(OVERLAP_ARCS)[0] @ (1, 1j)
    inner = np.pi * rim.inner**2
    whole = np.pi * rim.area + inner
    common = np.empty((len(angles), len(displacements)))
    for row, angle in zip(common, angles, strict=True):
        chords, heights = _chords(outline * np.exp(-1j * angle))
        order = np.argsort(chords)
        chords, heights = chords[order], heights[order]
        first = np.searchsorted(chords, displacements)
        longer, high = (
            np.append(np.cumsum(each[::-1])[::-1], 0.0)[first]
            for each in (chords * heights, heights)
        )
        row[:] = (longer - high * displacements) * (whole / np.sum(chords * heights))
    if inner:
        common -= inner * (2 - diffraction_mtf(displacements / (2 * rim.inner)))
    return common / (np.pi * rim.area)


def _chords(outline: Complexes) -> tuple[Floats, Floats]:
    """Return lengths of an outline's chords along x, one between each two of its points' heights, and their distances.

    outline: points x + iy around it
    """
    outline = np.roll(outline, -int(np.argmin(outline.imag)))
    top = int(np.argmax(outline.imag))
    sides = outline[: top + 1], np.append(outline[top:], outline[0])[::-1]
    heights = np.sort(outline.imag)
    middles = 0.5 * (heights[1:] + heights[:-1])
    left, right = (
        np.interp(middles, np.maximum.accumulate(side.imag), side.real) for side in sides
    )
    return np.abs(left - right), np.diff(heights)
