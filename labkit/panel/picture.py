"""A target as a picture for a panel: whole panel pixels for every cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.errors import TargetError
from labkit.panel.panel_info import PanelInfo
from labkit.target import CellTarget, Target

SIZE_TOLERANCE = 0.02
"""A picture may be this much larger or smaller than the plan's target: the fitted pose takes up a common scale."""


@dataclass(frozen=True, slots=True)
class PanelPicture:
    """Grey values (rows, cols) for panel pixels, and the true (height, width) in mm of the target among them."""

    grey: NDArray[np.uint8]
    size_mm: tuple[float, float]


def panel_picture(target: Target, panel: PanelInfo) -> PanelPicture:
    """Return the target on the panel's pixels, as near to its nominal size as whole pixels a cell allow.

    Raises TargetError if no such size is near, if the panel is too small, or if a radiance
    is above white.
    """
    cells = target.cells.shape if isinstance(target, CellTarget) else None
    rows, cols = (
        whole_pixels(target.size_mm[i], cells[i] if cells else 1, panel.pitch_mm)
        for i in range(2)
    )
    if rows > panel.pixels[0] or cols > panel.pixels[1]:
        raise TargetError(
            f"the target takes {rows} × {cols} pixels of {panel.pitch_mm:g} mm; "
            f"the panel has {panel.pixels[0]} × {panel.pixels[1]}: take a smaller target"
        )
    y_mm, x_mm = (
        ((np.arange(n) + 0.5) / n - 0.5) * side
        for n, side in zip((rows, cols), target.size_mm, strict=True)
    )
    radiance = target.radiance(y_mm[:, None], x_mm[None, :])
    if radiance.max() > 1:
        raise TargetError(
            f"the target's radiance goes up to {radiance.max():g}; a panel shows 0 to 1"
        )
    if target.surround:
        framed = np.full(panel.pixels, target.surround)
        top = (panel.pixels[0] - rows) // 2
        left = (panel.pixels[1] - cols) // 2
        framed[top : top + rows, left : left + cols] = radiance
        radiance = framed
    grey = np.rint(255 * radiance ** (1 / panel.gamma)).astype(np.uint8)
    return PanelPicture(grey, (rows * panel.pitch_mm, cols * panel.pitch_mm))


def whole_pixels(side_mm: float, cells: int, pitch_mm: float) -> int:
    """Return the pixels along a side, a whole number for each cell. Raises TargetError if no such number is near."""
    pixels = cells * max(1, round(side_mm / cells / pitch_mm))
    if abs(pixels * pitch_mm / side_mm - 1) > SIZE_TOLERANCE:
        raise TargetError(
            f"a target side of {side_mm:g} mm in {cells} cells does not fit pixels of {pitch_mm:g} mm: "
            f"the nearest that does is {pixels * pitch_mm:.4f} mm; give that as target.size_mm"
        )
    return pixels
