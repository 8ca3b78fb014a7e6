"""MTF with error bands, the diffraction limit and Nyquist's frequencies: at best focus, and as photographed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.optics.mtf import mtf
from labkit.optics.psf import diffraction_mtf
from labkit.optics.wavefront import FittedWavefront
from labkit.report.best_focus import DIRECTIONS, BestFocus, nyquist_per_mm
from labkit.report.quantities import estimated, millimetres
from labkit.report.style import DASHED, DOTTED, LINE_OF, SOFT, SOLID, banded, channel_inks, columns_for, panels
from labkit.results import Results

POINTS = 120
SPARSE = (0, (6, 3))


def draw_mtf(axes: Axes, wavefront: FittedWavefront, last_per_mm: float, colour: str) -> None:
    """MTF along x and y with bands of one standard error, up to a frequency, and the diffraction limit."""
    grid = np.linspace(0, last_per_mm, POINTS)
    for direction in DIRECTIONS:
        curve = mtf(wavefront, grid, direction)
        banded(axes, grid, curve.value, curve.std, colour, LINE_OF[direction])
    axes.plot(grid, diffraction_mtf(grid / wavefront.cutoff_per_mm), color=colour, lw=0.8, ls=DOTTED)


def draw_nyquist(axes: Axes, results: Results, channels: Sequence[str]) -> None:
    """Lines at Nyquist's frequencies of all pixels, and of the channels' own where those are fewer."""
    for channel in channels:
        full, plane = nyquist_per_mm(results, channel)
        axes.axvline(full, color=SOFT, lw=0.7, zorder=1)
        if plane < full:
            axes.axvline(plane, color=SOFT, lw=0.7, ls=SPARSE, zorder=1)


def _key(results: Results, styles: Mapping[str, Any]) -> list[Line2D]:
    """What lines mean, whatever their colour."""
    key = [Line2D([], [], color=SOFT, ls=style, label=label) for label, style in styles.items()]
    key.append(Line2D([], [], color=SOFT, lw=0.8, ls=DOTTED, label="diffraction limit"))
    key.append(Line2D([], [], color=SOFT, lw=0.7, label="Nyquist, all pixels"))
    if any(plane < full for full, plane in (nyquist_per_mm(results, channel) for channel in results.channels)):
        key.append(Line2D([], [], color=SOFT, lw=0.7, ls=SPARSE, label="Nyquist, one colour"))
    return key


def last_frequency_per_mm(results: Results) -> float:
    """Where axes of frequency end: at the highest cutoff, or three times Nyquist's frequency."""
    nyquist = 500.0 / results.plan.sensor.pixel_pitch_um
    return min(3 * nyquist, max(w.fitted.cutoff_per_mm for w in results))


def focus_mtf_chart(results: Results, focused: Sequence[BestFocus]) -> Figure:
    """MTF of each channel at best focus, with MTF50 along both directions and both of Nyquist's frequencies."""
    inks, last = channel_inks(results.channels), last_frequency_per_mm(results)
    figure, axes_of = panels(len(focused), columns_for(len(focused)), 3.1, sharey=True)
    for axes, best in zip(axes_of, focused, strict=True):
        colour = inks[best.channel].colour
        draw_nyquist(axes, results, [best.channel])
        draw_mtf(axes, best.fitted, last, colour)
        axes.axhline(0.5, color=SOFT, lw=0.5, ls=(0, (1, 3)))
        keys = [
            Line2D([], [], color=colour, ls=LINE_OF[d], label=f"along {d}: MTF50 {estimated(best.mtf50[d])}")
            for d in DIRECTIONS
        ]
        axes.legend(handles=keys, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, labelspacing=0.3)
        axes.set_title(best.channel)
        axes.set(xlim=(0, last), ylim=(0, 1.0), xlabel="cycles/mm on the sensor")
    axes_of[0].set_ylabel("MTF")
    figure.legend(handles=_key(results, {}), loc="outside lower center", ncols=3)
    return figure


def mtf_chart(results: Results, ranges_mm: Sequence[float | None]) -> Figure:
    """MTF of each range's channels as photographed, along x and y."""
    inks, last = channel_inks(results.channels), last_frequency_per_mm(results)
    figure, axes_of = panels(len(ranges_mm), columns_for(len(ranges_mm)), 2.7, sharey=True)
    for axes, range_mm in zip(axes_of, ranges_mm, strict=True):
        axes.set_title(millimetres(range_mm))
        wavefronts = results.at_range(range_mm)
        draw_nyquist(axes, results, [w.channel for w in wavefronts])
        for wavefront in wavefronts:
            draw_mtf(axes, wavefront.fitted, last, inks[wavefront.channel].colour)
        axes.set(xlim=(0, last), ylim=(0, 1.0), xlabel="cycles/mm on the sensor")
    axes_of[0].set_ylabel("MTF")
    colours = [Line2D([], [], color=inks[c].colour, label=c) for c in results.channels]
    key = colours + _key(results, {"along x": SOLID, "along y": DASHED})
    figure.legend(handles=key, loc="outside lower center", ncols=-(-len(key) // 2))
    return figure
