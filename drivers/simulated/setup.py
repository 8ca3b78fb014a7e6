"""Make a bench for a plan: nominal values from the plan, true ones from the seed in the address."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from labkit.devices.context import DeviceContext
from labkit.devices.shared import Lease
from labkit.drivers.simulated.address import ROOM_LIGHT, Orders, ordered
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.image import MOST_AT_ONCE
from labkit.drivers.simulated.view import refuse_wild
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueGrid,
    TrueLens,
    TruePanel,
    TrueRail,
    TrueRoom,
    TrueSensor,
)
from labkit.errors import PlanError
from labkit.jobs.pace import in_words
from labkit.panel import PanelInfo
from labkit.panel.panels import paper_panel, plan_panel
from labkit.panel.picture import panel_picture
from labkit.plan import Plan, RailSettings, TargetSpec
from labkit.target.grid import whole_target

FEWEST_SAMPLES, NEAR_HALO_UM = 4, 200.0
"""To a pixel, and how far light is followed ring by ring, on a sensor rendered in tiles: less of each is less work."""

S_PER_MEGAPIXEL = 25.0
"""Approximate time to render a colour mosaic in tiles on one core."""

ASPECT = 1.5
"""Columns of a whole frame over its rows."""

FRAME_STEP_PX = 8
"""Sides of sensors are multiples of this."""

FINE_SHARE, FINE_PX = 0.10, 24
"""Of the target's size, and pixels, that are rendered finely on each side of a target in a room: nearly twice what a fit
cuts out around the target."""

OFF_MIDDLE = 0.1
"""Largest distance of the panel from the frame's middle, down and right, relative to the frame's sides."""

BEZEL_MM = 12.0
"""Width of the panel's black bezel at least."""

USUAL_ROOM = "bright"

WHITE_COUNTS = 10_350.0
"""Counts of the white panel at the plan's exposure, two thirds of a 14-bit sensor: the lamp is set accordingly."""


def shared_bench(context: DeviceContext, address: str, plan: Plan) -> Lease[Bench]:
    """Lease the bench of a context's devices, at an address such as "simulated:" or
    "simulated:seed=3,camera.timeout=2".

    The bench exists as long as any device is open. Raises PlanError for an address that
    cannot be parsed, or that differs from the context's bench.
    """
    others = [
        key
        for key, part in context.shared.items()
        if isinstance(part, Bench) and key != address
    ]
    if others:
        raise PlanError(
            f'"{address}" and "{others[0]}" are two worlds: give simulated devices the same address'
        )
    lease = context.shared.lease(address, lambda: _bench(address, plan, context.warn))
    if not isinstance(lease.part, Bench):
        lease.close()
        raise PlanError(f'"{address}" is no bench but {type(lease.part).__name__}')
    return lease


def settings_for(plan: Plan, seed: int) -> BenchSettings:
    """Return settings of a bench that suits a plan: target in frame at every range, right exposure.

    Raises PlanError if the plan lacks [rail] or [camera], or its target needs too large a
    sensor.
    """
    if plan.camera is None or plan.rail is None:
        raise PlanError("a simulated bench needs a plan with [camera] and [rail]")
    rng = np.random.default_rng([seed, zlib.crc32(b"plan")])
    glass = plan_panel(plan) or paper_panel(whole_target(plan.target))
    rows, cols = _sensor_size(plan, min(plan.rail.ranges_mm))
    mono = plan.sensor.cfa_pattern == "mono"
    usual = TrueSensor()
    # colours of the mosaic that the plan does not measure need a wavelength all the same
    wavelength_nm = {} if mono else dict(TrueLens().wavelength_nm)
    wavelength_nm |= {channel.name: channel.wavelength_nm for channel in plan.channel}
    black = plan.sensor.black_level
    white = plan.sensor.white_level
    sensor = TrueSensor(
        rows=rows,
        cols=cols,
        pitch_um=plan.sensor.pixel_pitch_um,
        fill_factor=plan.sensor.fill_factor,
        pattern="mono" if mono else plan.sensor.cfa_pattern or "RGGB",
        black_level=usual.black_level if black is None else round(black),
        white_level=usual.white_level if white is None else round(white),
        white_electrons_per_s=WHITE_COUNTS
        / (usual.counts_per_electron * plan.camera.exposure_s * plan.camera.iso / 100),
        colour_response={} if mono else usual.colour_response,
    )
    lens = TrueLens(
        focal_length_mm=plan.lens.focal_length_mm,
        f_number=plan.lens.f_number,
        pupil_magnification=rng.uniform(0.9, 1.1),
        wavelength_nm=wavelength_nm,
        best_focus_mm=_best_focus_mm(wavelength_nm, plan.rail.ranges_mm, rng),
    )
    panel = TruePanel(pixels=glass.pixels, pitch_mm=glass.pitch_mm, gamma=glass.gamma)
    settings = BenchSettings(
        seed=seed,
        lens=lens,
        sensor=sensor,
        panel=panel,
        rail=_rail(plan.rail),
        grid=_grid(plan.target, glass),
    )
    if max(rows, cols) > MOST_AT_ONCE:
        settings = replace(
            settings,
            samples_per_pixel=FEWEST_SAMPLES,
            halo_um=min(NEAR_HALO_UM, settings.halo_um),
        )
    return settings


def _bench(address: str, plan: Plan, warn: Callable[[str], None]) -> Bench:
    orders = ordered(address)
    settings = settings_for(plan, orders.seed)
    if orders.megapixels is not None:
        settings = in_a_room(settings, plan, orders)
    lens = orders.made(settings.lens)
    try:
        settings = replace(settings, lens=lens, patch_px=orders.patch_px)
        refuse_wild(settings)
    except ValueError as error:
        raise PlanError(f'address "{address}": {error}') from error
    rows, cols = settings.fine_shape
    if max(rows, cols) > MOST_AT_ONCE:
        wait = in_words(rows * cols / 1e6 * S_PER_MEGAPIXEL)
        warn(
            f"the simulated camera has {rows} × {cols} pixels, which hold the target: each new picture takes about {wait}"
        )
    return Bench(settings, orders.faults)


def in_a_room(settings: BenchSettings, plan: Plan, orders: Orders) -> BenchSettings:
    """Return settings for a plan with a sensor of 3:2 and as many pixels as ordered, around the one that just holds
    the target.

    Orders must have `megapixels`.
    """
    assert orders.megapixels is not None
    rng = np.random.default_rng([settings.seed, zlib.crc32(b"place in the room")])
    usual = settings.sensor
    rows, cols = (
        FRAME_STEP_PX * round(np.sqrt(orders.megapixels * 1e6 * share) / FRAME_STEP_PX)
        for share in (1 / ASPECT, ASPECT)
    )
    per_pixel = rows * cols / (usual.rows * usual.cols)
    sensor = replace(
        usual,
        rows=rows,
        cols=cols,
        hot_pixels=round(usual.hot_pixels * per_pixel),
        dead_pixels=round(usual.dead_pixels * per_pixel),
    )
    margin = 2 * math.ceil(FINE_SHARE * max(usual.rows, usual.cols) + FINE_PX)
    fine = min(usual.rows + margin, rows), min(usual.cols + margin, cols)
    # the fine pixels stay within the frame
    down, right = (
        rng.uniform(-1, 1) * min(OFF_MIDDLE * count, (count - part) / 2)
        for count, part in zip((rows, cols), fine, strict=True)
    )
    lens = settings.lens
    farthest_mm = max(plan.rail.ranges_mm) if plan.rail else lens.focused_mm
    per_px_mm = sensor.pitch_um * 1e-3 * (farthest_mm / lens.focal_length_mm - 1)
    bezel = tuple(
        max(count * settings.panel.pitch_mm + 2 * BEZEL_MM, (part + FINE_PX) * per_px_mm)
        for count, part in zip(settings.panel.pixels, fine, strict=True)
    )
    light = ROOM_LIGHT[orders.room or USUAL_ROOM]
    room = TrueRoom(light, (down, right), fine, (bezel[0], bezel[1]))
    return replace(settings, sensor=sensor, room=room)


def _grid(target: TargetSpec, glass: PanelInfo) -> TrueGrid:
    """Return the places of a plan's targets on the panel, whose pixels round their distance."""
    if not target.of_many or target.grid is None:
        return TrueGrid()
    shown = panel_picture(whole_target(target), glass)
    return TrueGrid(target.grid, shown.pitch_mm or 1.0)


def _sensor_size(plan: Plan, nearest_mm: float) -> tuple[int, int]:
    """Return (rows, cols), multiples of 8, that hold the target at the nearest range, with a margin for roll
    and aim.
    """
    focal_mm = plan.lens.focal_length_mm
    per_mm = focal_mm / (nearest_mm - focal_mm) / (plan.sensor.pixel_pitch_um * 1e-3)
    high, wide = (side * per_mm for side in whole_target(plan.target).size_mm)
    rows, cols = (
        8 * math.ceil((a + 0.021 * b + 24) / 8) for a, b in ((high, wide), (wide, high))
    )
    return rows, cols


def _best_focus_mm(
    colours: Iterable[str], ranges_mm: tuple[float, ...], rng: np.random.Generator
) -> dict[str, float]:
    """Return best focus in the nearer half of the ranges, a few thousandths different in each colour."""
    near, far = min(ranges_mm), max(ranges_mm)
    middle = near + (far - near) * rng.uniform(0.05, 0.5)
    return {colour: middle * (1 + rng.uniform(-0.002, 0.002)) for colour in colours}


def _rail(rail: RailSettings) -> TrueRail:
    """Return a rail that reaches every range, and a little more on either side."""
    stations = [rail.position_mm(range_mm) for range_mm in rail.ranges_mm]
    return TrueRail(
        low_mm=min(0.0, *stations) - 5.0,
        high_mm=max(0.0, *stations) + 5.0,
        range_at_zero_mm=rail.range_at_zero_mm,
        direction=rail.direction,
    )
