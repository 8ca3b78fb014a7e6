"""Photograph again and again for focusing by hand, with sharpness, light and target of each photograph."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labkit.acquisition.camera_check import LoneCamera, open_lone_camera, sighted
from labkit.acquisition.sequence import shown_target
from labkit.devices.context import DeviceContext
from labkit.devices.observer import Observer, Viewer
from labkit.devices.protocols import ExposureSettings, Previewing, Rail
from labkit.devices.registry import observers_of, open_monitor, open_rail
from labkit.errors import PlanError
from labkit.finder.find_target import margin_px
from labkit.finder.preview import Look
from labkit.finder.sharpness import sharpest_edge_px
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, Sensor

LIVE = Sensor(pixel_pitch_um=1.0)
"""Of a picture of the live view, which says all else by itself."""

FRAME_SOURCE = "frame"
LIVE_VIEW_SOURCE = "live view"


@dataclass(frozen=True, slots=True)
class FocusReading:
    """One photograph for focusing. source: FRAME or LIVE_VIEW_SOURCE, whose pixels are not the sensor's.

    edge_px: rise of the sharpest edges in pixels, None without light or edges;
    full_percent: share of saturated pixels; both on the target, if it is found; corners_px: (4, 2) of the target, or of the
    grid's target nearest to the middle, None if not searched or not found; blur_px:
    diameter of the blur circle on it; margin_px: from the targets to the frame's edge;
    note: fault of the light, or why there is no
    target.
    """

    number: int
    source: str
    edge_px: float | None
    full_percent: float
    corners_px: tuple[tuple[float, float], ...] | None
    blur_px: float | None
    margin_px: float | None
    note: str


def watch_focus(
    where: str = "gphoto2:",
    *,
    range_mm: float | None = None,
    page: str | None = None,
    context: DeviceContext | None = None,
) -> Generator[FocusReading, None, None]:
    """Photograph again and again, to focus by hand; nothing is kept.

    With a plan its display shows the target.

    Parameters
    ----------
    where : path of a plan, or a camera's address
    range_mm : range that the plan's rail moves to first; None to leave it
    page : address of an operator's page, such as "web:"; None for none
    context : what drivers are given, for links, warnings and the operator

    Yields
    ------
    a reading for each photograph, until the iterator is closed

    Raises
    ------
    DeviceError, RawError, PlanError
        of devices, photographs, and of a range without a rail or beyond its travel

    >>> for reading in labkit.watch_focus("plan.toml"):
    ...     print(reading.edge_px)
    """
    context = context or DeviceContext()
    with ExitStack() as stack:
        alone = open_lone_camera(where, context)
        stack.enter_context(alone.camera)
        if page is not None:
            monitor = stack.enter_context(open_monitor(page, alone.plan, context))
            context = replace(context, observers=(monitor,))
        opened = list[object]()
        if range_mm is not None:
            opened.append(stack.enter_context(_rail_at(alone.plan, range_mm, context)))
        if alone.plan.display is not None:
            opened.append(stack.enter_context(shown_target(alone.plan, context)))
        yield from focus(alone, observers_of(context, opened))


@contextmanager
def _rail_at(plan: Plan, range_mm: float, context: DeviceContext) -> Iterator[Rail]:
    """Open the plan's rail, home it and move it to a range. Raises PlanError."""
    if plan.rail is None:
        raise PlanError(f"--range {range_mm:g}: to move a rail it takes a plan with [rail]")
    with open_rail(plan.rail.address, plan, context) as rail:
        ends = (rail.travel_mm.low_mm, rail.travel_mm.high_mm)
        nearest_mm, furthest_mm = sorted(map(plan.rail.range_mm, ends))
        if not nearest_mm <= range_mm <= furthest_mm:
            raise PlanError(
                f"--range {range_mm:g}: the rail reaches {nearest_mm:g} to {furthest_mm:g} mm"
            )
        rail.home()
        rail.move_to(plan.rail.position_mm(range_mm))
        yield rail


def focus(
    alone: LoneCamera,
    observers: Sequence[Observer] = (),
    going: Callable[[], bool] = lambda: True,
) -> Iterator[FocusReading]:
    """Photograph and judge again and again while `going`, by the camera's live view if there is one.

    Nothing is kept. Raises the driver's errors, RawError, PlanError.
    """
    camera = alone.camera
    settings = alone.plan.camera
    assert settings is not None
    camera.identify()
    if alone.planned:
        camera.configure(ExposureSettings(settings.exposure_s, settings.iso))
    live = isinstance(camera, Previewing)
    number = 0
    for observer in observers:
        observer.noted("focusing", what="turn the lens until the number is smallest")
    while going():
        number += 1
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"focus_{number}"
            seen = camera.preview(path) if live and isinstance(camera, Previewing) else None
            live = seen is not None
            mosaic = (
                read_photograph(camera.expose(path).path, alone.plan.sensor)
                if seen is None
                else read_photograph(seen, LIVE)
            )
        source = LIVE_VIEW_SOURCE if live else FRAME_SOURCE
        look = Look(f"{source} {number}", None, mosaic)
        _show(look, observers)  # the picture at once: the search may take seconds
        reading = _read(number, source, mosaic, alone)
        corners = None if reading.corners_px is None else np.array([reading.corners_px])
        _show(
            replace(look, corners_px=corners, edge_px=reading.edge_px, note=reading.note),
            observers,
        )
        for observer in observers:
            observer.may_go_on()
        yield reading


def _show(look: Look, observers: Sequence[Observer]) -> None:
    for observer in observers:
        if isinstance(observer, Viewer):
            observer.saw(look)


def _read(number: int, source: str, mosaic: Photograph, alone: LoneCamera) -> FocusReading:
    sighting = sighted(mosaic, alone)
    note, tiles = sighting.light, sighting.tiles_px
    if not note and alone.planned and tiles is None:
        note = "no target found"
    part = mosaic.cropped(sighting.place)
    return FocusReading(
        number=number,
        source=source,
        edge_px=None if sighting.dark else sharpest_edge_px(mosaic, sighting.place),
        full_percent=float(100 * np.mean(part.counts >= mosaic.white)),
        corners_px=None
        if tiles is None
        else tuple((float(row), float(col)) for row, col in tiles[0]),
        blur_px=sighting.blur_px,
        margin_px=None if tiles is None else margin_px(tiles, mosaic.shape),
        note=note or "",
    )
