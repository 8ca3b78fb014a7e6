"""A target on a panel with resolved pixels: stripes of one colour with dark gaps between them.

A stripe is a third of a pixel wide, shifted by a third from colour to colour, and lit over
a share of its area: the aperture. Stripes are drawn in closed form, as in
`labkit.target.target.CellTarget`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.arrays import real_array
from labkit.errors import TargetError
from labkit.panel import USUAL_APERTURE
from labkit.target.target import Target, distinct, low_pass, on_dots
from labkit.types import Floats

STRIPES = 3
"""Colours of a pixel, side by side."""


@dataclass(frozen=True, slots=True)
class PanelTarget:
    """One colour of a target on a panel, with one stripe in each pixel.

    pixels: (rows, cols) mean radiance of each panel pixel; size_mm: (height, width) of all
    of them; place: of the colour's stripe in a pixel, 0, 1 or 2 from left to right, or from
    top to bottom for `lying` stripes. aperture: (across, down) the stripe, lit shares of a
    third of a pixel and of a pixel, above 0. surround: as of `CellTarget`, dark. Raises
    TargetError for other numbers.
    """

    pixels: Floats
    size_mm: tuple[float, float]
    place: int
    lying: bool = False
    aperture: tuple[float, float] = (USUAL_APERTURE, USUAL_APERTURE)
    surround: float | None = 0.0
    _core: Floats = field(init=False, repr=False, compare=False)
    _row_of: NDArray[np.intp] = field(init=False, repr=False, compare=False)
    _col_of: NDArray[np.intp] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.place not in range(STRIPES):
            raise TargetError(
                f"a panel pixel's stripes are 0, 1 and 2; there is no {self.place}"
            )
        if not all(np.isfinite(share) and share > 0 for share in self.aperture):
            across, down = self.aperture
            raise TargetError(
                f"a stripe is lit over shares of its width and length above 0, not {across:g}, {down:g}"
            )
        if self.surround:
            raise TargetError(
                f"a panel's pixels are drawn with darkness around them, not {self.surround:g} of white"
            )
        for name, value in zip(
            ("_core", "_row_of", "_col_of"),
            distinct(np.asarray(self.pixels, float)),
            strict=True,
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def of(
        cls, target: Target, pixels: tuple[int, int], place: int, *, lying: bool = False
    ) -> PanelTarget:
        """Return a target on (rows, cols) panel pixels, each with the target's radiance at its middle."""
        radiance = on_dots(target, pixels)
        return cls(radiance, target.size_mm, place, lying, surround=target.surround)

    def lit(self, across: float, down: float) -> PanelTarget:
        """Return the target with another aperture."""
        return replace(self, aperture=(across, down))

    def sample(self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float) -> Floats:
        """Return the radiance (m, n) on the grid y_mm (m,) × x_mm (n,), exactly.

        The low-pass filter of `CellTarget.sample` limits the bandwidth.
        """
        return self._drawn(y_mm, x_mm, bandwidth_per_mm, (_lit, _lit))

    def slopes(
        self, y_mm: ArrayLike, x_mm: ArrayLike, bandwidth_per_mm: float
    ) -> tuple[Floats, Floats]:
        """Return the derivatives (m, n) of `sample` with respect to the aperture's two numbers, exactly."""
        across, down = (
            self._drawn(y_mm, x_mm, bandwidth_per_mm, by)
            for by in ((_lit, _lit_slope), (_lit_slope, _lit))
        )
        return (down, across) if self.lying else (across, down)

    def radiance(self, y_mm: ArrayLike, x_mm: ArrayLike) -> Floats:
        """Return exact point values at broadcast (y_mm, x_mm); 0 between the stripes and outside."""
        places = np.broadcast_arrays(
            real_array("y_mm", y_mm, None, "mm"), real_array("x_mm", x_mm, None, "mm")
        )
        inside = np.ones(places[0].shape, bool)
        index = []
        share = 1.0
        for axis, place in enumerate(places):
            many, pitch = self._along(axis)
            offset, width, _ = self._stripe(axis)
            at = place / pitch + many / 2
            pixel = np.clip(np.floor(at), 0, many - 1).astype(np.intp)
            inside = inside & (np.abs(at - pixel - 0.5 - offset) <= width / 2)
            index.append(pixel)
            share *= width
        return np.where(inside, self.pixels[index[0], index[1]] / share, 0.0)

    def _along(self, axis: int) -> tuple[int, float]:
        """Return the number of pixels along an axis, and their pitch, mm."""
        many = self.pixels.shape[axis]
        return many, self.size_mm[axis] / many

    def _stripe(self, axis: int) -> tuple[float, float, float]:
        """Return a stripe's offset from the middle of its pixel, its lit width and its full width.

        All three are along an axis, in pixels.
        """
        across, down = self.aperture
        if (axis == 0) == self.lying:
            return (self.place - 1) / STRIPES, across / STRIPES, 1 / STRIPES
        return 0.0, down, 1.0

    def _drawn(
        self,
        y_mm: ArrayLike,
        x_mm: ArrayLike,
        bandwidth_per_mm: float,
        by: tuple[_Profile, _Profile],
    ) -> Floats:
        """Return the (m, n) product of profiles along y and x."""
        if not (np.isfinite(bandwidth_per_mm) and bandwidth_per_mm > 0):
            raise ValueError(f"bandwidth {bandwidth_per_mm} cycles/mm: it must be above 0")
        places = (
            real_array("y_mm", y_mm, (None,), "mm"),
            real_array("x_mm", x_mm, (None,), "mm"),
        )
        profiles = []
        for axis, (at, group, profile) in enumerate(
            zip(places, (self._row_of, self._col_of), by, strict=True)
        ):
            (many, pitch), (offset, width, whole) = self._along(axis), self._stripe(axis)
            middles = (np.arange(many) + 0.5 - many / 2 + offset) * pitch
            unit = pitch * bandwidth_per_mm
            each = unit * profile((at[:, None] - middles) * bandwidth_per_mm, width * unit)
            if profile is _lit_slope:
                each *= whole * unit
            profiles.append(each @ np.eye(group.max() + 1)[group])
        return np.asarray(profiles[0] @ self._core @ profiles[1].T)


_Profile = Callable[[Floats, float], Floats]


def _lit(at: Floats, width: float) -> Floats:
    """Return a box of unit area after the filter for a bandwidth of 1."""
    reach, step = low_pass()
    ends = (step(np.clip(at + sign * width / 2, -reach, reach)) for sign in (1, -1))
    return np.asarray((next(ends) - next(ends)) / width)


def _lit_slope(at: Floats, width: float) -> Floats:
    """Return the derivative of `_lit` with respect to the width."""
    reach, step = low_pass()
    kernel = step.derivative()
    edges = [at + sign * width / 2 for sign in (1, -1)]
    beyond = (
        sum(
            np.where(np.abs(edge) < reach, kernel(np.clip(edge, -reach, reach)), 0.0)
            for edge in edges
        )
        / 2
    )
    return np.asarray((beyond - _lit(at, width)) / width)
