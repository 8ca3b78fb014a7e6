"""Departures of real cameras, lenses and panels from ideal ones, all off by default: settings only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from labkit.types import Floats

LEAST_VEIL_PX = 2.0
"""A veil is laid from pixel to pixel, and a narrower one would alias: a Gaussian of two pixels keeps 3e-9 at half a cycle."""

LEAST_PARALLELOGRAM_SIDE = 1e-6
"""Least width of a parallelogram, panel pixels, so that 0 is not divided by 0."""

Sides = tuple[Floats, Floats, Floats]
"""Along one direction of the panel: a parallelogram's middle, and how far each of its two sides reaches."""


@dataclass(frozen=True, slots=True)
class LowPassFilter:
    """Two birefringent plates before the sensor, each of which parts light in two: four equal spots.

    rows_px, cols_px: how far apart the spots are down and across, pixel pitches; 0 for no plate. turned: by 45 degrees, spots
    at (±s/√2, 0) and (0, ±s/√2); both plates then part by the same s. Raises ValueError for other numbers.
    """

    rows_px: float = 0.0
    cols_px: float = 0.0
    turned: bool = False

    def __post_init__(self) -> None:
        if min(self.rows_px, self.cols_px) < 0:
            raise ValueError(
                f"a low-pass filter parts by 0 pixels or more, not {self.rows_px:g} x {self.cols_px:g}"
            )
        if self.turned and self.rows_px != self.cols_px:
            raise ValueError(
                f"a turned low-pass filter has one separation, not {self.rows_px:g} and {self.cols_px:g} px"
            )

    @property
    def spots_px(self) -> Floats:
        """(4, 2) where light goes, down and right, pixels."""
        if self.turned:
            aside = self.rows_px / np.sqrt(2)
            return np.array([[-aside, 0.0], [aside, 0.0], [0.0, -aside], [0.0, aside]])
        down, right = self.rows_px / 2, self.cols_px / 2
        return np.array([[-down, -right], [-down, right], [down, -right], [down, right]])


@dataclass(frozen=True, slots=True)
class Smear:
    """A vibrating rail draws each point into a line, evenly: its length in pixels, its direction from right towards down.

    Raises ValueError for a negative length.
    """

    length_px: float = 0.0
    direction_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.length_px < 0:
            raise ValueError(f"a smear is 0 pixels long or longer, not {self.length_px:g}")


@dataclass(frozen=True, slots=True)
class Veil:
    """Veiling glare: a fraction of all light, spread by a Gaussian (its sigma) or exp(-r / scale) over scale_px
    pixels.

    Light beyond the frame's width is placed within. Raises ValueError for an impossible
    fraction, and for a scale of less than LEAST_VEIL_PX.
    """

    fraction: float = 0.0
    scale_px: float = 30.0
    shape: Literal["gaussian", "exponential"] = "exponential"

    def __post_init__(self) -> None:
        if not 0 <= self.fraction < 1:
            raise ValueError(
                f"a veil takes 0 to less than 1 of the light, not {self.fraction:g}"
            )
        if self.scale_px < LEAST_VEIL_PX:
            raise ValueError(
                f"a veil is {LEAST_VEIL_PX:g} pixels wide or wider, not {self.scale_px:g}"
            )


@dataclass(frozen=True, slots=True)
class Spectrum:
    """A channel's light: (wavelength in nm, share of the electrons) of a few lines, in any scale of shares.

    The lens's path differences, in nm, are the same for all lines. defocus_waves_per_nm:
    longitudinal colour within the channel, waves RMS at the reference wavelength for each
    nm beyond the channel's wavelength_nm, to which best focus refers. Raises ValueError
    without lines, or for a wavelength or share that is not positive.
    """

    lines: tuple[tuple[float, float], ...]
    defocus_waves_per_nm: float = 0.0

    def __post_init__(self) -> None:
        if not self.lines or min(min(line) for line in self.lines) <= 0:
            raise ValueError(
                f"a spectrum is lines of (nm, share), all positive, not {self.lines}"
            )

    @property
    def shares(self) -> tuple[tuple[float, float], ...]:
        """The lines, their shares scaled to unit sum."""
        total = sum(share for _, share in self.lines)
        return tuple((nm, share / total) for nm, share in self.lines)


@dataclass(frozen=True, slots=True)
class Lit:
    """The rectangle of each panel pixel that shines in one colour: from and to, in shares of its side,
    rightwards and down.

    A pixel emits the same light as if all of it shone, so the rectangle is brighter in
    proportion. Raises ValueError for a rectangle that is empty or reaches out of the pixel.
    """

    across: tuple[float, float]
    down: tuple[float, float]

    def __post_init__(self) -> None:
        for low, high in (self.across, self.down):
            if not 0 <= low < high <= 1 + 1e-12:
                raise ValueError(
                    f"a panel pixel is lit from {low:g} to {high:g} of its side, outside 0..1"
                )

    def brightness(self, right: Sides, down: Sides) -> Floats:
        """Return the mean over a parallelogram, relative to a pixel that is lit all over.

        right, down: its middle, counted in panel pixels from a pixel's corner, and the
        extent of its two sides along this axis. The mean is exact except where edges of
        both directions meet in a slanting parallelogram, whose corners' errors have both
        signs: samples a sixth of a pixel wide draw white within 3e-4 RMS at a few degrees,
        within 0.6 % at 40.
        """
        return _lit_share(*right, *self.across) * _lit_share(*down, *self.down)


def _lit_share(
    middle: Floats, first: Floats, second: Floats, low: float, high: float
) -> Floats:
    """Return the mean of a periodic rectangle over two boxes convolved.

    The rectangle is 1 / (high - low) within low..high of each unit and 0 elsewhere; first,
    second: widths of the boxes.
    """
    a, b = (
        np.maximum(np.abs(width), LEAST_PARALLELOGRAM_SIDE) / 2 for width in (first, second)
    )
    beyond = np.zeros(np.shape(middle))
    for sign, place in ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b)):
        beyond += sign * (
            _twice_integrated(middle + place - high)
            - _twice_integrated(middle + place - low)
        )
    return 1 + beyond / (4 * a * b * (high - low))


def _twice_integrated(place: Floats) -> Floats:
    """Return the periodic sawtooth x - 1/2 on 0..1, integrated twice: Bernoulli's third polynomial over 6."""
    x = place - np.floor(place)
    return np.asarray(((x / 6 - 0.25) * x + 1 / 12) * x)
