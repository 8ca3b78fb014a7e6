"""Panels by their makers' data sheets, and the panel of a plan."""

from __future__ import annotations

import math

from labkit.errors import PlanError
from labkit.panel import PanelInfo
from labkit.plan import DisplaySettings, Plan
from labkit.target.grid import TargetGrid
from labkit.target.target import CellTarget, Target

PAPER_PIXELS = 500
"""At least, along a target's height on simulated paper."""

PANELS = {
    "ipad-9.7-retina": PanelInfo((1536, 2048), 25.4 / 264),
    "ipad-10.2": PanelInfo((1620, 2160), 25.4 / 264),
    "ipad-pro-11": PanelInfo((1668, 2388), 25.4 / 264),
    "ipad-pro-12.9": PanelInfo((2048, 2732), 25.4 / 264),
    "ipad-mini-8.3": PanelInfo((1488, 2266), 25.4 / 326),
}
"""Panels a plan can name, landscape, by their makers' data sheets."""


def panel_info(settings: DisplaySettings) -> PanelInfo:
    """Return the panel of a plan's [display] table. Raises PlanError for an unknown name."""
    if settings.pixels is not None and settings.pixel_pitch_mm is not None:
        return PanelInfo(settings.pixels, settings.pixel_pitch_mm)
    if settings.panel not in PANELS:
        known = ", ".join(sorted(PANELS))
        raise PlanError(
            f'display.panel = "{settings.panel}": known are {known}; or give pixel_pitch_mm and pixels instead'
        )
    return PANELS[settings.panel]


def plan_panel(plan: Plan) -> PanelInfo | None:
    """Return the panel that shows a plan's target; None without a panel, or on paper. Raises PlanError."""
    return (
        None if plan.display is None or plan.display.by_hand else panel_info(plan.display)
    )


def paper_panel(target: Target) -> PanelInfo:
    """Return a sheet of paper, three times as large as the target, as pixels finer than the target's cells."""
    alone = target.tile if isinstance(target, TargetGrid) else target
    cells = alone.cells.shape[0] if isinstance(alone, CellTarget) else 1
    share = alone.size_mm[0] / target.size_mm[0]
    pitch_mm = alone.size_mm[0] / (cells * math.ceil(share * PAPER_PIXELS / cells))
    side = 3 * math.ceil(max(target.size_mm) / pitch_mm)
    return PanelInfo((side, side), pitch_mm, subpixels="none")


SAME_PANEL_PITCH = 0.005
"""Largest relative difference of two pitches of the same panel."""


def panel_pitch_mm(plan: Plan) -> float | None:
    """Return the pitch of the panel pixels that a plan models, from [target.pixels] or [display]; else None.

    Raises PlanError if neither table states the pitch, or if the two contradict each other.
    """
    pixels = plan.target.pixels
    panel = plan_panel(plan)
    shown = None if panel is None else panel.pitch_mm
    if pixels is None:
        return None
    if pixels.pitch_mm is None:
        if shown is None:
            raise PlanError(
                "target.pixels.pitch_mm is missing: give it, or the panel as [display] panel"
            )
        return shown
    if shown is not None and abs(pixels.pitch_mm / shown - 1) > SAME_PANEL_PITCH:
        raise PlanError(
            f"target.pixels.pitch_mm = {pixels.pitch_mm:g} contradicts [display], whose panel has pixels of {shown:.4g} mm: "
            "leave pitch_mm out, or correct the one that is wrong"
        )
    return pixels.pitch_mm
