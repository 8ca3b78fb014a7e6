"""Remarks on a plan for its owner, one line each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from labkit.advice.expected_fit import Setup
from labkit.advice.outlook import LENS_NUMBERS, Outlook, Proposal
from labkit.analysis.target_tiles import LARGEST_WHOLE_PX, TILE_PX
from labkit.errors import TargetError
from labkit.panel.panels import plan_panel
from labkit.panel.picture import panel_picture
from labkit.panel.stripe_contrast import LEAST_STRIPE_CONTRAST, stripe_contrast
from labkit.plan import Channel, Plan
from labkit.plan.sensor import BAYER
from labkit.target.grid import open_grid

if TYPE_CHECKING:
    from labkit.advice.advise import RangeAdvice

FEWEST_PX = 40  # of the target's side: smaller ones are warned of
ENOUGH_PX = 60  # from here on fits are reliable
TILE_COST = (
    0.15  # time of a further tile, of that of the first, which is searched from nothing
)
MOST_PX = 10_000  # across the widest sensors
MOST_NAMED = 4  # undetermined parameters that are named; more are counted

ASSUMED = {
    "mono": "a mono sensor",
    BAYER: "a Bayer filter array: a quarter of the pixels red, half green, a quarter blue",
}
"""Filter arrays that `Sensor.assumed_pattern` names, in words."""


def notes_of(
    setup: Setup,
    channel: Channel,
    advised: Sequence[RangeAdvice],
    session: Outlook | None,
    proposal: Proposal,
    want_waves: float | None,
    frames: int | None,
) -> Iterator[str]:
    """Yield all remarks.

    channel: of the shortest wavelength; want_waves, frames: a requested error, and the
    photographs it needs
    """
    plan = setup.plan
    if session is not None:
        yield from _lens_notes(session, proposal)
    yield from _carpet_notes(plan, advised)
    yield from _size_notes(plan, advised, want_waves)
    yield from _fit_notes(advised)
    yield from _grid_notes(plan, advised)
    yield from _display_notes(plan, advised)
    yield from _sampling_notes(plan, channel)
    if frames is not None and want_waves is not None and frames > setup.frames:
        worst = max(at.std_wavefront_waves for at in advised)
        yield (
            f"{frames} photographs a range, or {frames / setup.frames:.3g} times the light, would bring the wavefront's "
            f"standard error from {worst:.2g} to {want_waves:g} waves"
        )


def _lens_notes(session: Outlook, proposal: Proposal) -> Iterator[str]:
    """Yield remarks on weakly determined quantities of the lens, and on measurements that would help."""
    for key in session.open_numbers():
        name, unit = LENS_NUMBERS[key]
        better = {remedy.what: remedy.std[key] for remedy in session.worthwhile(key)}
        if key == "pupil_magnification" and proposal.ranges_mm:
            better[proposal.what] = proposal.std[key]
        would = "; ".join(
            f"{what} would make it ± {std:.2g}{unit}" for what, std in better.items()
        )
        would = (
            would
            or "no measurement beside the photographs would halve that; more light or a larger target may"
        )
        yield f"these ranges hardly determine the {name}, ± {session.std[key]:.2g}{unit}: {would}"


def _carpet_notes(plan: Plan, advised: Sequence[RangeAdvice]) -> Iterator[str]:
    order = plan.target.order
    if plan.target.kind != "sierpinski" or order is None:
        return
    lowest = min(at.order for at in advised)
    if order > lowest:
        yield (
            f"order {order} has cells smaller than the Airy disc: order {lowest} is nearly as good, "
            "and prints and shows more easily"
        )
    elif order < lowest:
        yield f"order {lowest} would be resolved too, and holds more fine detail than order {order}"


def _size_notes(
    plan: Plan, advised: Sequence[RangeAdvice], want_waves: float | None
) -> Iterator[str]:
    smallest = min(at.size_px for at in advised)
    nearest = max(advised, key=lambda at: at.size_px)
    largest = nearest.size_px
    mm_per_px = plan.target.size_mm / largest
    if smallest < FEWEST_PX:
        wide = ENOUGH_PX / smallest * plan.target.size_mm
        yield f"the target spans {smallest:.0f} pixels only: about {wide:.3g} mm would span {ENOUGH_PX}"
    elif largest < TILE_PX and not plan.target.of_many:
        yield (
            f"the target spans up to {largest:.0f} pixels: {TILE_PX * mm_per_px:.3g} mm would span {TILE_PX:.0f}, and make the "
            f"wavefront's errors {TILE_PX / largest:.1f} times smaller"
        )
    if largest > MOST_PX:
        yield f"the target spans {largest:.0f} pixels: no sensor holds all of it; choose a smaller one"
    elif nearest.tiles > 1 and not plan.target.of_many:
        yield (
            f"the target spans {largest:.0f} pixels: up to {nearest.tiles} tiles of it are fitted, which takes some "
            f"{1 + TILE_COST * (nearest.tiles - 1):.1f} times as long as a target of {LARGEST_WHOLE_PX * mm_per_px:.3g} mm, "
            f"{LARGEST_WHOLE_PX:.0f} pixels, and shows how the wavefront changes over the part of the frame that the target "
            f"covers; for one wavefront the smaller target is as good"
        )
    yield from _wanted_notes(plan, advised, want_waves)


def _wanted_notes(
    plan: Plan, advised: Sequence[RangeAdvice], want_waves: float | None
) -> Iterator[str]:
    """Yield the size of a target that is fitted whole and gives a requested error."""
    worst = max(advised, key=lambda at: at.std_wavefront_waves)
    if want_waves is None or not worst.std_wavefront_waves > want_waves:
        return
    side_px = min(worst.size_px, TILE_PX if worst.tiles > 1 else worst.size_px)
    wanted_px = side_px * worst.std_wavefront_waves / want_waves
    if wanted_px <= LARGEST_WHOLE_PX:
        size_mm = wanted_px / worst.size_px * plan.target.size_mm
        yield (
            f"a target of {size_mm:.3g} mm, {wanted_px:.0f} pixels at {worst.range_mm:g} mm, would bring the wavefront's "
            f"standard error to {want_waves:g} waves in as many photographs"
        )


def _grid_notes(plan: Plan, advised: Sequence[RangeAdvice]) -> Iterator[str]:
    """Yield how many pixels a grid of targets takes, and whether the display holds the grid."""
    grid = open_grid(plan.target)
    if grid is None:
        return
    nearest = max(advised, key=lambda at: at.size_px)
    rows, cols = (side * nearest.size_px / plan.target.size_mm for side in grid.size_mm)
    yield (
        f"at {nearest.range_mm:g} mm the grid spans {rows:.0f} × {cols:.0f} pixels: the field beyond is not measured, "
        "and targets that the frame cuts are left out"
    )
    panel = plan_panel(plan)
    try:
        if panel is not None:
            panel_picture(grid, panel)
    except TargetError as error:
        yield f"on the display {error}"


def _fit_notes(advised: Sequence[RangeAdvice]) -> Iterator[str]:
    for at in advised:
        if many := len(at.undetermined):
            what = ", ".join(at.undetermined)
            if many > MOST_NAMED:
                what = f"{many} combinations of wavefront, pose and light"
            yield f"at {at.range_mm:g} mm the photographs do not determine: {what}"


def _display_notes(plan: Plan, advised: Sequence[RangeAdvice]) -> Iterator[str]:
    panel = plan_panel(plan)
    if panel is None:
        return
    order = plan.target.order
    pitch_mm = panel.pitch_mm
    if plan.target.kind == "sierpinski" and order:
        cell_mm = plan.target.size_mm / 3**order
        if cell_mm < pitch_mm:
            yield (
                f"cells of {cell_mm:.3g} mm are finer than the display's pixels, {pitch_mm:.3g} mm: show order "
                f"{order} at {3**order * pitch_mm:.3g} mm or more, or a lower order"
            )
    if plan.target.pixels is not None:
        return
    seen = {
        at.range_mm: stripe_contrast(plan, pitch_mm, at.range_mm, at.defocus_waves)
        for at in advised
    }
    range_mm = max(seen, key=seen.__getitem__)
    if seen[range_mm] > LEAST_STRIPE_CONTRAST:
        pixels = f'pixels = {{ pitch_mm = {pitch_mm:.4g}, layout = "rgb-stripes" }}'
        yield (
            f"at {range_mm:g} mm the display's own pixels will be seen with {seen[range_mm]:.0%} of contrast, if they are "
            f"striped, and the plan has no [target.pixels]: add {pixels} to [target], the layout as the frame shows it"
        )


def _sampling_notes(plan: Plan, channel: Channel) -> Iterator[str]:
    sensor = plan.sensor
    nyquist_um = channel.wavelength_nm * 1e-3 * plan.lens.f_number / 2
    times = sensor.pixels(channel.name).spacing_px * sensor.pixel_pitch_um / nyquist_um
    yield f"a channel's pixels are {times:.1f} times as far apart as Nyquist requires: aliasing, which the fit models"
    if sensor.cfa_pattern is None:
        assumed = ASSUMED[sensor.assumed_pattern(channel.name)]
        yield f"sensor.cfa_pattern is left to the files; assumed is {assumed}"
