"""Tone curves of processed pictures, and the rounding errors after inversion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from labkit.errors import RawError
from labkit.photographs.encoding import Curve, Encoding, profile_curves, profile_name, srgb
from labkit.types import Counts, Floats

FULL_COUNTS = 65535.0
"""Counts of the brightest number: rounding to whole counts is negligible against rounding to 8 bits."""


@dataclass(frozen=True, slots=True, eq=False)
class ToneCurve:
    """Relation of a picture's stored numbers to light. name: source of the curve; levels: (planes, codes) counts of each
    number, 0 to 65535, never falling; a plane for each colour, or a single plane."""

    name: str
    levels: Floats

    def __post_init__(self) -> None:
        if not np.all(np.diff(self.levels) >= 0) or not np.all(
            self.levels[:, -1] > self.levels[:, 0]
        ):
            raise RawError(f"has a tone curve that does not rise ({self.name})")

    def linear(
        self, numbers: Counts | np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    ) -> Counts:
        """Return counts proportional to light, of the numbers' shape; the last axis is the colours' if each has a curve."""
        tables = np.rint(self.levels).astype(np.uint16)
        if len(tables) == 1:
            return np.asarray(tables[0][numbers])
        return np.stack(
            [table[numbers[..., plane]] for plane, table in enumerate(tables)], axis=-1
        )

    def of(self, plane: int) -> ToneCurve:
        """Return the curve of one colour alone."""
        return ToneCurve(self.name, self.levels[plane % len(self.levels)][None])

    def rounding_variance(self, counts: Counts | Floats) -> Floats:
        """Return the variance of rounding to stored numbers, counts² of the shape of the counts, by the curve's slope.

        A number represents all light between the midpoints to its two neighbours. For curves of one colour only.
        """
        levels = self.levels[0]
        steps = np.gradient(levels)
        return np.asarray(np.interp(counts, levels, steps**2 / 12))


def tone_curve(name: str, curves: Sequence[Curve], white: int) -> ToneCurve:
    """Return the curve of numbers from 0 to white.

    curves: light, 0 to 1, by the number, 0 to 1; one for all colours, or one for each
    """
    stored = np.linspace(0.0, 1.0, white + 1)
    with np.errstate(
        all="ignore"
    ):  # a damaged profile's numbers may do anything; what does not rise is refused
        light = [np.asarray(curve(stored)) for curve in curves]
    return ToneCurve(name, FULL_COUNTS * np.clip(light, 0.0, 1.0))


def stated_curve(encoding: Encoding, white: int) -> ToneCurve:
    """Return the curve that a file states; sRGB without a statement. Raises InputError for an unusable profile."""
    if encoding.icc:
        name = profile_name(encoding.icc)
        return tone_curve(
            f"the file's ICC profile{f' ({name})' if name else ''}",
            profile_curves(encoding.icc),
            white,
        )
    if encoding.power is not None:
        power = encoding.power
        return tone_curve(
            f"the file's gamma, {power:.3g}", [lambda stored: stored**power], white
        )
    return tone_curve(
        "sRGB" if encoding.srgb else "sRGB, for the file states none", [srgb], white
    )


def measured_curve(
    light: Sequence[float], numbers: Sequence[Sequence[float]], white: int
) -> ToneCurve:
    """Return the curve through measured points, of numbers from 0 to white.

    light: rising; numbers: rising, shares of full scale, for each colour. Smooth and never falling between the points
    (Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5, 1984), straight beyond them; light is 0 where the number is.
    """
    stored = np.linspace(0.0, 1.0, white + 1)
    levels = []
    for points in numbers:
        (first, second), (last_but_one, last) = points[:2], points[-2:]
        below = light[0] + (stored - first) * (light[1] - light[0]) / (second - first)
        above = light[-1] + (stored - last) * (light[-1] - light[-2]) / (
            last - last_but_one
        )
        between = PchipInterpolator(points, light)(np.clip(stored, first, last))
        level = np.where(stored < first, below, np.where(stored > last, above, between))
        levels.append((level - level[0]) / (level[-1] - level[0]))
    return ToneCurve("the plan's measured curve", FULL_COUNTS * np.clip(levels, 0.0, 1.0))
