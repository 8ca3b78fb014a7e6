"""Blur across an edge that no wavefront makes, by its transfer function along the edge's normal.

Each edge has its own numbers, so what blurs one direction alone, as a shake does, leaves the others as they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from labkit.imaging.parts import Diffusion, LowPass
from labkit.types import Floats

SMALL_ANGLE = 1e-3


class Blur(ABC):
    """A kind of blur, with a number or two.

    Attributes
    ----------
    words : cause, for a sentence
    starts : numbers that fits begin with
    stds : of the numbers among photographs: wide priors about 0
    """

    words: ClassVar[str]
    starts: ClassVar[tuple[tuple[float, ...], ...]]
    stds: ClassVar[tuple[float, ...]]

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return len(self.stds)

    @abstractmethod
    def transfer(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        """Return the transfer function (f,) at frequencies, cycles a pixel along the normal."""

    @abstractmethod
    def slopes(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        """Return the derivatives (numbers, f) of the transfer function."""


class GaussianBlur(Blur):
    """Charge diffusion, many small shakes, or a smoothing filter; its number is the variance, pixels squared."""

    words = "a Gaussian blur, as by charge diffusion, smoothing or a shake"
    starts = ((0.1,), (1.0,))
    stds = (4.0,)

    def transfer(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (variance,) = numbers
        still = np.zeros_like(frequency)
        return np.asarray(Diffusion(variance).transfer(frequency, still), np.float64)

    def slopes(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (variance,) = numbers
        return np.stack(Diffusion(variance).slopes(frequency, np.zeros_like(frequency)))


class TwoSpots(Blur):
    """An optical low-pass filter; its number is the square of the spots' distance, pixels squared."""

    words = "two spots, as by an optical low-pass filter or a shake"
    starts = ((0.3,), (1.5,))
    stds = (10.0,)

    def transfer(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (square,) = numbers
        still = np.zeros_like(frequency)
        return np.asarray(LowPass(rows=square).transfer(frequency, still), np.float64)

    def slopes(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (square,) = numbers
        by_square, _ = LowPass(rows=square).slopes(frequency, np.zeros_like(frequency))
        return np.asarray(by_square[None], np.float64)


class Motion(Blur):
    """Even motion during the exposure; its number is the square of the way, pixels squared."""

    words = "motion during the exposure"
    starts = ((1.0,), (6.0,), (16.0,))
    stds = (30.0,)

    def transfer(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (square,) = numbers
        angle, whole = _way(square, frequency)
        return _ratio(angle, whole)

    def slopes(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        (square,) = numbers
        angle, whole = _way(square, frequency)
        small = angle < SMALL_ANGLE
        safe = np.where(small, 1.0, angle)
        even = np.cos(safe) if whole else np.cosh(safe)
        # of sin(a) / a by a squared
        slope = (even - _ratio(safe, whole)) / (2 * safe**2)
        by_square = np.where(small, -1 / 6, slope if whole else -slope)
        return (by_square * (np.pi * frequency) ** 2)[None]


def _way(square: float, frequency: Floats) -> tuple[Floats, bool]:
    """Return pi times the way in periods, and whether the way is real."""
    return np.pi * np.sqrt(abs(square)) * np.abs(frequency), square >= 0


def _ratio(angle: Floats, whole: bool) -> Floats:
    """Return sin(a) / a, of an imaginary one sinh(a) / a."""
    small = angle < SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    return np.where(small, 1.0, (np.sin(safe) if whole else np.sinh(safe)) / safe)


class Sharpening(Blur):
    """An unsharp mask, 1 + a (1 - G); its numbers are its amount and the logarithm of its radius, pixels."""

    words = "sharpening by a program or in the camera"
    starts = ((0.5, 0.0), (0.5, 0.7))
    stds = (3.0, 1.0)

    def transfer(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        amount, _ = numbers
        return 1 + amount * (1 - self._mask(frequency, numbers))

    def slopes(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        amount, log_radius = numbers
        mask = self._mask(frequency, numbers)
        by_radius = amount * mask * 4 * np.pi**2 * np.exp(2 * log_radius) * frequency**2
        return np.stack([1 - mask, by_radius])

    def _mask(self, frequency: Floats, numbers: Sequence[float]) -> Floats:
        variance = np.exp(2 * np.clip(numbers[1], -3, 3))
        return np.asarray(np.exp(-2 * np.pi**2 * variance * frequency**2))


BLURS: tuple[Blur, ...] = (GaussianBlur(), Motion(), TwoSpots(), Sharpening())
MOST_NUMBERS = max(kind.size for kind in BLURS)
