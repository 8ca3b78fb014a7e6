"""Figures of a chart: responses by image height, S and T, on four lines through the centre, and maps over the frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from labkit.edges.outcome import Backdrop
from labkit.figure_style import INK, SOFT_INK, WIDTH_IN, banded
from labkit.optics.field import FieldFrame
from labkit.plan import leading_channel
from labkit.types import Floats
from labkit.uncertain import Uncertain

if TYPE_CHECKING:
    from labkit.charts.focal_surface import FocalSurface, PlaceFocus
    from labkit.charts.outcome import ChartEdge, ChartOutcome, ChartPlace

LINES = {
    0: "left (−) to right (+)",
    45: "upper left (−) to lower right (+)",
    90: "top (−) to bottom (+)",
    135: "upper right (−) to lower left (+)",
}
"""Lines through the centre by the azimuth of their positive end, degrees from right towards down."""

NEAREST_DEG = 22.5
LEVEL_COLOURS = {10.0: "#0072b2", 20.0: "#009e73", 40.0: "#d55e00"}
KIND_MARKS = {"T": ("o", "white"), "S": ("s", None), "O": ("x", None), "C": ("+", None)}
KIND_NAMES = {
    "S": "S: edge along the radius",
    "T": "T: edge across the radius",
    "O": "neither: 45° to the radius",
    "C": "centre",
}
FOCUS_MARKS = {"medial": ("#1c1e21", "D"), "S": ("#0072b2", "s"), "T": ("#d55e00", "o")}
PANEL_IN = 2.1
LINE_POINTS = 60
HEIGHT_BINS = 8
DIRECTIONS = {"S": ("-", "s"), "T": ("--", "o")}
NEAR_STEPS = (
    0.6  # of the distance of neighbouring places: from a line to the places that it shows
)
MAP_RAMP = "viridis"
EDGE_PT, EDGE_RIM_PT = 3.0, 4.6


def draw_figures(outcome: ChartOutcome, backdrop: Backdrop) -> dict[str, Figure]:
    """Return the figures by name. backdrop: the sharpest photograph."""
    name = leading_channel(outcome.channels)
    edges = [
        edge
        for edge in outcome.edges
        if edge.channel == name and edge.of.photograph == outcome.sharpest
    ]
    places = [
        place
        for place in outcome.places
        if place.fit.channel == name
        and place.edges
        and place.edges[0].of.photograph == outcome.sharpest
    ]
    figures = {
        "mtf": _by_height(places),
        "profiles": _profiles(edges),
        "map": _map(edges, backdrop),
    }
    if surfaces := outcome.surfaces.get(name):
        figures["focus"] = _focus(outcome.foci[name], surfaces)
        figures["surface"] = _surface(outcome.foci[name], surfaces["medial"], outcome.frame)
    return figures


def _by_height(places: Sequence[ChartPlace]) -> Figure:
    """Draw S and T at each frequency against image height, as of lens tests: places, and their means by height."""
    figure = Figure(figsize=(WIDTH_IN, 2 * PANEL_IN), layout="constrained")
    axes = figure.subplots()
    for kind, (style, marker) in DIRECTIONS.items():
        known = [place for place in places if place.known(kind)]
        height = np.array([np.hypot(*place.height_mm) for place in known])
        for level, colour in LEVEL_COLOURS.items():
            values = np.array([place.responses[kind].at(level).value for place in known])
            face = colour if kind == "S" else "white"
            axes.plot(height, values, marker, color=colour, mfc=face, ms=2.5, alpha=0.5)
            axes.plot(*_means(height, values), style, color=colour, lw=1.6)
    axes.set(xlabel="image height, mm", ylabel="MTF", ylim=(0, 1), xlim=(0, None))
    handles = [
        axes.plot([], [], style, marker=marker, color=INK, label=KIND_NAMES[kind])[0]
        for kind, (style, marker) in DIRECTIONS.items()
    ]
    handles += [
        axes.plot([], [], color=colour, label=f"{level:g} cycles/mm")[0]
        for level, colour in LEVEL_COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _means(height: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return mean heights and values of bins of equal width; of single places where there are few."""
    if not height.size:
        return height, values
    ends = np.linspace(0, height.max() * (1 + 1e-9), HEIGHT_BINS + 1)
    bins = np.digitize(height, ends)
    each = [bins == k for k in np.unique(bins)]
    return (
        np.array([height[of].mean() for of in each]),
        np.array([values[of].mean() for of in each]),
    )


def _surface(
    foci: Sequence[PlaceFocus], surface: FocalSurface, frame: FieldFrame
) -> Figure:
    """Draw medial focus over the frame: places, and the surface through them as lines of equal focus error."""
    half = np.abs(frame.heights_mm([0, 0]))
    figure = Figure(
        figsize=(WIDTH_IN, WIDTH_IN * 0.86 * half[0] / half[1] + 0.8), layout="constrained"
    )
    axes = figure.subplots()
    y, x = (np.linspace(-of, of, LINE_POINTS) for of in half)
    grid = np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1).reshape(-1, 2)
    medial = surface.at(grid)[0].reshape(LINE_POINTS, LINE_POINTS)
    value = np.array([of.of("medial").value for of in foci])
    every = np.append(medial, value)
    limits = {"vmin": every.min(), "vmax": every.max()}
    filled = axes.contourf(x, y, medial, 40, cmap=MAP_RAMP, **limits)
    lines = axes.contour(x, y, medial, 8, colors="white", linewidths=0.7)
    axes.clabel(lines, fmt="%g", fontsize="small")
    at = np.array([of.height_mm for of in foci])
    axes.scatter(at[:, 1], at[:, 0], c=value, cmap=MAP_RAMP, edgecolors="white", **limits)
    axes.grid(False)
    axes.set(
        xlabel="to the right, mm",
        ylabel="down, mm",
        ylim=(half[0], -half[0]),
        aspect="equal",
        title="medial focus: places, and the surface through them",
    )
    figure.colorbar(
        filled,
        ax=axes,
        label="sensor behind the image, µm",
        shrink=0.85,
        ticks=lines.levels,
    )
    return figure


def _profiles(edges: list[ChartEdge]) -> Figure:
    """Draw responses against signed image height: a row for each line through the centre, never folded."""
    figure = Figure(figsize=(WIDTH_IN, len(LINES) * PANEL_IN + 0.7), layout="constrained")
    axes = figure.subplots(len(LINES), 2, sharex=True, sharey="col")
    for (azimuth, words), (left, right) in zip(LINES.items(), axes, strict=True):
        on_line = [edge for edge in edges if _is_on(edge, azimuth)]
        left.set_title(words)
        left.set_ylabel("MTF50, cycles/mm")
        right.set_ylabel("MTF")
        for kind, (marker, face) in KIND_MARKS.items():
            of_kind = [edge for edge in on_line if edge.kind == kind]
            fitted = [edge.of.fitted for edge in of_kind]
            height = [_signed_mm(edge.height_mm, azimuth) for edge in of_kind]
            _marks(left, height, [of.mtf50 for of in fitted], INK, marker, face)
            for level, colour in LEVEL_COLOURS.items():
                _marks(right, height, [of.at(level) for of in fitted], colour, marker, face)
        right.set_ylim(0, 1)
        for each in (left, right):
            each.axvline(0, color=SOFT_INK, lw=0.6)
    for each in axes[-1]:
        each.set_xlabel("image height, mm")
    _legend(figure, axes[0, 1])
    return figure


def _legend(figure: Figure, axes: Axes) -> None:
    """Explain marks and colours above all panels."""
    handles: list[Any] = [
        axes.errorbar(
            [], [], fmt=marker, color=INK, mfc=face or INK, ms=4, label=KIND_NAMES[kind]
        )
        for kind, (marker, face) in KIND_MARKS.items()
    ]
    handles += [
        axes.plot([], [], color=colour, label=f"at {level:g} cycles/mm")[0]
        for level, colour in LEVEL_COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)


def _marks(
    axes: Axes,
    height: list[float],
    values: list[Uncertain],
    colour: str,
    marker: str,
    face: str | None,
) -> None:
    """Draw values with their errors."""
    axes.errorbar(
        height,
        [of.value for of in values],
        [of.std for of in values],
        fmt=marker,
        color=colour,
        mfc=face or colour,
        ms=4,
        elinewidth=0.8,
    )


def _focus(foci: Sequence[PlaceFocus], surfaces: Mapping[str, FocalSurface]) -> Figure:
    """Draw S, T and medial focus, and their surfaces, against signed image height on the lines through the centre."""
    figure = Figure(figsize=(WIDTH_IN, 2 * PANEL_IN + 1.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    reach_mm = NEAR_STEPS * _step_mm(foci)
    for (azimuth, words), panel in zip(LINES.items(), axes.ravel(), strict=True):
        panel.set_title(words)
        panel.axvline(0, color=SOFT_INK, lw=0.6)
        on_line = sorted(
            (_signed_mm(of.height_mm, azimuth), k)
            for k, of in enumerate(foci)
            if _off_line_mm(of.height_mm, azimuth) <= reach_mm
        )
        ends = [mm for mm, _ in on_line] or [0.0]
        height = np.linspace(min(*ends, 0.0), max(*ends, 0.0), LINE_POINTS)
        radians = np.radians(azimuth)
        places = np.outer(height, [np.sin(radians), np.cos(radians)])
        for kind, (colour, marker) in FOCUS_MARKS.items():
            known = [(mm, foci[k].of(kind)) for mm, k in on_line]
            known = [(mm, of) for mm, of in known if np.isfinite(of.value)]
            if kind in surfaces:
                banded(panel, height, *surfaces[kind].at(places), colour)
            _marks(
                panel,
                [mm for mm, _ in known],
                [of for _, of in known],
                colour,
                marker,
                None,
            )
    for panel in axes[:, 0]:
        panel.set_ylabel("sensor behind the image, µm")
    for panel in axes[-1]:
        panel.set_xlabel("image height, mm")
    handles = [
        panel.errorbar([], [], fmt=marker, color=colour, ms=4, label=f"{kind} focus")
        for kind, (colour, marker) in FOCUS_MARKS.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _step_mm(foci: Sequence[PlaceFocus]) -> float:
    """Return the median distance of a place from the nearest other one."""
    at = np.array([of.height_mm for of in foci])
    away = np.hypot(*(at[:, None] - at).T)
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(axis=0)))


def _off_line_mm(height_mm: Floats, azimuth: int) -> float:
    """Return the distance of a place from a line through the centre."""
    y, x = height_mm
    return float(abs(y * np.cos(np.radians(azimuth)) - x * np.sin(np.radians(azimuth))))


def _is_on(edge: ChartEdge, azimuth: int) -> bool:
    """Return whether a line is the nearest to an edge's place; edges about the centre are on all."""
    return edge.kind == "C" or _is_near(edge.height_mm, azimuth)


def _is_near(height_mm: Floats, azimuth: int) -> bool:
    """Return whether a line is the nearest to a place."""
    of = np.degrees(np.arctan2(*height_mm)) - azimuth
    return bool(abs((of + 90) % 180 - 90) <= NEAREST_DEG)


def _signed_mm(height_mm: Floats, azimuth: int) -> float:
    """Return an image height, negative before the centre on a line."""
    y, x = height_mm
    along = x * np.cos(np.radians(azimuth)) + y * np.sin(np.radians(azimuth))
    return float(np.copysign(np.hypot(y, x), along))


def _map(edges: list[ChartEdge], backdrop: Backdrop) -> Figure:
    """Draw each edge in the colour of its MTF50 over the photograph."""
    figure = Figure(
        figsize=(WIDTH_IN, WIDTH_IN * 0.86 * backdrop.tallness + 0.8), layout="constrained"
    )
    axes = figure.subplots()
    grey = np.sqrt(backdrop.grey.clip(0, 1))
    axes.imshow(grey, cmap="gray", vmin=-0.5, vmax=1.3, extent=backdrop.extent_px)
    axes.grid(False)
    axes.set(
        xlabel="column, px",
        ylabel="row, px",
        title=f"MTF50 across each edge, {edges[0].channel}",
    )
    lines = [_line_px(edge) for edge in edges]
    rim = LineCollection(lines, colors="white", linewidths=EDGE_RIM_PT, capstyle="round")
    drawn = LineCollection(lines, cmap=MAP_RAMP, linewidths=EDGE_PT, capstyle="round")
    drawn.set_array(np.array([edge.of.fitted.mtf50.value for edge in edges]))
    for collection in (rim, drawn):
        axes.add_collection(collection, autolim=False)
    figure.colorbar(drawn, ax=axes, label="MTF50, cycles/mm", shrink=0.85, pad=0.01)
    return figure


def _line_px(edge: ChartEdge) -> Floats:
    """Return the ends (2, 2) of an edge, column and row."""
    angle = np.radians(edge.of.angle_deg)
    row, column = edge.of.middle_px
    middle = np.array([column, row])
    half = edge.of.length_px / 2 * np.array([-np.sin(angle), np.cos(angle)])
    return np.array([middle - half, middle + half])
