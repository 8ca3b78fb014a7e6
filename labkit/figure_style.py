"""How figures look: type, lines, the colour of each channel, and their encoding as PNG and SVG."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from io import BytesIO
from math import floor, log10
from typing import Any, cast

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from labkit.types import Floats

WIDTH_IN = 9.0  # of the page; panels stand side by side on a desktop and on paper, one above the other on a telephone
HALF_IN = WIDTH_IN / 2
THIRD_IN = WIDTH_IN / 3
DPI = 200
INK, SOFT_INK, FAINT = "#1c1e21", "#6b7075", "#d5d8db"
SOLID = "-"
DASHED = (0, (4, 2))
DOTTED = (0, (1, 1.5))
LINE_OF: dict[str, Any] = {"x": SOLID, "y": DASHED}  # of a direction on the sensor

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT_INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "xtick.color": SOFT_INK,
    "ytick.color": SOFT_INK,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.4,
    "figure.facecolor": "white",
    "text.parse_math": False,  # a dollar sign in a name begins no formula
    "svg.fonttype": "path",
    "svg.hashsalt": "labkit",  # the same figure gives the same file
}


@dataclass(frozen=True, slots=True)
class Ink:
    """How a channel is drawn."""

    colour: str
    marker: str

    @property
    def ramp(self) -> LinearSegmentedColormap:
        """White, through the colour, to nearly black."""
        return LinearSegmentedColormap.from_list(
            "ramp", ["#ffffff", self.colour, "#101214"]
        )


POINT: dict[str, Any] = {"ms": 5.5, "mec": "white", "mew": 0.6}  # of a channel's marker

# Okabe and Ito's colours, which colour-blind readers can tell apart
CHANNEL_INKS = {
    "R": Ink("#d55e00", "o"),
    "G": Ink("#009e73", "s"),
    "B": Ink("#0072b2", "^"),
}
OTHERS = (
    Ink("#444a50", "D"),
    Ink("#cc79a7", "v"),
    Ink("#e69f00", "P"),
    Ink("#56b4e9", "X"),
)


def channel_inks(channels: Iterable[str]) -> dict[str, Ink]:
    """The same colour and marker for the same channel in every figure."""
    others = [c for c in channels if c not in CHANNEL_INKS]
    return CHANNEL_INKS | {c: OTHERS[k % len(OTHERS)] for k, c in enumerate(others)}


def styled() -> AbstractContextManager[None]:
    """Matplotlib's settings while figures are made; as they were afterwards."""
    return rc_context(cast(Any, STYLE))


def chart(
    width_in: float,
    height_in: float,
    *,
    left: float = 0.58,
    right: float = 0.12,
    bottom: float = 0.46,
    top: float = 0.3,
) -> tuple[Figure, Axes]:
    """A figure of one pair of axes with margins in inches: a layout engine would draw each figure twice to find them."""
    figure = Figure(figsize=(width_in, height_in))
    box = (
        left / width_in,
        bottom / height_in,
        1 - (left + right) / width_in,
        1 - (bottom + top) / height_in,
    )
    return figure, figure.add_axes(box)


def panels(
    count: int, columns: int, height_in: float, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of panels of one size, row by row."""
    rows = -(-count // columns)
    figure = Figure(figsize=(WIDTH_IN, rows * height_in), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, **shared).ravel()
    for unused in grid[count:]:
        unused.set_visible(False)
    return figure, list(grid[:count])


def scaling(factor: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return the functions between an axis and a second one with another unit, such as waves in nanometres."""
    return lambda waves: waves * factor, lambda nm: nm / factor


def round_length(longest: float) -> float:
    """Return the greatest of 1, 2, 5 times a power of ten that is not above a length."""
    if not longest > 0:
        return 1.0
    decade = 10.0 ** floor(log10(longest))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= longest))


def banded(
    axes: Axes,
    x: Floats,
    value: Floats,
    std: Floats,
    colour: str,
    line: Any = SOLID,
    **marks: Any,
) -> None:
    """A curve with a band of one standard error. marks: settings of the curve's markers."""
    axes.plot(x, value, color=colour, ls=line, **marks)
    axes.fill_between(x, value - std, value + std, color=colour, alpha=0.25, lw=0)


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    return _encode(figure, "png", {"Software": None})


def svg(figure: Figure) -> bytes:
    """The figure as an SVG file that needs no fonts."""
    return _encode(figure, "svg", dict.fromkeys(("Date", "Creator", "Format", "Type")))


def _encode(figure: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    buffer = BytesIO()
    with styled():
        figure.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
    return buffer.getvalue()
