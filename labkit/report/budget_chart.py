"""Where the errors come from: of each number, the share of its variance that each source makes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labkit.figure_style import HALF_IN, INK, chart
from labkit.report.lens_table import SOURCES, budget_name, whole_std
from labkit.report.quantities import fixed
from labkit.results import Results
from labkit.types import Floats
from labkit.uncertain import decimals

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
    """The per cent of each piece that has room for them."""
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
