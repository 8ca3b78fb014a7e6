"""A photograph in parts: of a sensor larger than memory would hold at once, or of a PSF that changes over the frame.

Each part has its own rim of scene; the far light is laid over the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.scene import (
    FineGrid,
    SceneTransform,
    from_pixel_to_pixel,
    photograph,
)
from labkit.types import Floats, Floats32

SIMULATED_TILE_PX = 320
"""Side of a part: with ten samples to a pixel and a rim of 42 pixels on each side its transform takes 65 MB."""

KNOTS = 3
"""PSFs along a patch, interpolated by a parabola: over 128 pixels of a lens like that of golden field-open within 0.7 % of
the light."""

Draw = Callable[[str, FineGrid], SceneTransform]
"""Draws the scene of a colour for a grid."""

Place = tuple[float, float]
"""Row and column, pixels."""

Spread = Callable[[str, Place | None], Floats32]
"""Returns a colour's PSF at a place on the fine samples; without a place, that of the whole frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A cut of the sensor, and the PSFs that blend there.

    blends: places of PSFs, each with its share in every pixel of the cut; None for all.
    """

    rows: slice
    cols: slice
    blends: tuple[tuple[Place | None, Floats32 | None], ...] = ((None, None),)

    def seen_from(self, top: int, left: int) -> Patch:
        """Return the patch with places counted from a frame's corner, for a part of it that begins at (top, left)."""
        blends = tuple(
            (place and (place[0] + top, place[1] + left), share)
            for place, share in self.blends
        )
        return replace(self, blends=blends)


def tiles(rows: int, cols: int, side: int) -> Iterator[tuple[slice, slice]]:
    """Yield cuts of at most side x side pixels that cover a sensor, in order."""
    yield from _cuts(slice(0, rows), slice(0, cols), side)


def _cuts(rows: slice, cols: slice, side: int) -> Iterator[tuple[slice, slice]]:
    for top in range(rows.start, rows.stop, side):
        for left in range(cols.start, cols.stop, side):
            yield (
                slice(top, min(top + side, rows.stop)),
                slice(left, min(left + side, cols.stop)),
            )


def one_psf(rows: int, cols: int) -> Iterator[Patch]:
    """Yield patches of a sensor under one PSF."""
    for cut in tiles(rows, cols, SIMULATED_TILE_PX):
        yield Patch(*cut)


def smooth(rows: int, cols: int, side_px: float) -> Iterator[Patch]:
    """Yield patches of at most `side_px` a side, each with KNOTS x KNOTS PSFs interpolated between.

    Neighbours share the PSFs of their common edge, so that the picture has no seams.
    """
    for in_rows, down in _patches_along(rows, side_px):
        for in_cols, right in _patches_along(cols, side_px):
            yield Patch(
                in_rows,
                in_cols,
                tuple(
                    ((row, col), np.outer(by_row, by_col).astype(np.float32))
                    for row, by_row in down
                    for col, by_col in right
                ),
            )


def _patches_along(
    pixels: int, side_px: float
) -> Iterator[tuple[slice, list[tuple[float, Floats]]]]:
    """Yield the pixels of each patch along an axis, and its knots, each with its share in every pixel."""
    count = max(1, int(np.ceil(pixels / min(side_px, SIMULATED_TILE_PX))))
    for low, high in pairwise(np.linspace(-0.5, pixels - 0.5, count + 1)):
        inside = slice(int(np.ceil(low)), int(np.ceil(high)))
        at = np.arange(float(inside.start), float(inside.stop))
        knots = [float(knot) for knot in np.linspace(low, high, KNOTS)]
        yield inside, [(knot, _lagrange(at, knot, knots)) for knot in knots]


def _lagrange(at: Floats, knot: float, knots: list[float]) -> Floats:
    """Return the Lagrange polynomial of a knot: 1 at the knot, 0 at all others."""
    share = np.ones_like(at)
    for other in knots:
        if other != knot:
            share *= (at - other) / (knot - other)
    return share


def by_label(label: NDArray[np.int16], places: Mapping[int, Place]) -> Iterator[Patch]:
    """Yield patches with one PSF for all pixels of a label, at the label's place."""
    for number, place in places.items():
        mine = label == number
        if not mine.any():
            continue
        in_rows, in_cols = (
            slice(int(at[0]), int(at[-1]) + 1)
            for at in (np.nonzero(mine.any(axis=1))[0], np.nonzero(mine.any(axis=0))[0])
        )
        for rows, cols in _cuts(in_rows, in_cols, SIMULATED_TILE_PX):
            share = mine[rows, cols].astype(np.float32)
            yield Patch(rows, cols, ((place, share),))


def mosaic_in_patches(
    colours: NDArray[np.str_],
    grid: FineGrid,
    draw: Draw,
    spread: Spread,
    halos: Mapping[str, Floats32],
    patches: Iterator[Patch],
    fill_factor: float,
) -> tuple[Floats32, dict[str, SceneTransform]]:
    """Return (rows, cols) radiance in each pixel through its own colour, and each colour's scene from pixel to
    pixel.

    colours: (rows, cols) of each pixel; halos: of each colour, light beyond a patch's rim,
    from pixel to pixel, which comes from the whole scene. Shares of patches sum to one in
    every pixel.
    """
    rim = grid.reach // grid.samples
    seen = np.zeros(colours.shape, dtype=np.float32)
    coarse = {
        colour: np.zeros((grid.rows + 2 * rim, grid.cols + 2 * rim), dtype=np.float32)
        for colour in halos
    }
    for patch in patches:
        rows, cols = patch.rows, patch.cols
        size = rows.stop - rows.start, cols.stop - cols.start
        corner = grid.top + rows.start, grid.left + cols.start
        here = FineGrid(*size, grid.samples, grid.reach, *corner)
        for colour in halos:
            scene = draw(colour, here)
            mine = colours[rows, cols] == colour
            for place, share in patch.blends:
                light = photograph(scene, spread(colour, place), fill_factor)
                light = light if share is None else light * share
                seen[rows, cols][mine] += light[mine]
            coarse[colour][
                rows.start : rows.stop + 2 * rim, cols.start : cols.stop + 2 * rim
            ] = scene.pixels
    nothing = np.zeros((0, 0), dtype=np.complex64)
    whole = {
        colour: SceneTransform(nothing, (0, 0), grid, pixels)
        for colour, pixels in coarse.items()
    }
    for colour, halo in halos.items():
        mine = colours == colour
        seen[mine] += from_pixel_to_pixel(whole[colour], halo)[mine]
    return seen, whole
