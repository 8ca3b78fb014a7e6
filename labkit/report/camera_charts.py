"""Charts of the camera: what the model leaves of the data, with the parts that were found and without."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from labkit.figure_style import HALF_IN, SOFT_INK, channel_inks, chart
from labkit.results import Results

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
        frequency, ink = spectra[0].cycles_per_px, inks[channel]
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
