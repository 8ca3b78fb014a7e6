"""Form an image on the simulated bench: geometry and brute force on a grid much finer than the pixels.

The panel's pixels are projected through a pinhole, and every fine sample takes the average
radiance over its own square. The lens's PSF is convolved without any wrap-around, and a
pixel sums the samples of its active square. With such samples the pixel's integral is
exact: a sum of adjoining squares is a square. The remaining aliasing shrinks with the
square of the sampling, and a test holds it far below the photon noise.

Written without labkit.optics and labkit.imaging, which it tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import NDArray

from labkit.drivers.simulated.parts import Lit
from labkit.types import Floats, Floats32

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


def render(glass: Glass, panel_to_pixels: Floats, grid: FineGrid) -> Floats32:
    """Return the mean radiance over each fine sample's square: (rows * samples + 2 reach, cols * samples + 2
    reach).

    panel_to_pixels: (3, 3), panel mm (x, y, 1) to pixels (column, row, 1).
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
        corner = _look_up(
            codes, to_panel, x_corner, np.append(y_here - half, y_here[-1] + half)[:, None]
        )
        edge = (corner[:-1, :-1] != corner[1:, 1:]) | (corner[:-1, 1:] != corner[1:, :-1])
        edge |= corner[:-1, :-1] != corner[:-1, 1:]
        block = _look_up(radiance, to_panel, x[None, :], y_here[:, None])
        i, j = np.nonzero(edge)
        dx, dy = _lattice(i + start + grid.top * grid.samples, j + grid.left * grid.samples)
        points = _look_up(
            radiance, to_panel, x[j, None] + dx * 2 * half, y_here[i, None] + dy * 2 * half
        )
        if glass.lit is not None:
            block *= _brightness(glass.lit, to_panel, x[None, :], y_here[:, None], 2 * half)
            apart = 2 * half / np.sqrt(POINTS_PER_EDGE_SAMPLE)
            points *= _brightness(
                glass.lit,
                to_panel,
                x[j, None] + dx * 2 * half,
                y_here[i, None] + dy * 2 * half,
                apart,
            )
        block[i, j] = points.mean(axis=1)
        scene[start : start + ROWS_AT_ONCE] = block
    return scene


def _look_up(
    table: NDArray[Value], to_panel: Floats, x: Floats, y: Floats
) -> NDArray[Value]:
    """Return the table's values at the pixels (x, y)."""
    right, down = carry(to_panel, x, y)
    col = np.clip(right, 0, table.shape[1] - 1).astype(np.intp)
    row = np.clip(down, 0, table.shape[0] - 1).astype(np.intp)
    seen: NDArray[Value] = table.ravel()[row * table.shape[1] + col]
    return seen


def _brightness(lit: Lit, to_panel: Floats, x: Floats, y: Floats, side: float) -> Floats32:
    """Return the light of panel pixels' lit parts in squares of a side about (x, y); a whole pixel's light is
    1.
    """
    middle = carry(to_panel, x, y)
    ends = [
        carry(to_panel, x + dx, y + dy)
        for dx, dy in ((-side / 2, 0), (side / 2, 0), (0, -side / 2), (0, side / 2))
    ]
    right, down = (
        (middle[k], ends[1][k] - ends[0][k], ends[3][k] - ends[2][k]) for k in (0, 1)
    )
    return lit.brightness(right, down).astype(np.float32)


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

    transform: NDArray[np.complex64]
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
    size = (
        scipy.fft.next_fast_len(scene.shape[0], True),
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
    blurred = scipy.fft.rfft2(psf, scene.size, workers=2)
    blurred *= scene.transform
    whole = scipy.fft.irfft2(blurred, scene.size, workers=2, overwrite_x=True)
    # the first pixel's first sample sees the rim on its left, and the kernel's own centre lies reach further
    inner = slice(2 * grid.reach, None)
    fine = whole[inner, inner][: grid.rows * grid.samples, : grid.cols * grid.samples]
    weights = _active(grid.samples, fill_factor)
    squares = fine.reshape(grid.rows, grid.samples, grid.cols, grid.samples)
    pixels: Floats32 = np.einsum(
        "isjt,s,t->ij", squares, weights, weights, optimize=True
    ).astype(np.float32)
    if halo is not None:
        pixels += from_pixel_to_pixel(scene, halo)
    return pixels


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
