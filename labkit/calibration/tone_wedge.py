"""Measure a camera's tone curve from one photograph of `labkit target serve wedge:size_mm=...`.

The wedge's steps are half-tones of black and white, each at two places
(`targets/wedge.py`). Once the lens has blurred the dots, their light is known whatever the
panel's gamma. A factor and a constant remain unknown, from the panel's black and the
veiling glare; every fit of a photograph estimates both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator

from labkit.errors import DataError, RawError, TargetError
from labkit.finder.find_target import find_target
from labkit.photographs.container import recognise
from labkit.photographs.encoding import srgb
from labkit.photographs.picture_file import Picture
from labkit.photographs.processed_picture import read_file
from labkit.target.target import CellTarget, open_target
from labkit.types import Floats

WEDGE = "wedge:size_mm=100"
PATCHES = (4, 8)
"""Rows and columns of steps in the wedge."""

INSIDE = 0.5
"""Of a step's side is looked at, about its middle: the rest is blurred with its neighbours."""

LEAST_STEP_PIXELS = 64
"""Least number of evaluated pixels in a step."""

CLIPPED = 0.01
"""Of a step's pixels at full scale: more of them, and the mean is too low."""

UNEVEN = (0.05, 0.01)
"""Of a step's number, and of full scale: where a step's pixels scatter by more, the mean of the curve is not the curve of the
mean. At a gamma of 2.2 a scatter of 5 % makes the number 0.15 % too low."""

BRIGHT, MOST_UNEVEN_LIGHT = 0.85, 0.3
"""White's number should be this share of full scale at least, and light vary by no more than this."""

CURVE_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Tone:
    """A tone curve.

    light: (steps,) from 0 to 1, rising, relative; numbers: (planes, steps) written by the
    camera, shares of full scale; std: (planes, steps) their standard errors. uneven:
    relative variation of the wedge's light.
    """

    light: Floats
    numbers: Floats
    std: Floats
    uneven: float

    def to_toml(self) -> str:
        """Return the curve as a plan states it."""
        return "\n".join(
            (
                "[sensor.tone_curve]  # measured from a stepped wedge",
                f"light = {_listed(self.light)}",
                f"numbers = [{', '.join(map(_listed, self.numbers))}]  # of full scale, for each colour",
                f"std = [{', '.join(map(_listed, self.std))}]",
            )
        )

    def as_json(self) -> dict[str, object]:
        """Return the curve as the command prints it."""
        lists = {"light": self.light, "numbers": self.numbers, "std": self.std}
        return {
            **{name: np.round(values, 6).tolist() for name, values in lists.items()},
            "uneven": round(self.uneven, 4),
        }

    def notes(self) -> Iterator[str]:
        """Yield remarks on the curve, one line each."""
        if (most := float(self.numbers.max())) < BRIGHT:
            yield (
                f"numbers above {most:.2f} of full scale were not measured, the curve is extrapolated as a straight line: "
                "expose more"
            )
        if self.uneven > MOST_UNEVEN_LIGHT:
            yield (
                f"the wedge's light varies by {self.uneven:.0%}, of which the curve may hold more than its errors say: "
                "photograph the wedge from farther away, or straight on"
            )


def measure_tone(photograph: Path | str) -> Tone:
    """Measure a camera's tone curve from a photograph of the wedge.

    The errors follow from the agreement between each step's two places, after removing low
    orders of uneven light.

    Parameters
    ----------
    photograph : JPEG, PNG, TIFF or PGM, grey or in colours

    Raises
    ------
    RawError
        the file is a raw file, or no picture
    TargetError
        the photograph does not show the wedge
    DataError
        steps are too small, clipped, not blurred into even greys, or not rising

    >>> print(labkit.measure_tone("wedge.jpg").to_toml())
    """
    photograph = Path(photograph)
    try:
        container = recognise(photograph)
    except RawError as error:
        raise RawError(f"{photograph}: {error}") from error
    if container.kind == "raw":
        raise RawError(
            f"{photograph}: is a raw file: its numbers are proportional to light, and have no tone curve"
        )
    try:
        picture = read_file(photograph)
    except RawError as error:
        raise RawError(f"{photograph}: {error}") from error
    wedge = open_target(WEDGE)
    assert isinstance(wedge, CellTarget)
    try:
        return _measured(picture, wedge)
    except TargetError as error:
        raise TargetError(
            f"{photograph}: no wedge found: show labkit target serve {WEDGE}, upright, alone and whole in the frame"
        ) from error
    except DataError as error:
        raise DataError(f"{photograph}: {error}") from error


def _measured(picture: Picture, wedge: CellTarget) -> Tone:
    planes = np.atleast_3d(picture.numbers / picture.white)
    corners = find_target(srgb(planes).mean(axis=2), wedge)
    rows, cols = (
        n // patches for n, patches in zip(wedge.cells.shape, PATCHES, strict=True)
    )
    duty = wedge.cells.reshape(PATCHES[0], rows, PATCHES[1], cols).mean(axis=(1, 3)).ravel()
    seen = [planes[inside] for inside in _insides(corners, planes.shape[:2])]
    _refuse_unusable(seen)
    numbers = np.array([pixels.mean(axis=0) for pixels in seen])
    light, step = np.unique(duty, return_inverse=True)
    curves = [_curve(plane, light, step) for plane in numbers.T]
    levels, stds, uneven = zip(*curves, strict=True)
    tone = Tone(light, np.array(levels), np.array(stds), max(uneven))
    _refuse_falling(tone)
    return tone


def _places() -> Iterator[tuple[float, float]]:
    """Yield (y, x) of each step's middle in the wedge, from 0 to 1."""
    rows, cols = PATCHES
    yield from (
        ((row + 0.5) / rows, (col + 0.5) / cols)
        for row in range(rows)
        for col in range(cols)
    )


def _insides(
    corners: Floats, shape: tuple[int, ...]
) -> Iterator[np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """Yield each step's inner pixels. Raises DataError if they are too few."""
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    from_wedge = cv2.getPerspectiveTransform(
        unit, np.ascontiguousarray(corners[:, ::-1], dtype=np.float32)
    )
    half = INSIDE / 2 / np.array(PATCHES[::-1])
    for y, x in _places():
        quad = cv2.perspectiveTransform(
            ((2 * unit - 1) * half + (x, y)).astype(np.float32)[None], from_wedge
        )[0]
        inside = cv2.fillConvexPoly(
            np.zeros(shape, np.uint8), np.rint(quad).astype(np.int32), 1
        ).astype(np.bool_)
        if (seen := np.count_nonzero(inside)) < LEAST_STEP_PIXELS:
            raise DataError(
                f"a step of the wedge shows {seen} pixels, {LEAST_STEP_PIXELS} are needed: go nearer"
            )
        yield inside


def _refuse_unusable(seen: list[Floats]) -> None:
    """Raise DataError for steps clipped, or whose dots are resolved.

    seen: (pixels, planes) of each step
    """
    clipped = sum(bool((pixels >= 1).mean(axis=0).max() > CLIPPED) for pixels in seen)
    if clipped:
        raise DataError(
            f"{clipped} of the {len(seen)} steps are clipped at full scale: expose less"
        )
    relative, absolute = UNEVEN
    scatter = max(
        float(np.max(pixels.std(axis=0) / (relative * pixels.mean(axis=0) + absolute)))
        for pixels in seen
    )
    if scatter > 1:
        raise DataError(
            f"the steps are no even greys, their pixels scatter {scatter:.1f} times as much as allowed: the half-tone's dots "
            "are resolved, or there is much noise; defocus the lens a little, or take a lower ISO"
        )


def _curve(
    number: Floats, light: Floats, step: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
) -> tuple[Floats, Floats, float]:
    """Return numbers at each step, their standard errors, and the variation of the light.

    The light varies over the wedge by low orders c, such as a lens's fall-off. In even
    light the two places of a step would show one number. Each place is therefore moved
    along the curve to even light, with the c that makes the two places of every step agree.
    number: (places,) of one colour.
    """
    y, x = 2 * np.array(list(_places())).T - 1
    fourth = (x * x + (y * PATCHES[0] / PATCHES[1]) ** 2) ** 2
    orders = np.column_stack((x, y, x * x, x * y, y * y, fourth))
    times = np.bincount(step)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(step, values) / times)

    lit = light[step] > 0
    level = mean(number)
    c = np.zeros(orders.shape[1])
    moved = number
    for _ in range(CURVE_ROUNDS):
        rising = np.maximum.accumulate(level[1:]) + 1e-9 * np.arange(len(level) - 1)
        curve = PchipInterpolator(np.log(light[1:]), rising)
        at = np.log(np.maximum(light[step], light[1]))
        design = np.where(lit, curve.derivative()(at), 0.0)[:, None] * orders
        apart = design - np.column_stack([mean(column)[step] for column in design.T])
        c = c + np.linalg.lstsq(apart, moved - mean(moved)[step], rcond=1e-6)[0]
        moved = number - np.where(lit, curve(at + orders @ c) - curve(at), 0.0)
        level = mean(moved)
    freedom = len(number) - len(light) - orders.shape[1]
    scatter = np.sqrt(np.sum((moved - level[step]) ** 2) / freedom)
    return level, scatter / np.sqrt(times), float(np.ptp(np.exp(orders @ c)))


def _refuse_falling(tone: Tone) -> None:
    """Raise DataError where brighter steps have no larger numbers."""
    for numbers in tone.numbers:
        if (falls := np.flatnonzero(np.diff(numbers) <= 0)).size:
            k = falls[0]
            raise DataError(
                f"the curve does not rise: light of {tone.light[k]:.3f} gives {numbers[k]:.4f} of full scale, "
                f"{tone.light[k + 1]:.3f} gives {numbers[k + 1]:.4f}; is it underexposed, or something in the way?"
            )


def _listed(values: Floats) -> str:
    return f"[{', '.join(f'{value:.6g}' for value in values)}]"
