"""A target as a picture for a panel: whole panel pixels for every cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.errors import TargetError
from labkit.panel import PanelInfo
from labkit.target.grid import TargetGrid
from labkit.target.target import CellTarget, Target, on_dots
from labkit.types import Floats

SIZE_TOLERANCE = 0.02
"""A picture may be this much larger or smaller than the plan's target: the fitted pose takes up a common scale."""


@dataclass(frozen=True, slots=True)
class PanelPicture:
    """Grey values (rows, cols) for panel pixels, and the target's true size among them.

    size_mm: (height, width) of the target, or of each target of a grid; pitch_mm: true
    distance of a grid's targets, None for a single target.
    """

    grey: NDArray[np.uint8]
    size_mm: tuple[float, float]
    pitch_mm: float | None = None


def panel_picture(target: Target, panel: PanelInfo) -> PanelPicture:
    """Return the target on the panel's pixels, as near to its nominal size as whole pixels a cell allow.

    The targets of a grid are a whole number of pixels apart.

    Raises TargetError if no such size is near, if the panel is too small, or if a radiance
    is above white.
    """
    alone = target.tile if isinstance(target, TargetGrid) else target
    radiance = _on_pixels(alone, panel)
    size_mm = (radiance.shape[0] * panel.pitch_mm, radiance.shape[1] * panel.pitch_mm)
    pitch_mm = None
    if isinstance(target, TargetGrid):
        radiance, pitch_mm = _laid_out(target, radiance, panel)
    if target.surround:
        framed = np.full(panel.pixels, target.surround)
        rows, cols = radiance.shape
        top = (panel.pixels[0] - rows) // 2
        left = (panel.pixels[1] - cols) // 2
        framed[top : top + rows, left : left + cols] = radiance
        radiance = framed
    grey = np.rint(255 * radiance ** (1 / panel.gamma)).astype(np.uint8)
    return PanelPicture(grey, size_mm, pitch_mm)


def _on_pixels(target: Target, panel: PanelInfo) -> Floats:
    """Return a single target's radiance in whole pixels a cell."""
    cells = target.cells.shape if isinstance(target, CellTarget) else (1, 1)
    rows, cols = (
        whole_pixels(side, count, panel.pitch_mm)
        for side, count in zip(target.size_mm, cells, strict=True)
    )
    _refuse_larger((rows, cols), panel, "take a smaller target")
    radiance = on_dots(target, (rows, cols))
    if radiance.max() > 1:
        raise TargetError(
            f"the target's radiance goes up to {radiance.max():g}; a panel shows 0 to 1"
        )
    return radiance


def _laid_out(
    grid: TargetGrid, tile: Floats, panel: PanelInfo
) -> tuple[Floats, float | None]:
    """Return the radiance of a grid of equal pictures of a target (rows, cols), and their pitch in mm; None of one target."""
    drawn = grid.in_dots(tile, panel.pitch_mm)
    pitch = round(drawn.pitch_mm)
    held = [
        max(0, (n - k) // pitch + 1) for n, k in zip(panel.pixels, tile.shape, strict=True)
    ]
    advice = f"it holds grid = {held} of them; or take smaller ones"
    if grid.is_marked_one:
        advice = "take a smaller target, or leave out marks"
    height, width = drawn.size_mm
    _refuse_larger((round(height), round(width)), panel, advice)
    pitch_mm = None if grid.is_marked_one else pitch * panel.pitch_mm
    return drawn.radiance_of_dots(), pitch_mm


def _refuse_larger(pixels: tuple[int, int], panel: PanelInfo, advice: str) -> None:
    if pixels[0] > panel.pixels[0] or pixels[1] > panel.pixels[1]:
        raise TargetError(
            f"the target takes {pixels[0]} × {pixels[1]} pixels of {panel.pitch_mm:g} mm; "
            f"the panel has {panel.pixels[0]} × {panel.pixels[1]}: {advice}"
        )


def whole_pixels(side_mm: float, cells: int, pitch_mm: float) -> int:
    """Return the pixels along a side, a whole number for each cell. Raises TargetError if no such number is near."""
    pixels = cells * max(1, round(side_mm / cells / pitch_mm))
    if abs(pixels * pitch_mm / side_mm - 1) > SIZE_TOLERANCE:
        raise TargetError(
            f"a target side of {side_mm:g} mm in {cells} cells does not fit pixels of {pitch_mm:g} mm: "
            f"the nearest that does is {pixels * pitch_mm:.4f} mm; give that as target.size_mm"
        )
    return pixels
