"""A photograph as the search for a target looks at it: grey, in parts, as coarse as needed.

Of a frame of 100 million pixels no grey copy is made. Coarse copies are means over cells of the filter array, which have
no pattern of the mosaic. Only a part of a few hundred pixels is looked at in the mosaic's own pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import IN_COLOURS, MONO
from labkit.types import Floats

Singles = NDArray[np.float32]

LEAST_SIDE_PX = 8

LEAST_CONTRAST = 1.3
"""Bright over dark, below which a picture shows nothing. Prints have 5 at the least; an even panel stays below 1.2."""

KERNEL = np.array([0.25, 0.5, 0.25], np.float32)
"""Binomial filter over neighbours: the mean of every colour of a cell of two by two, without a shift."""


class Picture:
    """The grey values of a photograph, made where they are looked at.

    Parameters
    ----------
    counts : (rows, columns) of a mosaic, or (rows, 3 columns) in colours; any scale and offset, NaN where there is no value
    pattern : colours of the filter array's cell, such as ("RG", "GB"), ("M",) or ("RGB",)
    black : the count of no light

    Raises
    ------
    TargetError : no pixels to look at
    """

    def __init__(
        self, counts: NDArray[Any], pattern: Sequence[str] = MONO, black: float = 0.0
    ) -> None:
        pattern = tuple(pattern)
        colours = len(IN_COLOURS[0]) if pattern == IN_COLOURS else 1
        self.shape = (counts.shape[0], counts.shape[1] // colours)
        if min(self.shape) < LEAST_SIDE_PX:
            raise TargetError(
                f"no target found in the frame: it has no pixels to look at (shape {self.shape})"
            )
        self._counts = _drawable(counts).reshape(*self.shape, colours)
        self._cell = 1 if pattern in (MONO, IN_COLOURS) else len(pattern)
        self._black = black
        self._halves: list[Singles] = []

    @classmethod
    def of(cls, image: ArrayLike | Photograph | Picture) -> Picture:
        """Return the picture of a decoded photograph, or of a grey image (rows, columns)."""
        if isinstance(image, Picture):
            return image
        if isinstance(image, Photograph):
            return cls(image.counts, image.pattern, float(image.black.mean()))
        counts = np.asarray(image)
        floating = counts.dtype.kind == "f"
        real_array(
            "image",
            np.nan_to_num(counts) if floating else counts,
            (None, None),
            "any scale",
        )
        return cls(counts)

    def negative(self) -> Picture:
        """Return the picture with black and white exchanged."""
        other = copy(self)
        other._counts = self._counts.max() - self._counts
        other._halves = []
        return other

    def scaled(self, scale: float) -> Singles:
        """Return the whole picture with `scale` samples along a pixel; its corners stay corners."""
        shape = tuple(max(1, round(n * scale)) for n in self.shape)
        # at least one halving: the pixels of a mosaic have the pattern of its colours
        source = self._halved(max(1, int(np.floor(-np.log2(scale) + 1e-9))))
        if source.shape == shape:
            return source
        how = cv2.INTER_AREA if min(source.shape) >= min(shape) else cv2.INTER_LINEAR
        return single(cv2.resize(source, shape[::-1], interpolation=how))

    def binning(self, factor: int) -> int:
        """Return the number of pixels along which to bin for about `factor`: whole cells of the filter array, or 1."""
        most = min(self.shape) // 2
        return int(max(1, min(factor, most) // self._cell * self._cell))

    def part(self, low: ArrayLike, high: ArrayLike, factor: int) -> Singles:
        """Return means over factor × factor pixels from (row, column) `low` to before `high`.

        Parameters
        ----------
        low, high : `low` on a whole cell of the filter array, see `whole_cells`; a remainder at the end is left out
        factor : as `binning` returns it
        """
        (top, left), (bottom, right) = np.asarray(low), np.asarray(high)
        counts = self._counts[top:bottom, left:right]
        if factor == 1 and self._cell > 1:
            return _without_pattern(_grey(counts), self._cell)
        return _grey(_binned(counts, factor))

    def own_pixels(
        self, low: ArrayLike, high: ArrayLike, factor: int
    ) -> tuple[Singles, int]:
        """Return a part with the pattern of its mosaic, and after how many pixels that repeats; 1 where binned. See `part`."""
        if factor > 1 or self._cell == 1:
            return self.part(low, high, factor), 1
        (top, left), (bottom, right) = np.asarray(low), np.asarray(high)
        return _grey(self._counts[top:bottom, left:right]), self._cell

    def warped(self, from_map: Floats, shape: tuple[int, int]) -> Singles:
        """Return the picture where an affine map (2, 3) of (x, y) carries a grid's samples, from a copy about as coarse."""
        per_sample = float(np.sqrt(abs(np.linalg.det(from_map[:, :2]))))
        halvings = max(1, round(np.log2(max(per_sample, 1.0))))
        step = 2.0**halvings
        to_half = from_map / step
        to_half[:, 2] += 0.5 / step - 0.5
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        source = self._halved(halvings)
        return single(
            cv2.warpAffine(
                source, to_half, shape[::-1], flags=how, borderMode=cv2.BORDER_REPLICATE
            )
        )

    def contrast(self) -> float:
        """Return how many times brighter bright parts are than dark ones; 1 for a picture of one grey all over."""
        dark, bright = np.percentile(self.scaled(0.25) - self._black, (0.5, 99.5))
        if bright == dark:
            return 1.0
        return float(bright / dark) if dark > 0 else np.inf

    def whole_cells(self, low: ArrayLike) -> NDArray[np.int_]:
        """Return the first (row, column) of the cell of the filter array that a pixel belongs to."""
        return np.asarray(low, dtype=int) // self._cell * self._cell

    def _halved(self, times: int) -> Singles:
        """Return the whole picture binned down by 2, so many times."""
        while len(self._halves) < times:
            last = self._halves[-1] if self._halves else self._counts
            self._halves.append(_grey(_binned(last, 2)))
        return self._halves[times - 1]


def _drawable(counts: NDArray[Any]) -> NDArray[Any]:
    """Return counts of a type that OpenCV resizes, without gaps. Raises TargetError where no pixel has a value."""
    if counts.dtype == np.uint16:
        return counts
    singles = counts.astype(np.float32)
    valid = np.isfinite(singles)
    if not valid.any():
        raise TargetError(
            f"no target found in the frame: it has no pixels to look at (shape {counts.shape})"
        )
    if valid.all():
        return singles
    return np.where(valid, singles, np.median(singles[valid]))


def _binned(counts: NDArray[Any], factor: int) -> NDArray[Any]:
    """Return means over factor × factor pixels, without the remainder at the end."""
    if factor == 1:
        return counts
    rows, cols = counts.shape[0] // factor, counts.shape[1] // factor
    whole = counts[: rows * factor, : cols * factor]
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA))


def _grey(colours: NDArray[Any]) -> Singles:
    """Return the mean (rows, columns) of colours (rows, columns, n), or the picture of a single one."""
    if colours.ndim == 3:
        colours = colours.mean(axis=2) if colours.shape[2] > 1 else colours[..., 0]
    return single(colours)


def _without_pattern(mosaic: Singles, cell: int) -> Singles:
    """Return a mosaic with each plane of its cell on the same scale, and the mean over neighbours."""
    grey = np.empty_like(mosaic)
    for row, col in np.ndindex(cell, cell):
        plane = mosaic[row::cell, col::cell]
        grey[row::cell, col::cell] = normalised(plane, plane)
    return single(
        cv2.sepFilter2D(grey, -1, KERNEL, KERNEL, borderType=cv2.BORDER_REFLECT_101)
    )


def grey_image(light: ArrayLike, pattern: Sequence[str] = MONO) -> Singles:
    """Return a grey image, about 0..1, of a small photograph or of a part, in its own pixels.

    Raises TargetError for a nearly even image.

    Parameters
    ----------
    light : (rows, cols) counts above black, (rows, 3 cols) in colours
    pattern : colours of the filter array's cell
    """
    counts = np.asarray(light, dtype=np.float32)
    picture = Picture(counts, pattern)
    contrast = 0.0
    for row, col in np.ndindex(len(pattern), len(pattern[0])):
        dark, bright = np.nanpercentile(
            counts[row :: len(pattern), col :: len(pattern[0])], (0.5, 99.5)
        )
        contrast = max(contrast, bright / dark if dark > 0 else np.inf)
    if contrast < LEAST_CONTRAST:
        raise TargetError(
            f"it is nearly even, bright parts {contrast:.2f} times as bright as dark ones"
        )
    grey = picture.part((0, 0), picture.shape, 1)
    return normalised(grey, grey)


def normalised(image: Floats | Singles, of: Floats | Singles) -> Singles:
    """Return an image with the darkest parts `of` a picture at 0, the brightest at 1, and hot pixels clipped."""
    low, high = np.percentile(of, (0.5, 99.5)) if of.size else (0.0, 0.0)
    return single(np.clip((image - low) / max(high - low, 1e-9), -0.2, 1.2))


def single(image: NDArray[Any]) -> Singles:
    """Return an image in single precision."""
    return np.asarray(image, dtype=np.float32)
