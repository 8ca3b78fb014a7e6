"""The light that the other targets of a grid, or a single target's marks, throw on a target: the far halo of their images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from labkit.calibration.calibrate import ChannelData
from labkit.estimation.likelihood import FrameData
from labkit.finder.cut import sees_no_neighbour
from labkit.finder.mark_search import marks_px
from labkit.imaging.warp import Pose
from labkit.key import Tile
from labkit.photographs.photograph import Cut
from labkit.target.grid import TargetGrid
from labkit.target.target import Target, on_dots
from labkit.types import Floats

DOTS, AVERAGED = 9, 3
"""Points of light along a side of a neighbour, and dots of a point along each side. With 27 points the light in cuts of 84 and
90 pixels, of carpets of 64 on pitches of 100 and 128, changes by 0.9 and 0.3 % at most."""

PLACES = 7
"""Places along each side of a cut where the halo is summed: with 15 it changes by 1.3 and 0.3 % at most in these cuts."""


def only_own(
    data: ChannelData, pose: Pose, clear_mm: float, size_mm: tuple[float, float]
) -> ChannelData:
    """Mask the pixels that see neighbours of a target of size_mm, farther than `clear_mm` from its edge."""
    own = sees_no_neighbour(pose, clear_mm, size_mm, data.mask.shape)
    return replace(data, mask=data.mask & own)


def with_neighbours(
    frames: Sequence[FrameData],
    target: Target,
    corners_px: Sequence[Mapping[Tile | None, Floats]],
    tile: Tile | None,
    cut: Cut,
) -> tuple[FrameData, ...]:
    """Return the frames of a tile with the light of its neighbours, whose corners are those of each photograph."""
    return tuple(
        replace(frame, beside=halo_of_neighbours(target, corners, tile, cut))
        for frame, corners in zip(frames, corners_px, strict=True)
    )


def with_marks(
    frames: Sequence[FrameData], marked: TargetGrid, corners_px: Sequence[Floats], cut: Cut
) -> tuple[FrameData, ...]:
    """Return the frames of a single target with the light of its marks; corners are the target's in each photograph."""
    marks = [marked.mark(number) for number in range(len(marked.mark_numbers))]
    return tuple(
        replace(
            frame, beside=halo_of(zip(marks, marks_px(marked, corners), strict=True), cut)
        )
        for frame, corners in zip(frames, corners_px, strict=True)
    )


def halo_of_neighbours(
    target: Target, corners_px: Mapping[Tile | None, Floats], tile: Tile | None, cut: Cut
) -> Floats:
    """Return the light of a tile's neighbours in a cut, see `halo_of`.

    Parameters
    ----------
    target : one target of the grid
    corners_px : (4, 2) row and column in the photograph, of each tile
    tile : the tile that the cut shows
    cut : rows and columns of the photograph
    """
    around = [corners_px[other] for other in _around(tile) if other in corners_px]
    return halo_of([(target, corners) for corners in around], cut)


def halo_of(others: Iterable[tuple[Target, Floats]], cut: Cut) -> Floats:
    """Return the light of other targets in a cut, for a lambda N of one pixel; it is proportional to lambda N.

    Far from its middle every PSF, averaged over its rings, is lambda N / (pi r)^3, as that of a perfect lens.

    Parameters
    ----------
    others : each with its corners (4, 2), row and column in the photograph
    cut : rows and columns of the photograph

    Returns
    -------
    (rows, columns) above the surround's light, 1 for the radiance of white
    """
    rows, columns = (np.linspace(side.start, side.stop - 1, PLACES) for side in cut)
    here = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)[:, :, None]
    light = np.zeros((PLACES, PLACES))
    side = 2 * (np.arange(DOTS) + 0.5) / DOTS - 1
    for target, corners in others:
        dots = on_dots(target, (DOTS * AVERAGED, DOTS * AVERAGED))
        radiance = dots.reshape(DOTS, AVERAGED, DOTS, AVERAGED).mean(axis=(1, 3)).ravel()
        radiance -= target.surround or 0.0
        pose = Pose.from_corners(corners, (1.0, 1.0))
        there = pose.to_pixels(np.repeat(side, DOTS), np.tile(side, DOTS))
        away = np.linalg.norm(here - there, axis=-1)
        dot_px = 4 * float(np.prod(pose.pixel_per_unit())) / DOTS**2
        light += dot_px * ((np.pi * away) ** -3.0 @ radiance)
    spline = RectBivariateSpline(rows, columns, light)
    every = [np.arange(side.start, side.stop, dtype=np.float64) for side in cut]
    return np.asarray(spline(every[0], every[1]), dtype=np.float64)


def _around(tile: Tile | None) -> list[Tile]:
    """Return the eight places of a grid next to a tile."""
    if tile is None:
        return []
    row, column = tile
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    return [(row + i, column + j) for i, j in steps]
