"""Whether photographs show the own pixels of a panel, how large they are, and how their colours lie.

A target's cell is a whole number of panel pixels, and a pixel's pattern repeats from one to the next: in the white at the
target's middle each such number has a frequency of its own, which is looked for there, aliased as it may be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import cv2
import numpy as np

from labkit.errors import PlanError
from labkit.estimation.observation import Observation
from labkit.finding import Finding
from labkit.findings import found
from labkit.panel.stripe_contrast import LEAST_CONTRAST
from labkit.plan import TargetPixels
from labkit.plan.plan import COLOUR_WORDS
from labkit.target import CellTarget, Target
from labkit.types import Bools, Complexes, Floats

MIDDLE = 0.4
"""Of the target's half side: as far from its middle white is looked at."""

RIM_PX = 4
"""What is left out of white along its edges, which are blurred."""

LEAST_PIXELS = 100
"""Of a channel, in that white."""

STRAY = 0.01
"""Relative: as much a frequency may be off, the target's corners being known to a pixel."""

FASTEST = 1.1
"""Cycles a pixel: what is faster the pixels themselves do not pass."""

PLAIN_CONTRAST = 0.03
"""From where on a pattern contradicts what a plan states, and no fit without it could be right."""

BEYOND_NOISE = 8.0
"""Standard errors of an amplitude."""

NEARLY = 0.85
"""Of the strongest pattern: one as strong with fewer pixels to a cell is the true one, the sensor aliases the other to it."""

ABSENT = 0.5
"""Of the strongest: what a plan states is contradicted where it has less."""


@dataclass(frozen=True)
class SeenPixels:
    """A panel's pixels as photographs show them. per_cell: to a cell of the target; layout: of `TargetPixels`, None where the
    colours do not say; contrast: amplitude of the pattern, of white; others: the same by (axis, pixels to a cell less 1)."""

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
        """What a plan that lacks these pixels should state."""
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
    """Raise PlanError where photographs plainly show a panel of another pitch or layout than the plan states.

    per_cell: as many pixels as a cell has by the plan.
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


def seen_pixels(observations: Sequence[Observation], target: Target) -> SeenPixels | None:
    """What all observations together show of the pixels of a panel; None where none are seen, or the target has no cells."""
    if not isinstance(target, CellTarget):
        return None
    found = [_waves(o, target) for o in observations]
    most = min((waves.shape[1] for waves, _ in found), default=0)
    if not most:
        return None
    strengths = np.sqrt(np.mean([np.abs(waves[:, :most]) ** 2 for waves, _ in found], axis=0))
    noise = float(np.sqrt(np.mean([std**2 for _, std in found]) / len(found)))
    axis = int(np.argmax(strengths.max(axis=1)))
    number = int(np.argmax(strengths[axis] > NEARLY * strengths[axis].max()))
    contrast = float(strengths[axis, number])
    if contrast < max(LEAST_CONTRAST, BEYOND_NOISE * noise):
        return None
    phases = [(o.range_mm, o.channel, waves[axis, number]) for o, (waves, _) in zip(observations, found, strict=True)]
    return SeenPixels(target.cell_mm[axis] / (number + 1), number + 1, _layout(phases, axis), contrast, strengths)


def _layout(waves: Sequence[tuple[float | None, str, complex]], axis: int) -> str | None:
    """From how far one colour's pattern lies from the next one's, at the same ranges: a third of a pixel, either way."""
    turn = 0j
    for _, group in groupby(waves, key=lambda of: of[0]):
        colours = {COLOUR_WORDS.get(name.lower()): wave for _, name, wave in group}
        pairs = [(a, b) for a, b in (("R", "G"), ("G", "B")) if a in colours and b in colours]
        turn += sum(complex(colours[b] * np.conj(colours[a])) for a, b in pairs)
    if not turn:
        return None
    order = "rgb" if np.angle(turn) < 0 else "bgr"
    return f"{order}-{'rows' if axis == 0 else 'stripes'}"


def _waves(o: Observation, target: CellTarget) -> tuple[Complexes, float]:
    """Amplitudes (2, n) of the patterns of 1 to n pixels to a cell, along rows and columns of the target, in an observation's
    first frame, relative to white; and the standard error of one."""
    frame, pose = o.frames[0], o.poses[0]
    down, right = (np.asarray(index, float) for index in np.indices(frame.counts.shape))
    white = _white(target, *pose.to_target(down, right)) & frame.used
    rows, cols = pose.pixel_per_unit()
    per_px = [n / (2 * scale) for n, scale in zip(target.cells.shape, (rows, cols), strict=True)]  # cells
    most = int(FASTEST / max(per_px))
    if white.sum() < LEAST_PIXELS or not most:
        return np.zeros((2, 0), complex), 0.0
    light = frame.counts / frame.illumination
    y, x = (index[white] - index[white].mean() for index in (down, right))
    trend = np.stack([np.ones(y.size), y, x, y * x, y**2, x**2], axis=1)
    values = light[white]
    smooth = trend @ np.linalg.lstsq(trend, values, rcond=None)[0]
    picture = np.zeros(frame.counts.shape)
    picture[white] = values / smooth - 1
    # cycles a pixel of the frame for one cycle to a cell, along the target's axes at its middle
    to_target = np.linalg.inv(pose.matrix)
    middle = np.linalg.solve(to_target, np.array([0.0, 0.0, 1.0]))
    middle = middle / middle[2]
    scale = float(to_target[2] @ middle)
    waves = np.zeros((2, most), complex)
    extent = max(np.ptp(y), np.ptp(x))
    for axis, cells in enumerate(target.cells.shape):
        gradient = to_target[axis, :2] / scale * cells / 2
        for k in range(1, most + 1):
            waves[axis, k - 1] = _strongest(picture, k * gradient, extent, int(white.sum()))
    return waves, float(np.std(picture[white]) * np.sqrt(2 / white.sum()))


def _white(target: CellTarget, y: Floats, x: Floats) -> Bools:
    """Pixels at unit coordinates in the middle of the target that see nothing but white."""
    half = np.array(target.size_mm) / 2
    inside = (np.abs(y) < MIDDLE) & (np.abs(x) < MIDDLE)
    white = (target.radiance(y * half[0], x * half[1]) > 0.99 * target.cells.max()) & inside
    return np.asarray(cv2.erode(white.astype(np.uint8), np.ones((2 * RIM_PX + 1,) * 2, np.uint8)) > 0)


def _strongest(picture: Floats, frequency: Floats, extent: float, pixels: int) -> complex:
    """The largest amplitude near a frequency (2,), cycles a pixel."""
    reach = STRAY * float(np.hypot(*frequency))
    near = np.linspace(-reach, reach, 2 * int(np.ceil(2 * extent * reach)) + 1)
    down, right = (
        np.exp(-2j * np.pi * np.outer(f + near, np.arange(n))) for f, n in zip(frequency, picture.shape, strict=True)
    )
    amplitudes = 2 / pixels * (down @ picture @ right.T)
    return complex(amplitudes.ravel()[int(np.argmax(np.abs(amplitudes)))])
