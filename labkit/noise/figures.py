"""Figures of photon transfer: the transfer curve, linearity, and signal-to-noise ratio."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from labkit.calibration.photon_transfer import ROUNDING_VARIANCE
from labkit.figure_style import (
    DASHED,
    HALF_IN,
    POINT,
    SOFT_INK,
    channel_inks,
    chart,
    styled,
)
from labkit.noise.emva import LINEARITY_SHARES, SENSITIVITY_SHARE, ChannelNoise
from labkit.noise.levels import Level

HEIGHT_IN = 3.3
MODEL_POINTS = 200

Channels = Mapping[str, ChannelNoise]


def transfer_chart(channels: Channels) -> Figure:
    """Temporal variance of flats above darks against mean signal, and each gain's line as far as it was fitted."""
    figure, axes = chart(HALF_IN, HEIGHT_IN, left=0.75)
    inks = channel_inks(channels)
    for name, noise in channels.items():
        ink = inks[name]
        flats = noise.series.flats
        signal = [flat.signal for flat in flats]
        variance = [flat.variance - noise.dark_variance for flat in flats]
        error = [flat.variance_std for flat in flats]
        axes.errorbar(
            signal, variance, error, fmt=ink.marker, color=ink.colour, label=name, **POINT
        )
        line = np.array([0.0, noise.fitted_to])
        axes.plot(line, noise.gain_counts_per_e.value * line, color=ink.colour)
        longer = np.array([noise.fitted_to, max(signal)])
        axes.plot(
            longer,
            noise.gain_counts_per_e.value * longer,
            color=ink.colour,
            ls=DASHED,
            lw=0.8,
        )
    axes.set(xlim=(0, None), ylim=(0, None))
    axes.set_xlabel("signal above dark, counts")
    axes.set_ylabel("temporal variance above dark, counts²")
    axes.legend(loc="upper left")
    return figure


def linearity_chart(channels: Channels) -> Figure:
    """Deviation of each level from the straight line, per cent of the signal."""
    figure, axes = chart(HALF_IN, HEIGHT_IN, left=0.75)
    inks = channel_inks(channels)
    axes.axhline(0, color=SOFT_INK, lw=0.8)
    most = 0.1
    for name, noise in channels.items():
        ink = inks[name]
        top = noise.fitted_to / SENSITIVITY_SHARE
        low, high = (share * top for share in LINEARITY_SHARES)
        shown = [
            (100 * flat.signal / top, deviation)
            for flat, deviation in zip(
                noise.series.flats, noise.deviations_percent, strict=True
            )
            if low <= flat.signal <= high and np.isfinite(deviation)
        ]
        if shown:
            x, y = np.array(shown).T
            axes.plot(x, y, color=ink.colour, marker=ink.marker, label=name, **POINT)
            most = max(most, 1.2 * float(np.abs(y).max()))
    axes.set(xlim=(0, 100), ylim=(-most, most))
    axes.set_xlabel("signal, % of saturation")
    axes.set_ylabel("deviation from linearity, %")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right", ncols=3)
    return figure


def snr_chart(channels: Channels) -> Figure:
    """Signal-to-noise ratio against electrons: measured, by the model, and of photons alone."""
    figure, axes = chart(HALF_IN, HEIGHT_IN, left=0.75)
    inks = channel_inks(channels)
    most = 10.0
    for name, noise in channels.items():
        ink = inks[name]
        gain = noise.gain_counts_per_e.value
        lit = [flat for flat in noise.series.flats if _usable(flat)]
        electrons = np.array([flat.signal / gain for flat in lit])
        ratio = np.array([flat.signal / np.sqrt(flat.variance) for flat in lit])
        axes.plot(electrons, ratio, ink.marker, color=ink.colour, label=name, **POINT)
        most = max(most, float(electrons.max()))
        model = np.geomspace(1, electrons.max(), MODEL_POINTS)
        dark = max(noise.dark_variance, ROUNDING_VARIANCE) / gain**2
        axes.plot(model, model / np.sqrt(dark + model), color=ink.colour)
        spatial = (noise.prnu_percent.value / 100 * model) ** 2 + noise.dsnu_e.value**2
        axes.plot(
            model, model / np.sqrt(dark + model + spatial), color=ink.colour, ls=DASHED
        )
    ideal = np.geomspace(1, most, MODEL_POINTS)
    axes.plot(ideal, np.sqrt(ideal), color=SOFT_INK, lw=0.8, ls=(0, (1, 3)))
    axes.set(xscale="log", yscale="log", xlabel="electrons", ylim=(0.1, None))
    axes.set_ylabel("signal-to-noise ratio")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.legend(loc="upper left")
    return figure


def _usable(level: Level) -> bool:
    return level.signal > 0 and level.variance > 0 and level.clipped == 0


CAPTIONS: Mapping[str, tuple[Callable[[Channels], Figure], str]] = {
    "photon transfer": (
        transfer_chart,
        "Temporal variance against signal. The solid line is the fitted gain, up to 70 % of saturation; dashed, the same "
        "line continued. The variance is largest at saturation.",
    ),
    "linearity": (
        linearity_chart,
        "Deviation from the straight line of signal against light, between 5 and 95 % of saturation.",
    ),
    "signal-to-noise ratio": (
        snr_chart,
        "Signal-to-noise ratio of one pixel: measured (markers), by the model (solid), with DSNU and PRNU (dashed), and of "
        "photons alone (dotted).",
    ),
}
"""Each figure's name, how it is drawn, and its caption."""


def drawn(channels: Channels) -> dict[str, Figure]:
    """Return all figures by name."""
    with styled():
        return {name: draw(channels) for name, (draw, _) in CAPTIONS.items()}
