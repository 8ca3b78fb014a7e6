"""Figures as they stand on the page: plates of panels, side by side where there is room."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from re import sub

from matplotlib.figure import Figure
from PIL import Image

from labkit.figure_style import png, svg

MOST_COLOURS = 256


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture: its file's name, its bytes, what it shows in words, and a heading where it bears none itself."""

    file: str
    content: bytes
    alt: str
    heading: str = ""
    pixels: bool = False

    @property
    def media_type(self) -> str:
        """Of the bytes."""
        return "image/svg+xml" if self.file.endswith(".svg") else "image/png"


@dataclass(frozen=True, slots=True)
class Plate:
    """Panels with one caption; across: how many stand side by side on a wide page."""

    panels: tuple[Panel, ...]
    caption: str
    across: int = 2


def drawing(name: str, figure: Figure, alt: str) -> Panel:
    """A figure made of lines."""
    return Panel(f"{_safe(name)}.svg", svg(figure), alt)


def picture(name: str, figure: Figure, alt: str) -> Panel:
    """A figure made of pixels; with 256 colours it takes a quarter, and no more can be told apart in it."""
    image = Image.open(BytesIO(png(figure))).convert("RGB")
    buffer = BytesIO()
    image.quantize(MOST_COLOURS, dither=Image.Dither.NONE).save(buffer, "PNG")
    return Panel(f"{_safe(name)}.png", buffer.getvalue(), alt)


def chip(name: str, content: bytes, alt: str, heading: str) -> Panel:
    """A photograph's pixels as they are."""
    return Panel(f"{_safe(name)}.png", content, alt, heading, pixels=True)


def _safe(name: str) -> str:
    return sub(r"[^A-Za-z0-9.+_-]", "-", name)
