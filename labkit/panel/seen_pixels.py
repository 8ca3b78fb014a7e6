"""Detect a panel's own pixels in photographs, with their pitch and the layout of their colours.

A target's cell is a whole number of panel pixels, and the pattern of a pixel repeats at the pixels' pitch. Each number of
pixels per cell has a frequency of its own, which is searched for, aliased if need be, in the white at the target's middle, or
in all white areas of a tile that does not show the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import cv2
import numpy as np

from labkit.errors import PlanError
from labkit.findings.findings import Finding, found
from labkit.panel.stripe_contrast import LEAST_STRIPE_CONTRAST
from labkit.plan import TargetPixels
from labkit.plan.plan import COLOUR_WORDS
from labkit.target.target import CellTarget, Target
from labkit.types import Bools, Complexes, Floats

SEARCHED_MIDDLE = 0.4
"""Extent of the searched white from the target's middle, as a share of the target's half side."""

RIM_PX = 4
"""Width of the rim of white areas left out, for edges are blurred."""

LEAST_WHITE_PIXELS = 100
"""Least number of a channel's pixels in the white."""

FREQUENCY_ERROR = 0.01
"""Relative error of a frequency, for the target's corners are known to a pixel."""

FASTEST = 1.1
"""Highest frequency, cycles per pixel, that the camera's pixels pass."""

PLAIN_CONTRAST = 0.03
"""Contrast above which a pattern contradicts the plan, and every fit without the pattern would be wrong."""

BEYOND_NOISE = 8.0
"""Least amplitude of a pattern, in standard errors."""

NEARLY = 0.85
"""Share of the strongest amplitude: a pattern as strong with fewer pixels per cell is the true one, the other its alias."""

ABSENT = 0.5
"""Share of the strongest amplitude below which the plan's pattern is absent."""


@dataclass(frozen=True)
class SeenPixels:
    """A panel's pixels detected in photographs.

    Attributes
    ----------
    pitch_mm : pitch of the pixels
    per_cell : pixels per cell of the target
    layout : layout as in `TargetPixels`; None if the colours do not determine it
    contrast : amplitude of the pattern relative to white
    others : (2, n) amplitudes of all tested patterns, by axis and pixels per cell less 1
    """

    pitch_mm: float
    per_cell: int
    layout: str | None
    contrast: float
    others: Floats

    def __str__(self) -> str:
        layout = "" if self.layout is None else f', layout = "{self.layout}"'
        return f"pixels = {{ pitch_mm = {self.pitch_mm:.4g}{layout} }}"

    @property
    def finding(self) -> Finding:
        """Finding for a plan that does not state the pixels."""
        return found(
            "panel-pixels-seen",
            None,
            {"to_add": str(self)},
            pitch_mm=self.pitch_mm,
            per_cell=self.per_cell,
            layout=self.layout,
            contrast=self.contrast,
        )


def refuse_other_pixels(stated: TargetPixels, per_cell: int, seen: SeenPixels) -> None:
    """Refuse a plan whose panel contradicts the photographs.

    Parameters
    ----------
    stated : the plan's panel
    per_cell : pixels per cell by the plan
    seen : the detected panel

    Raises
    ------
    PlanError : the photographs clearly show another pitch or layout
    """
    along = seen.others[0 if stated.layout.endswith("rows") else 1]
    there = float(along[per_cell - 1]) if per_cell <= along.size else 0.0
    another = there < ABSENT * seen.contrast
    reversed_ = seen.per_cell == per_cell and seen.layout not in (None, stated.layout)
    if (another or reversed_) and seen.contrast > PLAIN_CONTRAST:
        pitch = "" if stated.pitch_mm is None else f"pitch_mm = {stated.pitch_mm:g}, "
        raise PlanError(
            f'[target.pixels] {pitch}layout = "{stated.layout}": the photographs show another panel\'s stripes; '
            f"by them it is {seen}"
        )


@dataclass(frozen=True, eq=False)
class TargetView:
    """A photograph of the target in one colour.

    Attributes
    ----------
    range_mm, channel : range and colour
    light : (rows, columns) counts over illumination
    used : (rows, columns), True for usable pixels of the channel
    to_pixels : (3, 3) homography from (y, x, 1), in half sides of the target, to (row, column, 1)
    """

    range_mm: float | None
    channel: str
    light: Floats
    used: Bools
    to_pixels: Floats


def seen_pixels(views: Sequence[TargetView], target: Target) -> SeenPixels | None:
    """Detect a panel's pixels in all photographs together.

    Returns
    -------
    None if no pixels are detected, or if the target has no cells
    """
    if not isinstance(target, CellTarget):
        return None
    found = [_waves(view, target) for view in views]
    most = min((waves.shape[1] for waves, _ in found), default=0)
    if not most:
        return None
    strengths = np.sqrt(
        np.mean([np.abs(waves[:, :most]) ** 2 for waves, _ in found], axis=0)
    )
    noise = float(np.sqrt(np.mean([std**2 for _, std in found]) / len(found)))
    axis = int(np.argmax(strengths.max(axis=1)))
    number = int(np.argmax(strengths[axis] > NEARLY * strengths[axis].max()))
    contrast = float(strengths[axis, number])
    if contrast < max(LEAST_STRIPE_CONTRAST, BEYOND_NOISE * noise):
        return None
    phases = [
        (view.range_mm, view.channel, waves[axis, number])
        for view, (waves, _) in zip(views, found, strict=True)
    ]
    return SeenPixels(
        target.cell_mm[axis] / (number + 1),
        number + 1,
        _layout(phases, axis),
        contrast,
        strengths,
    )


def _layout(waves: Sequence[tuple[float | None, str, complex]], axis: int) -> str | None:
    """Return the layout by the shift between the patterns of two colours at the same range: a third of a pixel, either way."""
    turn = 0j
    for _, group in groupby(waves, key=lambda of: of[0]):
        colours = {COLOUR_WORDS.get(name.lower()): wave for _, name, wave in group}
        pairs = [
            (a, b) for a, b in (("R", "G"), ("G", "B")) if a in colours and b in colours
        ]
        turn += sum(complex(colours[b] * np.conj(colours[a])) for a, b in pairs)
    if not turn:
        return None
    order = "rgb" if np.angle(turn) < 0 else "bgr"
    return f"{order}-{'rows' if axis == 0 else 'stripes'}"


def _waves(view: TargetView, target: CellTarget) -> tuple[Complexes, float]:
    """Measure patterns of 1 to n pixels per cell, along rows and columns of the target.

    Returns
    -------
    amplitudes (2, n) relative to white; standard error of an amplitude
    """
    down, right = (np.asarray(index, float) for index in np.indices(view.light.shape))
    to_target = np.linalg.inv(view.to_pixels)
    y, x, w = (a * down + b * right + c for a, b, c in to_target)
    middle = (np.abs(y / w) < SEARCHED_MIDDLE) & (np.abs(x / w) < SEARCHED_MIDDLE)
    white = _white(target, y / w, x / w) & view.used
    if (white & middle).sum() >= LEAST_WHITE_PIXELS:  # a tile does not show the middle
        white &= middle
    per_unit = view.to_pixels[:2, :2] - np.outer(
        view.to_pixels[:2, 2], view.to_pixels[2, :2]
    )
    per_px = np.array(target.cells.shape) / (2 * np.hypot(*per_unit))  # cells at the middle
    most = int(FASTEST / per_px.max())
    if white.sum() < LEAST_WHITE_PIXELS or not most:
        return np.zeros((2, 0), complex), 0.0
    at = np.array([index[white].mean() for index in (down, right)])
    y, x = (index[white] - mean for index, mean in zip((down, right), at, strict=True))
    trend = np.stack([np.ones(y.size), y, x, y * x, y**2, x**2], axis=1)
    values = view.light[white]
    smooth = trend @ np.linalg.lstsq(trend, values, rcond=None)[0]
    picture = np.zeros(view.light.shape)
    picture[white] = values / smooth - 1
    # cycles a pixel of the frame for one cycle to a cell, along the target's axes at the middle of the white
    *on_target, scale = to_target @ np.append(at, 1.0)
    waves = np.zeros((2, most), complex)
    extent = max(np.ptp(y), np.ptp(x))
    for axis, cells in enumerate(target.cells.shape):
        slope = to_target[axis, :2] - on_target[axis] / scale * to_target[2, :2]
        gradient = slope / scale * cells / 2
        for k in range(1, most + 1):
            waves[axis, k - 1] = _strongest(picture, k * gradient, extent, int(white.sum()))
    return waves, float(np.std(picture[white]) * np.sqrt(2 / white.sum()))


def _white(target: CellTarget, y: Floats, x: Floats) -> Bools:
    """Mark pixels, by their unit coordinates, that lie in white areas of the target."""
    half = np.array(target.size_mm) / 2
    inside = (np.abs(y) < 1) & (np.abs(x) < 1)
    white = (target.radiance(y * half[0], x * half[1]) > 0.99 * target.cells.max()) & inside
    return np.asarray(
        cv2.erode(white.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0
    )


def _strongest(picture: Floats, frequency: Floats, extent: float, pixels: int) -> complex:
    """Return the largest amplitude near a frequency (2,), cycles per pixel."""
    reach = FREQUENCY_ERROR * float(np.hypot(*frequency))
    near = np.linspace(-reach, reach, 2 * int(np.ceil(2 * extent * reach)) + 1)
    down, right = (
        np.exp(-2j * np.pi * np.outer(f + near, np.arange(n)))
        for f, n in zip(frequency, picture.shape, strict=True)
    )
    amplitudes = 2 / pixels * (down @ picture @ right.T)
    return complex(amplitudes.ravel()[int(np.argmax(np.abs(amplitudes)))])
