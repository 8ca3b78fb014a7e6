"""Figures of the optics at best focus: path difference over the pupil, and encircled energy with error bands."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.special import j0, j1

from labkit.optics.encircled_energy import encircled_energy
from labkit.optics.metrics import opd_map
from labkit.report.best_focus import SHARE, BestFocus
from labkit.report.quantities import estimated
from labkit.report.style import DOTTED, INK, SOFT, WIDTH_IN, banded, channel_inks, panels, scaling
from labkit.results import Results
from labkit.types import Floats

MAP_SAMPLES = 255  # across the pupil: about a pixel of the figure each
ENERGY_POINTS = 90


def opd_picture(focused: Sequence[BestFocus], reference_nm: float) -> Figure:
    """Path difference over the pupil without defocus, one colour scale for all channels, in waves and nanometres."""
    maps = [opd_map(best.fitted, MAP_SAMPLES).value for best in focused]
    limit = max(float(np.nanmax(np.abs(path))) for path in maps) or 0.01
    columns = min(len(focused), 3)
    rows, side = -(-len(focused) // columns), (WIDTH_IN - 1.0) / 3
    figure = Figure(figsize=(side * columns + 1.0, (side + 0.45) * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, best, path in zip(grid, focused, maps, strict=False):
        image = axes.imshow(path, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
        rms, span = (estimated(number, least=3) for number in (best.rms, best.peak_to_valley))
        axes.set_title(f"{best.channel}\n")
        axes.set_title(f"RMS {rms}\nP–V {span} waves", loc="right", fontweight="normal", fontsize=8)
    bar = figure.colorbar(image, ax=list(grid), shrink=0.9, aspect=28, pad=0.02)
    bar.ax.yaxis.set_ticks_position("left")
    nanometres = bar.ax.secondary_yaxis("right", functions=scaling(reference_nm))
    bar.ax.text(-0.3, 1.02, "waves", ha="right", va="bottom", fontsize=8, transform=bar.ax.transAxes)
    bar.ax.text(1.3, 1.02, "nm", ha="left", va="bottom", fontsize=8, transform=bar.ax.transAxes)
    nanometres.tick_params(labelsize=8)
    return figure


def perfect_energy(radius_um: Floats, airy_um: float) -> Floats:
    """Encircled energy of a perfect lens of an airy_um, lambda N: Rayleigh's 1 - J0^2 - J1^2."""
    argument = np.pi * radius_um / airy_um
    return np.asarray(1 - j0(argument) ** 2 - j1(argument) ** 2)


def energy_chart(results: Results, focused: Sequence[BestFocus]) -> Figure:
    """Encircled energy of each channel at best focus with error bands, beside a perfect lens's."""
    inks = channel_inks(results.channels)
    figure, (axes,) = panels(1, 1, 3.4)
    last = max(max(1.9 * b.energy_radius_um.value, 3 * b.fitted.wavelength_um * b.fitted.f_number) for b in focused)
    radius = np.linspace(0, last, ENERGY_POINTS)
    for best in focused:
        ink, at = inks[best.channel], best.energy_radius_um
        energy = encircled_energy(best.fitted, radius)
        banded(axes, radius, energy.value, energy.std, ink.colour)
        perfect = perfect_energy(radius, best.fitted.wavelength_um * best.fitted.f_number)
        axes.plot(radius, perfect, color=ink.colour, lw=0.8, ls=DOTTED)
        label = f"{best.channel}: {100 * SHARE:.0f} % within {estimated(at)} µm"
        axes.plot([at.value], [SHARE], ink.marker, color=ink.colour, ms=5.5, mec="white", mew=0.6, label=label)
    axes.plot([], [], color=INK, lw=0.8, ls=DOTTED, label="diffraction limit")
    axes.axhline(SHARE, color=SOFT, lw=0.5, ls=(0, (1, 3)))
    axes.set(xlim=(0, last), ylim=(0, 1.0), xlabel="radius on the sensor, µm", ylabel="encircled energy")
    axes.legend(loc="lower right")
    return figure
