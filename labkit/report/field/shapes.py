"""Shapes at places of the frame: PSFs, arrows of coma, lines of astigmatism, each with its errors and a scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from labkit.field.surfaces import focus_um
from labkit.figure_style import HALF_IN, INK, SOFT_INK, Ink, round_length
from labkit.optics.field import FieldModel
from labkit.optics.metrics import psf_value
from labkit.report.charts import clear_part
from labkit.report.field.maps import frame_axes
from labkit.report.field.sampled import Grid
from labkit.report.pictures import LEAST_PER_AIRY
from labkit.types import Floats

COMA = (8, 7)
"""Noll's numbers of coma with the cosine and with the sine of the angle."""

SHAPES_ACROSS, STAMPS_ACROSS = 7, 7
LONGEST_ARROW = 0.42
"""Of the step between places: how far the longest arrow reaches."""

FAN = 2 * np.pi * np.arange(24) / 24
STAMP_SAMPLES = 61
PUPILS_ACROSS, PUPIL_SHARE, PUPIL_ARCS = 7, 0.42, 120
"""Pupils over the frame: how many, their radius over the distance of their places, and arcs of an outline."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Two modes at places over the frame.

    channel: name; grid: of the places; waves: (places, 2), with the cosine and with the sine;
    covariance: (places, 2, 2)
    """

    channel: str
    grid: Grid
    waves: Floats
    covariance: Floats

    @classmethod
    def over(cls, model: FieldModel, channel: str, pair: tuple[int, int]) -> Shapes:
        """Return the modes of a pair of Noll's numbers; 0 where they were not fitted."""
        grid = Grid.middles(model.frame, SHAPES_ACROSS)
        waves, covariance = model.modes(channel, grid.each_px)
        pick = np.array([[float(j == n) for n in model.noll] for j in pair])
        return cls(channel, grid, waves @ pick.T, pick @ covariance @ pick.T)


def longest_waves(model: FieldModel, pair: tuple[int, int]) -> float:
    """Return the greatest magnitude of two modes over the frame, of all channels."""
    every = [Shapes.over(model, channel, pair).waves for channel in model.channels]
    return float(np.hypot(*np.concatenate(every).T).max())


def coma_chart(shapes: Shapes, ink: Ink, longest: float) -> Figure:
    """Draw coma as arrows, from the middle of a place, with ellipses of one standard error at their tips.

    longest: coma of the longest arrow, waves
    """
    figure, axes, per_wave = _shapes_axes(shapes, "coma", longest)
    start = shapes.grid.each_mm[:, ::-1]
    rings = per_wave * ellipses(shapes.covariance)
    arrows(axes, start, per_wave * shapes.waves, rings, ink.colour)
    _scale(figure, axes, longest, per_wave)
    return figure


def astigmatism_chart(shapes: Shapes, ink: Ink, longest: float) -> Figure:
    """Draw astigmatism as lines, along the direction of the greatest path difference.

    Faint lines: those of the ellipse of one standard error. longest: of the longest line, waves
    """
    figure, axes, per_wave = _shapes_axes(shapes, "astigmatism", longest)
    centres = shapes.grid.each_mm[:, None, ::-1]
    around = shapes.waves[:, None] + ellipses(shapes.covariance)
    for pairs, width, alpha in ((around, 0.5, 0.25), (shapes.waves[:, None], 1.4, 1.0)):
        half = per_wave * along_lines(pairs)
        ends = np.stack([centres - half, centres + half], axis=2).reshape(-1, 2, 2)
        lines = LineCollection(list(ends), colors=ink.colour, linewidths=width, alpha=alpha)
        axes.add_collection(lines)
    _scale(figure, axes, longest, 2 * per_wave)
    return figure


def along_lines(pairs: Floats) -> Floats:
    """Return half the lines (..., 2) along x and y of astigmatism (..., 2), of its magnitude."""
    size = np.hypot(pairs[..., 0], pairs[..., 1])
    azimuth = np.arctan2(pairs[..., 1], pairs[..., 0]) / 2
    return np.stack([size * np.cos(azimuth), size * np.sin(azimuth)], axis=-1)


def ellipses(covariance: Floats) -> Floats:
    """Return ellipses (places, points, 2) of one standard error, closed."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(values.clip(0))[:, None, :]
    turn = np.append(FAN, FAN[0])
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(circle @ root.swapaxes(-1, -2))


def _shapes_axes(shapes: Shapes, words: str, longest: float) -> tuple[Figure, Axes, float]:
    """Return a figure, its axes, and the millimetres of the frame for a wave."""
    title = f"{shapes.channel}  {words}"
    figure, axes = frame_axes(shapes.grid.frame, HALF_IN, title=title, below_in=0.62)
    return figure, axes, LONGEST_ARROW * shapes.grid.step_mm / (longest or 1.0)


def arrows(axes: Axes, start: Floats, shifts: Floats, rings: Floats, colour: str) -> None:
    """Draw arrows from places, with closed curves about their tips.

    start, shifts: (n, 2), x and y, mm on the frame; rings: (n, points, 2), about the tips
    """
    style = {
        "arrowstyle": "-|>,head_length=0.28,head_width=0.14",
        "color": colour,
        "lw": 1.3,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    tips = start + shifts
    for at, tip in zip(start, tips, strict=True):
        axes.annotate("", tuple(tip), tuple(at), arrowprops=style)
    around = list(tips[:, np.newaxis] + rings)
    axes.add_collection(LineCollection(around, colors=SOFT_INK, linewidths=0.7))
    axes.plot(*start.T, ".", color=INK, ms=1.6)


def _scale(figure: Figure, axes: Axes, longest_waves: float, mm_per_wave: float) -> None:
    """Draw a bar below the frame with a round number of waves."""
    waves = round_length(longest_waves)
    bar(figure, axes, waves * mm_per_wave, f"{waves:g} waves RMS")


def pupils_chart(model: FieldModel) -> Figure:
    """Draw the clear part of the pupil as seen from places over the frame; y down as on the sensor."""
    grid = Grid.middles(model.frame, PUPILS_ACROSS)
    figure, axes = frame_axes(model.frame, HALF_IN, title="pupil")
    for at, (y, x) in zip(grid.each_px, grid.each_mm, strict=True):
        rim = model.rim_at(at)
        mm = PUPIL_SHARE * grid.step_mm / model.rim.middle.outer
        edges = [mm * edge + (x, y) for edge in rim.edges(PUPIL_ARCS)]
        axes.add_patch(clear_part(edges, 0.8))
        axes.add_patch(Circle((x, y), mm * rim.outer, fill=False, ec=SOFT_INK, lw=0.6))
    return figure


def bar(figure: Figure, axes: Axes, length_mm: float, words: str) -> None:
    """Draw a bar of a length on the frame below it, and say what it stands for."""
    at = 0.14 / figure.get_size_inches()[1]
    box = axes.get_position()
    right = box.x0 + length_mm / float(np.ptp(axes.get_xlim())) * box.width
    figure.add_artist(
        Line2D([box.x0, right], [at, at], color=INK, lw=2, solid_capstyle="butt")
    )
    figure.text(right + 0.015, at, words, va="center", fontsize=8)


def stamp_half_width_um(model: FieldModel, channels: Sequence[str]) -> float:
    """Return half the side of squares with room for the PSFs of all places and channels."""
    widest = 0.0
    for channel in channels:
        grid = Grid.middles(model.frame, STAMPS_ACROSS)
        focus = np.abs(focus_um(model, channel, grid.places_px)[0]).max()
        airy_um = (
            1e-3 * model.wavelengths_nm[model.channels.index(channel)] * model.f_number
        )
        widest = max(widest, 1.25 * focus / (2 * model.f_number) + 4 * airy_um)
    return float(widest)


def stamps_of(
    model: FieldModel, channel: str, half_width_um: float
) -> tuple[Grid, list[Floats]]:
    """Return the PSFs (size, size) over the frame, of equal light each."""
    grid = Grid.middles(model.frame, STAMPS_ACROSS)
    airy_um = 1e-3 * model.wavelengths_nm[model.channels.index(channel)] * model.f_number
    spacing_um = min(2 * half_width_um / STAMP_SAMPLES, airy_um / LEAST_PER_AIRY)
    size = 2 * ceil(half_width_um / spacing_um) + 1
    places = grid.each_px
    return grid, [
        psf_value(model.wavefront(channel, at), spacing_um, size) / spacing_um**2
        for at in places
    ]


def stamps_chart(model: FieldModel, channel: str, ink: Ink, half_width_um: float) -> Figure:
    """Draw the PSFs over the frame as squares at their places, on one scale of light and of length."""
    grid, stamps = stamps_of(model, channel, half_width_um)
    peak = max(float(stamp.max()) for stamp in stamps)
    title = f"{channel}  PSF"
    figure, axes = frame_axes(model.frame, HALF_IN, title=title, below_in=0.62)
    limits = axes.get_xlim(), axes.get_ylim()
    half_mm = 0.49 * grid.step_mm
    norm = PowerNorm(0.5, 0, peak, clip=True)
    for (y, x), stamp in zip(grid.each_mm, stamps, strict=True):
        edges = (x - half_mm, x + half_mm, y + half_mm, y - half_mm)
        axes.imshow(stamp, cmap=ink.ramp, norm=norm, extent=edges, interpolation="nearest")
    axes.set(xlim=limits[0], ylim=limits[1])
    length_um = round_length(half_width_um)
    bar(
        figure,
        axes,
        half_mm * length_um / half_width_um,
        f"{length_um:g} µm in each square",
    )
    return figure
