"""A photograph larger than memory would hold at once, in tiles: each with its own rim, the far light laid over the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.scene import (
    FineGrid,
    SceneTransform,
    from_pixel_to_pixel,
    photograph,
)
from labkit.types import Floats32

SIMULATED_TILE_PX = 320
"""Side of a tile: with ten samples to a pixel and a rim of 42 pixels on each side its transform takes 65 MB."""

Spread = tuple[Floats32, Floats32]
"""A colour's PSF on the fine samples, and what lies beyond from pixel to pixel."""

Draw = Callable[[str, FineGrid], SceneTransform]
"""Draws the scene of a colour for a grid."""


def tiles(rows: int, cols: int, side: int) -> Iterator[tuple[slice, slice]]:
    """Yield cuts of at most side x side pixels that cover a sensor, in order."""
    for top in range(0, rows, side):
        for left in range(0, cols, side):
            yield slice(top, min(top + side, rows)), slice(left, min(left + side, cols))


def mosaic_in_tiles(
    colours: NDArray[np.str_],
    grid: FineGrid,
    draw: Draw,
    spreads: Mapping[str, Spread],
    fill_factor: float,
) -> tuple[Floats32, dict[str, SceneTransform]]:
    """Return (rows, cols) radiance in each pixel through its own colour, and each colour's scene from pixel to
    pixel.

    colours: (rows, cols) of each pixel. Light beyond a tile's rim, the halo, comes from the
    whole scene.
    """
    rim = grid.reach // grid.samples
    seen = np.zeros(colours.shape, dtype=np.float32)
    coarse = {
        colour: np.zeros((grid.rows + 2 * rim, grid.cols + 2 * rim), dtype=np.float32)
        for colour in spreads
    }
    for rows, cols in tiles(grid.rows, grid.cols, SIMULATED_TILE_PX):
        size = rows.stop - rows.start, cols.stop - cols.start
        here = FineGrid(*size, grid.samples, grid.reach, rows.start, cols.start)
        for colour, (psf, _) in spreads.items():
            scene = draw(colour, here)
            mine = colours[rows, cols] == colour
            seen[rows, cols][mine] = photograph(scene, psf, fill_factor)[mine]
            coarse[colour][
                rows.start : rows.stop + 2 * rim, cols.start : cols.stop + 2 * rim
            ] = scene.pixels
    nothing = np.zeros((0, 0), dtype=np.complex64)
    whole = {
        colour: SceneTransform(nothing, (0, 0), grid, pixels)
        for colour, pixels in coarse.items()
    }
    for colour, (_, halo) in spreads.items():
        mine = colours == colour
        seen[mine] += from_pixel_to_pixel(whole[colour], halo)[mine]
    return seen, whole
