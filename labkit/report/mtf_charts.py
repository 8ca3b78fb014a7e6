"""MTF of a channel at best focus with error bands, the diffraction limit, the pixel and Nyquist's frequencies."""

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.figure_style import DOTTED, LINE_OF, SOFT_INK, THIRD_IN, Ink, banded, chart
from labkit.report.best_focus import MTF_DIRECTIONS, full_nyquist_per_mm
from labkit.report.curves import Curves
from labkit.report.quantities import estimated
from labkit.results import Results

SPARSE = (0, (6, 3))
PALE = 0.45  # of a curve with the pixel


def mtf_chart(results: Results, curves: Curves, ink: Ink) -> Figure:
    """Along x and y, of the optics, and of optics and pixel; MTF50 in the legend."""
    figure, axes = chart(THIRD_IN, 3.0, left=0.5, right=0.1, top=0.62)
    full, plane = full_nyquist_per_mm(results.plan.sensor), curves.focus.nyquist_per_mm
    axes.axvline(full, color=SOFT_INK, lw=0.7, zorder=1)
    if plane < full:
        axes.axvline(plane, color=SOFT_INK, lw=0.7, ls=SPARSE, zorder=1)
    for direction, curve in curves.mtf.items():
        x, line = curve.frequency_per_mm, LINE_OF[direction]
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
