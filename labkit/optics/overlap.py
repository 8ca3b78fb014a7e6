"""The overlap of a pupil with its displaced copy: the transfer function of a perfect lens behind any outline."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
    whole = np.pi * (rim.area + rim.dark_area)
    common = np.empty((len(angles), len(displacements)))
    for row, angle in zip(common, angles, strict=True):
        turned = outline * np.exp(-1j * angle)
        heights = np.sort(turned.imag)
        chords = _chords(turned, 0.5 * (heights[1:] + heights[:-1]))
        strips = np.diff(heights)
        longer = _of_longer(chords, np.stack([chords * strips, strips]), displacements)
        row[:] = (longer[0] - longer[1] * displacements) * (whole / np.sum(chords * strips))
    return (common / np.pi - _hidden(rim, displacements)) / rim.area


def overlap_slopes(
    rim: Rim,
    nearby: Sequence[tuple[Rim, Rim, float]],
    displacements: Floats,
    angles: Floats,
    common: Floats,
) -> Floats:
    """Return derivatives of `overlaps` by numbers of the rim, (numbers, angles, displacements).

    A strip by which the outline moves outwards is in the copy too if the chord through it is longer than the displacement.

    Parameters
    ----------
    rim, displacements, angles : see `overlaps`
    nearby : for each number two neighbouring rims, and their distance in this number
    common : (angles, displacements) `overlaps` of the rim
    """
    theta, widths = rim.arcs(4 * OVERLAP_ARCS)
    outline = rim.outline(theta) * np.exp(1j * theta)

    def quotient(of: Callable[[Rim], Floats]) -> Floats:
        return np.array([(of(above) - of(below)) / apart for above, below, apart in nearby])

    strips = quotient(lambda one: 0.5 * widths * one.outline(theta) ** 2)
    gained = np.empty((len(nearby), len(angles), len(displacements)))
    for k, angle in enumerate(angles):
        turned = outline * np.exp(-1j * angle)
        gained[:, k] = _of_longer(_chords(turned, turned.imag), strips, displacements)
    hidden = quotient(lambda one: _hidden(one, displacements))
    grown = quotient(lambda one: np.array(one.area))
    slopes = (gained / np.pi - hidden[:, None]) / rim.area
    return np.asarray(slopes - common * (grown / rim.area)[:, None, None])


def _hidden(rim: Rim, displacements: Floats) -> Floats:
    """Return what the obstruction takes from the overlap of the outline, over pi: its disc and the copy's."""
    dark = rim.dark_area
    if not dark:
        return np.zeros_like(displacements)
    own = diffraction_mtf(displacements / (2 * np.sqrt(abs(dark))))
    return np.asarray(dark * (2 - own))


def _of_longer(chords: Floats, amounts: Floats, displacements: Floats) -> Floats:
    """Return sums (amounts, displacements) of amounts (amounts, chords) at chords that are longer than displacements."""
    order = np.argsort(chords)
    sums = np.cumsum(amounts[:, order[::-1]], axis=1)[:, ::-1]
    padded = np.append(sums, np.zeros((len(sums), 1)), axis=1)
    return np.asarray(padded[:, np.searchsorted(chords[order], displacements)])


def _chords(outline: Complexes, heights: Floats) -> Floats:
    """Return lengths of an outline's chords along x at some heights. outline: points x + iy around it."""
    outline = np.roll(outline, -int(np.argmin(outline.imag)))
    top = int(np.argmax(outline.imag))
    sides = outline[: top + 1], np.append(outline[top:], outline[0])[::-1]
    left, right = (
        np.interp(heights, np.maximum.accumulate(side.imag), side.real) for side in sides
    )
    return np.abs(left - right)
