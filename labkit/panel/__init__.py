"""A display's panel: its pixels, targets drawn in them, and what photographs show of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

USUAL_APERTURE = 0.85
"""Share of its third, and of the pitch along it, that a stripe is usually lit over."""


@dataclass(frozen=True, slots=True)
class PanelInfo:
    """A display's panel: (height, width) in pixels, pitch of the square pixels, arrangement of their colours."""

    pixels: tuple[int, int]
    pitch_mm: float
    subpixels: Literal["rgb", "none"] = "rgb"
    gamma: float = 2.2

    def __post_init__(self) -> None:
        if not (min(self.pixels) > 0 and self.pitch_mm > 0 and self.gamma > 0):
            raise ValueError(f"a panel has pixels, a pitch and a gamma above 0: {self}")

    @property
    def size_mm(self) -> tuple[float, float]:
        """Return (height, width) of the lit area."""
        return self.pixels[0] * self.pitch_mm, self.pixels[1] * self.pitch_mm
