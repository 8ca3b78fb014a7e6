"""Panels by their makers' data sheets, and the panel that a plan describes."""

from __future__ import annotations

import math

from labkit.devices.protocols import PanelInfo
from labkit.errors import PlanError
from labkit.plan import DisplaySettings, Plan
from labkit.target import CellTarget, Target

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
    """The panel that a plan's [display] table describes. Raises PlanError for a name that is not known."""
    if settings.pixels is not None and settings.pixel_pitch_mm is not None:
        return PanelInfo(settings.pixels, settings.pixel_pitch_mm)
    if settings.panel not in PANELS:
        known = ", ".join(sorted(PANELS))
        raise PlanError(
            f'display.panel = "{settings.panel}": known are {known}; or give pixel_pitch_mm and pixels instead'
        )
    return PANELS[settings.panel]


def plan_panel(plan: Plan) -> PanelInfo | None:
    """The panel that a plan's target is shown on; None without one, or on paper. Raises PlanError."""
    return (
        None if plan.display is None or plan.display.by_hand else panel_info(plan.display)
    )


def paper_panel(target: Target) -> PanelInfo:
    """A sheet of paper, three times as large as the target in its middle, as pixels that are fine beside its cells."""
    cells = target.cells.shape[0] if isinstance(target, CellTarget) else 1
    rows = cells * math.ceil(PAPER_PIXELS / cells)
    pitch_mm = target.size_mm[0] / rows
    side = 3 * math.ceil(max(target.size_mm) / pitch_mm)
    return PanelInfo((side, side), pitch_mm, subpixels="none")


SAME_PITCH = 0.005
"""Relative: pitches that differ by more are those of two panels."""


def panel_pitch_mm(plan: Plan) -> float | None:
    """Of the panel's pixels that a plan wants drawn, as [target.pixels] or else [display] states it; None where none are.

    Raises PlanError where neither states it, or they contradict each other.
    """
    pixels, panel = plan.target.pixels, plan_panel(plan)
    shown = None if panel is None else panel.pitch_mm
    if pixels is None:
        return None
    if pixels.pitch_mm is None:
        if shown is None:
            raise PlanError(
                "target.pixels.pitch_mm is missing: give it, or the panel as [display] panel"
            )
        return shown
    if shown is not None and abs(pixels.pitch_mm / shown - 1) > SAME_PITCH:
        raise PlanError(
            f"target.pixels.pitch_mm = {pixels.pitch_mm:g} contradicts [display], whose panel has pixels of {shown:.4g} mm: "
            "leave pitch_mm out, or correct the one that is wrong"
        )
    return pixels.pitch_mm
