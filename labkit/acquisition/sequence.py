"""The photographs that a plan needs: their order, ranges and displayed pictures."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from labkit.devices.context import DeviceContext, Devices
from labkit.devices.protocols import Display, OnPaper
from labkit.devices.registry import open_display
from labkit.errors import PlanError
from labkit.panel.picture import PanelPicture, panel_picture
from labkit.plan import CameraSettings, NoiseSettings, Plan, RailSettings
from labkit.session.session import Session
from labkit.target.grid import whole_target
from labkit.target.target import open_target
from labkit.types import FrameKind


@dataclass(frozen=True, slots=True)
class Shot:
    """A photograph to take: its name without the suffix, which the camera chooses; exposure_s: None for the plan's."""

    name: str
    kind: FrameKind
    range_mm: float | None
    exposure_s: float | None = None


def shots(plan: Plan) -> tuple[Shot, ...]:
    """Return all photographs of a plan in order. Raises PlanError without [camera] or [rail]."""
    camera, rail = bench_settings(plan)
    if plan.noise is not None:
        return _ladder(plan.noise, rail.ranges_mm[0])
    every = [Shot(f"dark_{i}", "dark", None) for i in range(camera.darks)]
    for range_mm in rail.ranges_mm:
        every += [
            Shot(f"flat_{range_mm:.10g}_{i}", "flat", range_mm)
            for i in range(camera.flats_per_range)
        ]
        every += [
            Shot(f"target_{range_mm:.10g}_{i}", "target", range_mm)
            for i in range(camera.frames_per_range)
        ]
    return tuple(every)


def _ladder(noise: NoiseSettings, range_mm: float) -> tuple[Shot, ...]:
    """Return the darks, then the flats of a photon-transfer series."""
    kinds: tuple[tuple[FrameKind, float | None], ...] = (("dark", None), ("flat", range_mm))
    return tuple(
        Shot(f"{kind}_{exposure_s:.10g}s_{i}", kind, where, exposure_s)
        for kind, where in kinds
        for exposure_s in sorted(noise.exposures_s)
        for i in range(noise.frames_per_exposure)
    )


def missing(session: Session) -> tuple[Shot, ...]:
    """Return the photographs that the session's plan needs and its journal lacks."""
    done = {Path(frame.file).stem for frame in session.frames}
    return tuple(shot for shot in shots(session.plan) if shot.name not in done)


def picture_for(plan: Plan, devices: Devices) -> PanelPicture:
    """Return the target's picture for the display, before a session begins.

    Raises TargetError or PlanError for a plan that these devices cannot run: a target
    larger than the panel, a range beyond the rail.
    """
    _, rail = bench_settings(plan)
    travel = devices.rail.travel_mm
    beyond = [
        mm
        for mm in rail.ranges_mm
        if not travel.low_mm <= rail.position_mm(mm) <= travel.high_mm
    ]
    if beyond:
        places = ", ".join(
            f"{mm:g} mm (rail position {rail.position_mm(mm):g} mm)" for mm in beyond
        )
        raise PlanError(
            f"rail.ranges_mm has {places}: the rail goes from {travel.low_mm:g} to {travel.high_mm:g} mm, "
            f"ranges {rail.range_mm(travel.low_mm):g} to {rail.range_mm(travel.high_mm):g} mm"
        )
    return shown_picture(plan, devices.display)


def shown_picture(plan: Plan, display: Display) -> PanelPicture:
    """Return the target as a display shows it: on the panel's pixels, or on paper at the plan's size.

    Raises TargetError.
    """
    shown = panel_picture(whole_target(plan.target), display.panel)
    if not isinstance(display, OnPaper):
        return shown
    return replace(
        shown,
        size_mm=open_target(plan.target).size_mm,
        pitch_mm=plan.target.pitch_mm,
    )


@contextmanager
def shown_target(plan: Plan, context: DeviceContext) -> Iterator[Display | None]:
    """Show a plan's target on its display until the end of the block; yield None without a display.

    Raises the driver's errors and TargetError.
    """
    if plan.display is None:
        yield None
        return
    with open_display(plan.display.address, plan, context) as display:
        display.show(shown_picture(plan, display).grey)
        yield display


def next_command(plan: Plan, session: Path) -> str:
    """Return the command that evaluates a session."""
    command = "fit" if plan.noise is None else "noise"
    return shlex.join(["labkit", command, str(session)])


def bench_settings(plan: Plan) -> tuple[CameraSettings, RailSettings]:
    """Return the camera and the rail of a plan. Raises PlanError if the plan lacks one of the two."""
    camera = plan.capture_camera
    if camera is None or plan.rail is None:
        raise PlanError("to capture, the plan needs [camera] and [rail]")
    return camera, plan.rail
