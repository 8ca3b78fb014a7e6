"""The target on a plan's panel, pixel by pixel, for each colour of the camera."""

from __future__ import annotations

from labkit.errors import PlanError, TargetError
from labkit.panel.drawn_target import PanelTarget
from labkit.panel.panels import panel_pitch_mm
from labkit.panel.picture import whole_pixels
from labkit.plan import Plan
from labkit.plan.plan import COLOUR_WORDS
from labkit.target.target import CellTarget, Target


def as_shown(plan: Plan, target: Target, channel: str) -> Target:
    """Draw a plan's target in the stripes of its panel that a channel records.

    Returns
    -------
    the target itself if the plan states no panel pixels

    Raises
    ------
    PlanError : the channel is not a colour, or see `panel_pixels`
    """
    spec = plan.target.pixels
    pixels = panel_pixels(plan, target)
    if spec is None or pixels is None:
        return target
    order, _, way = spec.layout.partition("-")
    colour = COLOUR_WORDS.get(channel.lower())
    if colour is None:
        raise PlanError(
            f'channel "{channel}" is none of R, G and B: [target.pixels] draws the stripe that a colour lights; '
            "take the table out, or name the channel by the colour of its filter"
        )
    shown = PanelTarget.of(target, pixels, order.index(colour.lower()), lying=way == "rows")
    return shown if spec.aperture is None else shown.lit(*spec.aperture)


def pixels_per_cell(plan: Plan, target: Target) -> int | None:
    """Return the number of panel pixels along a side of a target's cell; None if the plan states no panel pixels.

    Raises
    ------
    PlanError : see `panel_pixels`
    """
    pixels = panel_pixels(plan, target)
    if pixels is None:
        return None
    return pixels[0] // target.cells.shape[0] if isinstance(target, CellTarget) else 1


def panel_pixels(plan: Plan, target: Target) -> tuple[int, int] | None:
    """Return the (rows, columns) of panel pixels that a plan's target covers; None if the plan states no panel pixels.

    Raises
    ------
    PlanError : the pitch is unknown or contradicts the display's, or the target is not a whole number of pixels
    """
    pitch_mm = panel_pitch_mm(plan)
    if pitch_mm is None:
        return None
    cells = target.cells.shape if isinstance(target, CellTarget) else (1, 1)
    try:
        down, across = (
            whole_pixels(side, n, pitch_mm)
            for side, n in zip(target.size_mm, cells, strict=True)
        )
    except TargetError as error:
        raise PlanError(
            f"target.pixels: {error}, or correct target.pixels.pitch_mm"
        ) from None
    return down, across
