"""Charts of best focus, of through focus, and of all fits: MTF, Strehl ratio, modes, errors, residuals, the pupil."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path
from matplotlib.ticker import LogLocator, NullLocator
from scipy import special

from labkit.figure_style import (
    DASHED,
    DOTTED,
    FAINT,
    HALF_IN,
    INK,
    LINE_OF,
    POINT,
    SOFT_INK,
    SOLID,
    THIRD_IN,
    Ink,
    banded,
    channel_inks,
    chart,
    scaling,
)
from labkit.optics.rim import Rim
from labkit.optics.through_focus import DEPTH
from labkit.optics.zernike import mode_name
from labkit.report.curves import (
    CURVE_STEPS,
    MTF_DIRECTIONS,
    ChannelFocus,
    Curves,
    full_nyquist_per_mm,
)
from labkit.report.lens_tables import SOURCES, budget_name, whole_std
from labkit.report.table import estimated, fixed
from labkit.results import Results
from labkit.types import Floats
from labkit.uncertain import decimals


def zernike_chart(
    focused: Sequence[ChannelFocus], reference_nm: float, inks: dict[str, Ink]
) -> Figure | None:
    """Bars of each mode at best focus, a bar for each channel, with standard errors; waves below, nanometres above."""
    modes = sorted({j for best in focused for j in best.fitted.noll})
    if not modes:
        return None
    rows = len(modes)
    figure, axes = chart(HALF_IN, 0.95 + 0.27 * rows, left=1.75, top=0.48)
    height = 0.78 / len(focused)
    for k, best in enumerate(focused):
        w = best.fitted
        shown = [(modes.index(j), n) for n, j in enumerate(w.noll)]
        at = np.array([row for row, _ in shown]) + (k - (len(focused) - 1) / 2) * height
        index = [n for _, n in shown]
        axes.barh(
            at,
            w.waves[index],
            0.9 * height,
            color=inks[best.channel].colour,
            label=best.channel,
        )
        if best.photographed.sign_open:
            twin = best.photographed.twin.best.fitted.waves[index]
            axes.barh(at, twin, 0.9 * height, color=inks[best.channel].colour, alpha=0.35)
        error = np.nan_to_num(np.sqrt(np.diag(w.covariance))[index])
        axes.errorbar(
            w.waves[index],
            at,
            xerr=error,
            fmt="none",
            ecolor=INK,
            elinewidth=0.8,
            capsize=1.2,
        )
    axes.axvline(0, color=SOFT_INK, lw=0.7)
    axes.set_yticks(
        range(rows), [f"{mode_name(j)}  {j}" if j <= 15 else str(j) for j in modes]
    )
    axes.set(ylim=(rows - 0.4, -0.6), xlabel=f"waves RMS at {reference_nm:g} nm")
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.secondary_xaxis("top", functions=scaling(reference_nm)).set_xlabel("nm RMS")
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="upper left",
        handlelength=1,
        ncols=3,
        columnspacing=1,
    )
    return figure


def quantile_chart(
    title: str,
    values: Mapping[str, Floats],
    inks: Mapping[str, Ink],
    words: str,
    size_in: tuple[float, float],
) -> Figure:
    """Draw quantiles of numbers in standard errors against normal quantiles, with a 99 % band.

    values: of each channel; words: what the numbers are
    """
    figure, axes = chart(*size_in)
    axes.set_title(title)
    axes.axline((0, 0), slope=1, color=SOFT_INK, lw=0.8)
    for k, (channel, every) in enumerate(values.items()):
        normal, low, high, observed = normal_quantiles(every)
        if k == 0:
            axes.fill_between(normal, low, high, color=FAINT, lw=0)
        ink = inks[channel]
        axes.plot(
            normal,
            observed,
            ink.marker,
            ms=2.6,
            mew=0,
            color=ink.colour,
            alpha=0.85,
            label=channel,
        )
    axes.set(xlabel="normal quantile, σ", ylabel=f"quantile of the {words}, σ")
    axes.legend(loc="upper left", handletextpad=0.2)
    return figure


def normal_quantiles(values: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return a hundred quantiles, dense in the tails: of the normal law, the 99 % band around them, and of the values.

    Values are in standard errors; those that are not finite are left out.
    """
    values = np.sort(values[np.isfinite(values)])
    tail = np.unique(np.geomspace(1, max((values.size + 1) // 2, 1), 50).astype(int))
    rank = np.unique(np.concatenate([tail, values.size + 1 - tail]))
    rank = rank[(rank >= 1) & (rank <= values.size)]
    after = values.size + 1 - rank
    normal = special.ndtri(
        (rank - 0.375) / (values.size + 0.25)
    )  # Blom's plotting positions
    low, high = (
        np.asarray(special.ndtri(special.betaincinv(rank, after, p)), float)
        for p in (0.005, 0.995)
    )
    return normal, low, high, values[rank - 1]


# of Okabe and Ito's colours those that no channel has, as far apart in lightness as they go; and what is legible on each
SOURCE_COLOURS = {
    "photons": ("#56b4e9", INK),
    "calibration": ("#f0e442", INK),
    "geometry": ("#444a50", "white"),
    "model": ("#cc79a7", INK),
}
LEAST_LABELLED = 6.0  # per cent: a narrower piece has no room for its number


def budget_chart(results: Results) -> Figure:
    """Stacked bars, one for each number of the budget, of the sources' shares of its variance in per cent."""
    numbers = list(results.budget.items())
    figure, axes = chart(HALF_IN, 0.85 + 0.3 * len(numbers), left=2.3, top=0.34)
    places = np.arange(len(numbers))
    shares = np.array([variance_shares(budget) for _, budget in numbers])
    left = np.zeros(len(numbers))
    for source, of_source in zip(SOURCES, shares.T, strict=True):
        colour, ink = SOURCE_COLOURS[source]
        axes.barh(
            places,
            of_source,
            0.72,
            left,
            color=colour,
            edgecolor="white",
            linewidth=0.8,
            label=source,
        )
        _label(axes, left, of_source, ink)
        left += of_source
    axes.set_yticks(places, [_label_of(key, budget) for key, budget in numbers])
    axes.set(
        xlim=(0, 100), ylim=(len(numbers) - 0.4, -0.6), xlabel="share of the variance, %"
    )
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="upper center",
        ncols=len(SOURCES),
        borderaxespad=0.1,
    )
    return figure


def variance_shares(budget: dict[str, float]) -> list[float]:
    """Per cent of the variance, in the order of `SOURCES`; zeros where there is none."""
    variance = whole_std(budget) ** 2 or 1.0
    return [100 * budget.get(source, 0.0) ** 2 / variance for source in SOURCES]


def _label(axes: Axes, left: Floats, width: Floats, ink: str) -> None:
    """Label each piece with its share, where wide enough."""
    for place, (start, share) in enumerate(zip(left, width, strict=True)):
        if share >= LEAST_LABELLED:
            axes.text(
                start + share / 2,
                place,
                f"{share:.0f}",
                ha="center",
                va="center_baseline",
                color=ink,
                fontsize=8,
            )


def _label_of(key: str, budget: dict[str, float]) -> str:
    name, unit = budget_name(key)
    whole = whole_std(budget)
    return f"{name}   ± {fixed(whole, decimals(whole))} {unit}".rstrip()


WIDE = 5.0  # power beyond which the axis is logarithmic


def spectrum_chart(results: Results) -> Figure:
    """Power of the residuals over the noise's against spatial frequency, a line a channel, dashed without the parts found."""
    figure, axes = chart(HALF_IN, 3.0, top=0.12)
    axes.axhline(1, color=SOFT_INK, lw=0.7)
    inks = channel_inks(results.channels)
    for channel in results.channels:
        spectra = [
            w.residual_spectrum
            for w in results.of_channel(channel)
            if w.residual_spectrum is not None
        ]
        if not spectra:
            continue
        frequency = spectra[0].cycles_per_px
        ink = inks[channel]
        power = np.mean([s.power for s in spectra], axis=0)
        axes.plot(
            frequency,
            power,
            f"{ink.marker}-",
            color=ink.colour,
            lw=1.2,
            ms=3.5,
            label=channel,
        )
        without = [s.without_parts for s in spectra if s.without_parts is not None]
        if without:
            axes.plot(frequency, np.mean(without, axis=0), "--", color=ink.colour, lw=1.2)
    axes.set(
        xlabel="spatial frequency, cycles a pixel", ylabel="residuals over noise, power"
    )
    low, high = axes.get_ylim()
    if high > WIDE:
        axes.set(yscale="log", ylim=(0.5, high))
        axes.yaxis.set_major_locator(LogLocator(10, (1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.set_ylim(min(low, 0.5), max(high, 1.5))
    axes.legend(loc="upper right")
    return figure


SPARSE = (0, (6, 3))
PALE = 0.45  # of a curve with the pixel


def mtf_chart(results: Results, curves: Curves, ink: Ink) -> Figure:
    """Along x and y, of the optics, and of optics and pixel; MTF50 in the legend."""
    figure, axes = chart(THIRD_IN, 3.0, left=0.5, right=0.1, top=0.62)
    full = full_nyquist_per_mm(results.plan.sensor)
    plane = curves.focus.nyquist_per_mm
    axes.axvline(full, color=SOFT_INK, lw=0.7, zorder=1)
    if plane < full:
        axes.axvline(plane, color=SOFT_INK, lw=0.7, ls=SPARSE, zorder=1)
    for direction, curve in curves.mtf.items():
        x = curve.frequency_per_mm
        line = LINE_OF[direction]
        axes.plot(
            x, curve.value * curves.pixel, color=ink.colour, ls=line, lw=1.0, alpha=PALE
        )
        banded(axes, x, curve.value, curve.std, ink.colour, line)
        axes.plot(x, curves.perfect, color=ink.colour, lw=0.8, ls=DOTTED)
    axes.axhline(0.5, color=SOFT_INK, lw=0.5, ls=(0, (1, 3)))
    keys = [
        Line2D(
            [],
            [],
            color=ink.colour,
            ls=LINE_OF[d],
            label=f"{d}: MTF50 {estimated(curves.focus.mtf50(d))} cycles/mm",
        )
        for d in MTF_DIRECTIONS
    ]
    axes.legend(
        handles=keys,
        loc="lower right",
        bbox_to_anchor=(1, 1),
        borderaxespad=0,
        labelspacing=0.3,
    )
    figure.text(0.02, 0.985, curves.channel, fontweight="bold", fontsize=9, va="top")
    axes.set(xlim=(0, x[-1]), ylim=(0, 1.0), xlabel="cycles/mm on the sensor", ylabel="MTF")
    return figure


THROUGH_CHART_IN = 3.2
MARK_EVERY = CURVE_STEPS // 5  # points of a curve to a marker, staggered between channels


def strehl_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """Strehl ratio of each channel against range with bands of one standard error; its depth of focus as a bar."""
    figure, axes = chart(HALF_IN, THROUGH_CHART_IN)
    for k, each in enumerate(curves):
        ink = inks[each.channel]
        strehl = each.strehl
        marks = _marks(k, len(curves), ink)
        banded(axes, each.places, strehl.value, strehl.std, ink.colour, **marks)
        if each.depth is not None:
            ends = [each.place(end.value) for end in (each.depth.near, each.depth.far)]
            level = 0.035 + 0.04 * k
            axes.plot(ends, [level, level], color=ink.colour, lw=3, solid_capstyle="butt")
            highest = each.place(each.depth.highest.value)
            axes.plot([highest], [level], ink.marker, color=ink.colour, **POINT)
    axes.axhline(DEPTH, color=SOFT_INK, lw=0.5, ls=(0, (1, 3)))
    _frame(axes, curves)
    axes.set_ylabel("Strehl ratio")
    _legend(axes, _channel_keys(curves, inks))
    return figure


def modulation_chart(curves: Sequence[Curves], inks: dict[str, Ink]) -> Figure:
    """Draw the MTF of each channel at a single frequency along x and y against range; their difference is astigmatism."""
    figure, axes = chart(HALF_IN, THROUGH_CHART_IN)
    for k, each in enumerate(curves):
        ink = inks[each.channel]
        marks = _marks(k, len(curves), inks[each.channel])
        for line, curve in zip((SOLID, DASHED), each.modulation.values(), strict=True):
            banded(axes, each.places, curve.value, curve.std, ink.colour, line, **marks)
    _frame(axes, curves)
    axes.set_ylabel(f"MTF at {curves[0].through_per_mm:.3g} cycles/mm")
    directions = [
        Line2D([], [], color=SOFT_INK, ls=line, label=label)
        for line, label in ((SOLID, "x"), (DASHED, "y"))
    ]
    _legend(axes, [*_channel_keys(curves, inks), *directions])
    return figure


def _marks(k: int, channels: int, ink: Ink) -> dict[str, Any]:
    """Return the markers of channel k, at other points than those of the other channels."""
    first = round((k + 0.5) * MARK_EVERY / channels)
    return {"marker": ink.marker, "markevery": (first, MARK_EVERY), **POINT}


def _channel_keys(curves: Sequence[Curves], inks: dict[str, Ink]) -> list[Line2D]:
    return [
        Line2D([], [], color=ink.colour, marker=ink.marker, label=each.channel, **POINT)
        for each in curves
        for ink in [inks[each.channel]]
    ]


def _legend(axes: Axes, keys: Sequence[Line2D]) -> None:
    """Put the keys in one line above the axes."""
    axes.legend(
        handles=keys,
        loc="lower right",
        ncols=len(keys),
        borderaxespad=0,
        handlelength=2.2,
        columnspacing=1.2,
        bbox_to_anchor=(1, 1.01),
    )


def _frame(axes: Axes, curves: Sequence[Curves]) -> None:
    places = np.concatenate([each.places for each in curves])
    label = (
        "range of the target, mm"
        if curves[0].in_ranges
        else "shift of the sensor from best focus, µm"
    )
    axes.set(xlim=(places.min(), places.max()), ylim=(0, 1.0), xlabel=label)


DRAWN_ARCS = 360  # of the outline as it is drawn
CLEAR = "#e9e3cf"


def clear_part(edges: Sequence[Floats], width: float) -> PathPatch:
    """Return the area within a pupil's edges (points, 2) as drawn, with a line of a width, points."""
    outlines = [Path(np.concatenate([e, e[:1]]), closed=True) for e in edges]
    return PathPatch(Path.make_compound_path(*outlines), fc=CLEAR, ec=INK, lw=width)


def pupil_chart(rim: Rim) -> Figure:
    """The clear part of the pupil, dashed the circle of the f-number, and around it the full pupil; y down as on the sensor."""
    figure = Figure(figsize=(THIRD_IN, THIRD_IN))
    axes = figure.add_axes((0.03, 0.03, 0.94, 0.94))
    axes.add_patch(clear_part(rim.edges(DRAWN_ARCS), 1.0))
    axes.add_patch(Circle((0, 0), 1.0, fill=False, ec=INK, lw=0.8, ls=(0, (4, 3))))
    axes.add_patch(Circle((0, 0), rim.outer, fill=False, ec=SOFT_INK, lw=0.6))
    side = 1.08 * max(rim.longest, rim.outer, 1.0)
    axes.set(xlim=(-side, side), ylim=(side, -side), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    axes.axis("off")
    return figure
