"""Form an image on the simulated bench: geometry and brute force on a grid much finer than the pixels.

The panel's pixels are projected through a pinhole, and every fine sample takes the average
radiance over its own square. The lens's PSF is convolved without any wrap-around, and a
pixel sums the samples of its active square. With such samples the pixel's integral is
exact: a sum of adjoining squares is a square. The remaining aliasing shrinks with the
square of the sampling, and a test holds it far below the photon noise.

Written without labkit.optics and labkit.imaging, which it tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import NDArray

from labkit.drivers.simulated.parts import Lit, Sides
from labkit.types import Floats, Floats32

Complexes32 = NDArray[np.complex64]
Value = TypeVar("Value", np.int16, np.float32)

OUTSIDE = -1
"""Stands for the dark room around the panel in a map of picture codes."""

ROWS_AT_ONCE = 64
POINTS_PER_EDGE_SAMPLE = 34
"""Points that average a sample with an edge in it: a Fibonacci lattice, one point in each of 34 columns and rows."""


@dataclass(frozen=True, slots=True)
class Glass:
    """The content of the panel for the scene.

    codes: (rows, cols) picture values, equal where neighbours shine alike except for the
    backlight; radiance: (rows, cols) relative to white, mean over a panel pixel; pitch_mm:
    its side. Coordinates: x right, y down, origin at the panel's centre. lit: the part of
    each panel pixel that shines; None for all of it.
    """

    codes: NDArray[np.int16]
    radiance: Floats32
    pitch_mm: float
    lit: Lit | None = None


@dataclass(frozen=True, slots=True)
class FineGrid:
    """(rows, cols) pixels from (top, left), each of samples x samples fine samples, with reach more of them on every side."""

    rows: int
    cols: int
    samples: int
    reach: int
    top: int = 0
    left: int = 0

    def centres(self, pixels: int) -> Floats:
        """Return sample centres along an axis of `pixels` pixels, in pixels; pixel centres are integers."""
        return (
            np.arange(pixels * self.samples + 2 * self.reach) - self.reach + 0.5
        ) / self.samples - 0.5


def project(
    tilt_deg: tuple[float, float],
    roll_deg: float,
    shift_mm: tuple[float, float],
    range_mm: float,
) -> Floats:
    """Return the (3, 3) map from panel mm (x, y, 1) to tangents in front of the camera: turn, shift,
    perspective.

    tilt_deg: about the camera's x (right) and y (down) axes; roll_deg: about its axis,
    clockwise as the camera sees it; shift_mm: place of the panel's centre (right, down) of
    the axis, range_mm along it.
    """
    (pitch, yaw), roll = np.radians(tilt_deg), np.radians(roll_deg)
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    about_y = np.array(
        [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    )
    about_z = np.array(
        [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]
    )
    turn = about_x @ about_y @ about_z
    return np.column_stack([turn[:, 0], turn[:, 1], [*shift_mm, range_mm]])


def carry(matrix: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Map points (x, y), broadcast, through a (3, 3) projective map."""
    below = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    right = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / below
    down = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / below
    return right, down


Straight = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Returns the places of pixels, x right and y down, that a lens without distortion would give them."""


def render(
    glass: Glass, panel_to_pixels: Floats, grid: FineGrid, straight: Straight | None = None
) -> Floats32:
    """Return the mean radiance over each fine sample's square: (rows * samples + 2 reach, cols * samples + 2
    reach).

    panel_to_pixels: (3, 3), panel mm (x, y, 1) to pixels (column, row, 1), of a lens
    without distortion; straight: undoes distortion, None without any. A sample's square is
    a parallelogram on the panel.
    """
    rows, cols = glass.codes.shape
    to_index = np.array(
        [[1, 0, cols / 2 + 1], [0, 1, rows / 2 + 1], [0, 0, 1]]
    )  # of the table with its dark rim
    to_index[:2, :2] /= glass.pitch_mm
    to_panel = to_index @ np.linalg.inv(panel_to_pixels)
    codes = np.pad(glass.codes, 1, constant_values=OUTSIDE)
    radiance = np.pad(glass.radiance, 1)
    half = 0.5 / grid.samples
    y, x = grid.top + grid.centres(grid.rows), grid.left + grid.centres(grid.cols)
    scene = np.empty((y.size, x.size), dtype=np.float32)
    x_corner = np.append(x - half, x[-1] + half)[None, :]
    for start in range(0, y.size, ROWS_AT_ONCE):
        y_here = y[start : start + ROWS_AT_ONCE]
        y_corner = np.append(y_here - half, y_here[-1] + half)[:, None]
        ideal = straight(x_corner, y_corner) if straight else (x_corner, y_corner)
        right, down = carry(to_panel, *ideal)
        corner = _look_up(codes, right, down)
        edge = (corner[:-1, :-1] != corner[1:, 1:]) | (corner[:-1, 1:] != corner[1:, :-1])
        edge |= corner[:-1, :-1] != corner[:-1, 1:]
        across = _parallelograms(right)
        along = _parallelograms(down)
        block = _look_up(radiance, across[0], along[0])
        i, j = np.nonzero(edge)
        dx, dy = _lattice(i + start + grid.top * grid.samples, j + grid.left * grid.samples)
        point_right = _within(across, i, j, dx, dy)
        point_down = _within(along, i, j, dx, dy)
        points = _look_up(radiance, point_right[0], point_down[0])
        if glass.lit is not None:
            block *= glass.lit.brightness(across, along).astype(np.float32)
            points *= glass.lit.brightness(point_right, point_down).astype(np.float32)
        block[i, j] = points.mean(axis=1)
        scene[start : start + ROWS_AT_ONCE] = block
    return scene


def _look_up(table: NDArray[Value], right: Floats, down: Floats) -> NDArray[Value]:
    """Return the table's values at places in it."""
    col = np.clip(right, 0, table.shape[1] - 1).astype(np.intp)
    row = np.clip(down, 0, table.shape[0] - 1).astype(np.intp)
    seen: NDArray[Value] = table.ravel()[row * table.shape[1] + col]
    return seen


def _parallelograms(corner: Floats) -> Sides:
    """Return middle and two sides, along one direction of the panel, of the squares between corners."""
    left, right = corner[:, :-1], corner[:, 1:]
    across = right - left
    down = corner[1:] - corner[:-1]
    return (
        (left[:-1] + left[1:] + right[:-1] + right[1:]) / 4,
        (across[:-1] + across[1:]) / 2,
        (down[:, :-1] + down[:, 1:]) / 2,
    )


def _within(
    sides: Sides, i: NDArray[np.intp], j: NDArray[np.intp], dx: Floats, dy: Floats
) -> Sides:
    """Return points within some squares, each with its own share of the square around."""
    middle, across, down = (part[i, j, None] for part in sides)
    apart = np.sqrt(POINTS_PER_EDGE_SAMPLE)
    return middle + dx * across + dy * down, across / apart, down / apart


def _lattice(i: NDArray[np.intp], j: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return points within unit squares (-0.5..0.5), (len(i), POINTS_PER_EDGE_SAMPLE) each way.

    Each square's lattice is turned by another amount (Roberts' R2 sequence), so that errors
    of neighbours along an edge differ.
    """
    k = np.arange(POINTS_PER_EDGE_SAMPLE)
    dx = (k / POINTS_PER_EDGE_SAMPLE + (0.7548776662 * i + 0.1 * j)[:, None]) % 1
    dy = (k * 21 / POINTS_PER_EDGE_SAMPLE + (0.5698402910 * j + 0.3 * i)[:, None]) % 1
    return dx - 0.5, dy - 0.5


@dataclass(frozen=True, slots=True)
class SceneTransform:
    """A scene's Fourier transform, kept for convolution with several PSFs, and its mean over each pixel, rim
    included.
    """

    transform: Complexes32
    size: tuple[int, int]
    grid: FineGrid
    pixels: Floats32


def transform(scene: Floats32, grid: FineGrid) -> SceneTransform:
    """Return the transform of a rendered scene, whose rim is whole pixels wide. Raises ValueError for another
    rim.
    """
    if grid.reach % grid.samples:
        raise ValueError(
            f"a rim of {grid.reach} samples is no whole number of pixels of {grid.samples}"
        )
    rows, cols = (side // grid.samples for side in scene.shape)
    pixels = scene.reshape(rows, grid.samples, cols, grid.samples).mean(axis=(1, 3))
    # of whole pixels along the first axis, where `photograph` folds the spectrum
    size = (
        grid.samples * scipy.fft.next_fast_len(rows),
        scipy.fft.next_fast_len(scene.shape[1], True),
    )
    return SceneTransform(scipy.fft.rfft2(scene, size, workers=2), size, grid, pixels)


def photograph(
    scene: SceneTransform,
    psf: Floats32,
    fill_factor: float = 1.0,
    halo: Floats32 | None = None,
) -> Floats32:
    """Return (rows, cols) mean radiance over each pixel's active square after the blur.

    psf: (2 reach + 1, 2 reach + 1). The rim of the scene, reach wide, takes the light that
    the transform wraps around. halo: (2 n + 1, 2 n + 1) light beyond the psf, from pixel to
    pixel; beyond the rim the scene continues with its border values.
    """
    grid = scene.grid
    weights = _active(grid.samples, fill_factor)
    # the first pixel's first sample sees the rim on its left, and the kernel's own centre lies reach further
    first = 2 * grid.reach
    rows = scipy.fft.rfft(psf, scene.size[1], axis=1, workers=2)
    blurred = scipy.fft.fft(rows, scene.size[0], axis=0, workers=2, overwrite_x=True)
    blurred *= scene.transform
    blurred *= _summed_spectrum(scene.size[0], first, tuple(weights))[:, None]
    folded = blurred.reshape(grid.samples, -1, blurred.shape[1]).sum(axis=0)
    summed = scipy.fft.ifft(folded, axis=0, workers=2, overwrite_x=True)[: grid.rows]
    fine = scipy.fft.irfft(summed, scene.size[1], axis=1, workers=2)
    squares = fine[:, first : first + grid.cols * grid.samples]
    squares = squares.reshape(grid.rows, grid.cols, grid.samples)
    pixels: Floats32 = (squares @ weights).astype(np.float32)
    if halo is not None:
        pixels += from_pixel_to_pixel(scene, halo)
    return pixels


@lru_cache(maxsize=16)
def _summed_spectrum(size: int, first: int, weights: tuple[float, ...]) -> Complexes32:
    """Return the transfer function that moves sample `first` to 0 and sums the samples of a pixel, over their number."""
    places = first + np.arange(len(weights))
    turn = np.exp(2j * np.pi * (np.arange(size)[:, None] * places % size) / size)
    return np.asarray(turn @ weights / len(weights), dtype=np.complex64)


def from_pixel_to_pixel(scene: SceneTransform, kernel: Floats32) -> Floats32:
    """Return (rows, cols) mean radiance over each pixel after a coarse blur.

    kernel: (2 n + 1, 2 n + 1) shares of light from pixel to pixel. Beyond the rim the scene
    continues with its border values.
    """
    rim = scene.grid.reach // scene.grid.samples
    far = kernel.shape[0] // 2
    wide = np.pad(scene.pixels, max(far - rim, 0), mode="edge")
    inner = slice(max(rim - far, 0), -max(rim - far, 0) or None)
    return np.asarray(
        scipy.signal.fftconvolve(wide[inner, inner], kernel, mode="valid"), dtype=np.float32
    )


def _active(samples: int, fill_factor: float) -> Floats32:
    """Return the share of each of a pixel's samples in its active width, unit sum."""
    width = np.sqrt(fill_factor)
    edges = np.linspace(-0.5, 0.5, samples + 1)
    inside = np.clip(edges, -width / 2, width / 2)
    return np.asarray(np.diff(inside) / width, dtype=np.float32)
