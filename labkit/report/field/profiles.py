"""Charts along lines through the centre of the frame, and through focus: sagittal and tangential, with errors."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, degrees
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from labkit.field.curves import Profile
from labkit.field.focus_curves import FocusCurve
from labkit.field.places import field_points
from labkit.figure_style import (
    DASHED,
    HALF_IN,
    INK,
    SOFT_INK,
    SOLID,
    Ink,
    banded,
    chart,
)
from labkit.optics.field import FieldFrame
from labkit.types import Floats

ROOM = 0.06
"""Of an axis of focus, above and below the surfaces, in heights of what is drawn."""

LABEL_STEP = 0.062
"""Height of a line of text on an axis of MTF."""

FIELD_POINT = 0.85
"""Of the way from the centre to the frame's edge: where through-focus curves are drawn."""

Side = Literal["sagittal", "tangential"]
SIDES: tuple[Side, ...] = ("sagittal", "tangential")


def lines_of(frame: FieldFrame) -> dict[float, str]:
    """Return the azimuths of four lines through the centre, rows, columns and both diagonals, and their names."""
    diagonal = degrees(atan2(*frame.shape_px))
    return {
        0.0: "left to right",
        90.0: "top to bottom",
        diagonal: "top left to bottom right",
        180.0 - diagonal: "top right to bottom left",
    }


def file_key(words: str) -> str:
    """Return the name of a line as a part of a file's name."""
    return words.replace(" ", "-")


def inner_points(frame: FieldFrame) -> dict[str, Floats]:
    """Return nine places by name, within the frame: the centre, and most of the way to the edges and corners."""
    centre = frame.centre_px
    return {
        name: centre + FIELD_POINT * (at - centre)
        for name, at in field_points(frame).items()
    }


def surfaces_chart(
    pair: Sequence[Profile], frame: FieldFrame, ink: Ink, limits_um: tuple[float, float]
) -> Figure:
    """Draw how far the sensor is behind the sagittal and the tangential image along a line."""
    figure, axes = _line_axes(pair[0], frame)
    for profile in pair:
        colour, line = _style(profile.surface, ink)
        focus = profile.focus_um
        banded(axes, profile.height_mm, focus.value, focus.std, colour, line)
    axes.axhline(0, color=SOFT_INK, lw=0.7)
    axes.set(ylim=limits_um, ylabel="focus error of the sensor, µm")
    _legend(figure, ink)
    return figure


def limits_um(profiles: Sequence[Profile]) -> tuple[float, float]:
    """Return the limits of an axis with room for all surfaces, their errors, and zero."""
    low = min(float(np.min(p.focus_um.value - p.focus_um.std)) for p in profiles)
    high = max(float(np.max(p.focus_um.value + p.focus_um.std)) for p in profiles)
    low, high = min(low, 0.0), max(high, 0.0)
    room = ROOM * (high - low) or 1.0
    return low - room, high + room


def height_chart(pair: Sequence[Profile], frame: FieldFrame, ink: Ink) -> Figure:
    """Draw the MTF of the optics along a line, a curve for each frequency."""
    figure, axes = _line_axes(pair[0], frame, right=0.42)
    for profile in pair:
        colour, line = _style(profile.surface, ink)
        for value, std in zip(profile.mtf.value, profile.mtf.std, strict=True):
            banded(axes, profile.height_mm, value, std, colour, line)
    ends = np.mean([profile.mtf.value[:, -1] for profile in pair], axis=0)
    for frequency, y in zip(pair[0].frequency_per_mm, _apart(ends), strict=True):
        axes.annotate(
            f"{frequency:g}",
            (pair[0].height_mm[-1], y),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            annotation_clip=False,
        )
    axes.set(ylim=(0, 1), ylabel="MTF of the optics")
    _legend(figure, ink)
    return figure


def _apart(values: Floats) -> Floats:
    """Return places of labels near values that fall, none nearer to the next than a line of text."""
    places = np.array(values, float)
    for k in range(1, len(places)):
        places[k] = min(places[k], places[k - 1] - LABEL_STEP)
    return places


def _line_axes(
    profile: Profile, frame: FieldFrame, right: float = 0.12
) -> tuple[Figure, Axes]:
    figure, axes = chart(HALF_IN, 2.7, top=0.5, right=right)
    words = lines_of(frame)[profile.azimuth_deg]
    figure.text(0.02, 0.955, words, fontweight="bold", fontsize=9, va="center")
    axes.set(xlim=(-frame.radius_mm, frame.radius_mm), xlabel="image height, mm")
    axes.axvline(0, color=SOFT_INK, lw=0.7)
    return figure, axes


def _style(surface: str, ink: Ink) -> tuple[str, Any]:
    """Return the colour and the dashes of a direction."""
    return (ink.colour, SOLID) if surface == "sagittal" else (INK, DASHED)


def _legend(figure: Figure, ink: Ink) -> None:
    handles = []
    for side in SIDES:
        colour, line = _style(side, ink)
        handles.append(Line2D([], [], color=colour, ls=line, label=side))
    figure.legend(
        handles=handles,
        loc="upper right",
        ncols=2,
        borderpad=0.2,
        handlelength=2.2,
        columnspacing=1.2,
    )


def through_chart(curves: Sequence[FocusCurve], frame: FieldFrame, ink: Ink) -> Figure:
    """Draw the MTF against a movement of the sensor at nine places, each panel where its place is in the frame."""
    figure = Figure(figsize=(HALF_IN, 3.7))
    panels = figure.subplots(3, 3, sharex=True, sharey=True)
    figure.subplots_adjust(0.11, 0.125, 0.985, 0.865, 0.09, 0.12)
    for name, place in inner_points(frame).items():
        row, column = np.sign(np.round(place - frame.centre_px)).astype(int) + 1
        axes = panels[row, column]
        for curve in (c for c in curves if c.place == name):
            colour, line = _style(curve.surface, ink)
            band = curve.mtf
            banded(axes, curve.shift_um, band.value, band.std, colour, line, lw=1.1)
        axes.axvline(0, color=SOFT_INK, lw=0.7)
        axes.tick_params(labelsize=7.5)
    first = curves[0]
    ends = (first.shift_um[0], first.shift_um[-1])
    panels[0, 0].set(ylim=(0, 1), yticks=(0, 0.5, 1), xlim=ends)
    # numbers at the ends of neighbouring panels would touch
    panels[0, 0].xaxis.set_major_locator(MaxNLocator(3, prune="both"))
    title = f"{first.channel}  {first.frequency_per_mm:g} cycles/mm"
    figure.text(0.02, 0.955, title, fontweight="bold", fontsize=9, va="center")
    figure.text(0.55, 0.02, "the sensor moved away from the lens, µm", ha="center")
    figure.text(0.005, 0.5, "MTF", rotation=90, va="center")
    _legend(figure, ink)
    return figure
