"""Pictures of a lens's history, and of the differences between two sessions."""

from __future__ import annotations

from datetime import datetime
from math import isfinite
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labkit.catalogue.compare import Comparison
from labkit.catalogue.history import History
from labkit.errors import printable
from labkit.figure_style import (
    INK,
    SOFT_INK,
    WIDTH_IN,
    channel_inks,
    panels,
    styled,
    svg,
)
from labkit.optics.metrics import opd_map
from labkit.optics.zernike import mode_name

DIFFERENCE_SAMPLES = 101
MOST_STDS = 5.0
"""Largest significance that the map's colours tell apart."""

HISTORY_MARKER = 3.0
"""Size of a marker that hides no standard error of a panel's scale."""

MODES_SHOWN = (5, 6, 7, 8, 9, 10, 11)


def history_picture(history: History) -> bytes:
    """Draw best focus and the primary modes over time with standard errors, as an SVG file."""
    modes = [j for j in history.modes if j in MODES_SHOWN]
    rows = ["best_focus_mm", "rms_nm", *(f"waves.{j}" for j in modes)]
    words = ["best focus/mm", "RMS/nm", *(f"{mode_name(j)}, {j}/waves" for j in modes)]
    with styled():
        figure, axes = panels(len(rows), 3, 1.9, sharex=True)
        for one, quantity, title in zip(axes, rows, words, strict=True):
            _over_time(one, history, quantity)
            one.set_title(title)
        figure.suptitle(f"{history.lens}, {history.channel}", color=INK)
        figure.autofmt_xdate()
        return svg(figure)


def _over_time(axes: Axes, history: History, quantity: str) -> None:
    """Draw a number with standard errors at each session's time."""
    ink = channel_inks([history.channel])[history.channel]
    shown = [
        (_time(entry.taken), number)
        for entry in history.entries
        if (number := history.number(entry, quantity)) is not None
    ]
    axes.errorbar(
        np.array([time for time, _ in shown], dtype="datetime64[s]"),
        [number.value for _, number in shown],
        yerr=[number.std if isfinite(number.std) else 0.0 for _, number in shown],
        color=ink.colour,
        marker=ink.marker,
        ecolor=INK,
        elinewidth=0.8,
        capsize=2,
        lw=0.8,
        ms=HISTORY_MARKER,
    )


def _time(text: str) -> np.datetime64:
    """Return an ISO 8601 time without its zone; no time for another text."""
    try:
        return np.datetime64(datetime.fromisoformat(text).replace(tzinfo=None), "s")
    except ValueError:
        return np.datetime64("NaT")


def comparison_picture(comparison: Comparison) -> bytes:
    """Draw the wavefronts' difference over the pupil and its significance, a row for each channel, as an SVG file."""
    rows = comparison.wavefronts
    with styled():
        figure = Figure(
            figsize=(WIDTH_IN * 0.62, 0.4 + 2.6 * max(len(rows), 1)), layout="constrained"
        )
        grid = figure.subplots(max(len(rows), 1), 2, squeeze=False)
        for axes, (channel, wavefront) in zip(grid, rows.items(), strict=True):
            difference = opd_map(wavefront, DIFFERENCE_SAMPLES)
            limit = float(np.nanmax(np.abs(difference.value))) or 1e-6
            stds = difference.value / np.where(difference.std > 0, difference.std, np.nan)
            unit = f"waves at {wavefront.reference_nm:g} nm"
            _map(axes[0], difference.value, limit, f"{channel}: {unit}")
            _map(axes[1], stds, MOST_STDS, f"{channel}: standard errors")
        words = printable(
            f"{Path(comparison.second).name} less {Path(comparison.first).name}: {comparison.probability} for one lens"
        )
        figure.suptitle(words, color=INK)
        return svg(figure)


def _map(axes: Axes, values: np.ndarray, limit: float, title: str) -> None:
    """Draw values over the pupil, x to the right and y down as on the sensor."""
    image = axes.imshow(
        values, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest"
    )
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    axes.set_title(title)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.figure.colorbar(image, ax=axes, shrink=0.85).ax.tick_params(color=SOFT_INK)
