"""Photograph again and again for focusing by hand, with sharpness, light and target of each photograph."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.acquisition.camera_check import LoneCamera, light_problem
from labkit.devices.observer import Observer, Viewer
from labkit.devices.protocols import ExposureSettings, Previewing
from labkit.errors import TargetError
from labkit.finder.find_target import find_target, grey_image, margin_px
from labkit.finder.preview import Look
from labkit.finder.sharpness import blur_px, sharpest_edge_px
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Sensor
from labkit.target import open_target
from labkit.types import Floats

LIVE = Sensor(pixel_pitch_um=1.0)
"""Of a picture of the live view, which says all else by itself."""

FRAME, LIVE_VIEW = "frame", "live view"


@dataclass(frozen=True, slots=True)
class FocusReading:
    """One photograph for focusing. source: FRAME or LIVE_VIEW, whose pixels are not the sensor's.

    edge_px: rise of the sharpest edges in pixels, None without light or edges;
    full_percent: share of saturated pixels; corners_px: (4, 2) of the target, None if not
    searched or not found; blur_px: diameter of the blur circle on the target; margin_px:
    from the target to the frame's edge; note: fault of the light, or why there is no
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


def focus(
    alone: LoneCamera,
    observers: Sequence[Observer] = (),
    going: Callable[[], bool] = lambda: True,
) -> Iterator[FocusReading]:
    """Photograph and judge again and again while `going`, by the camera's live view if there is one.

    Nothing is kept. Raises the driver's errors, RawError, PlanError.
    """
    camera, settings = alone.camera, alone.plan.camera
    assert settings is not None
    camera.identify()
    if alone.planned:
        camera.configure(ExposureSettings(settings.exposure_s, settings.iso))
    live, number = isinstance(camera, Previewing), 0
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
        reading = _read(number, LIVE_VIEW if live else FRAME, mosaic, alone)
        corners = None if reading.corners_px is None else np.array(reading.corners_px)
        for observer in observers:
            if isinstance(observer, Viewer):
                name = f"{reading.source} {number}"
                observer.saw(
                    Look(name, None, mosaic, corners, reading.edge_px, reading.note)
                )
            observer.may_go_on()
        yield reading


def _read(number: int, source: str, mosaic: Photograph, alone: LoneCamera) -> FocusReading:
    dark, note = light_problem(mosaic, alone)
    corners, blur, margin = (
        (None, None, None) if dark or not alone.planned else _target(mosaic, alone)
    )
    if not note and alone.planned and corners is None:
        note = "no target found"
    return FocusReading(
        number=number,
        source=source,
        edge_px=None if dark else sharpest_edge_px(mosaic),
        full_percent=float(100 * np.mean(mosaic.counts >= mosaic.white)),
        corners_px=None
        if corners is None
        else tuple((float(row), float(col)) for row, col in corners),
        blur_px=blur,
        margin_px=margin,
        note=note or "",
    )


def _target(
    mosaic: Photograph, alone: LoneCamera
) -> tuple[Floats | None, float | None, float | None]:
    """Return the target's corners, its blur circle and its distance from the frame's edge, in pixels."""
    target = open_target(alone.plan.target)
    try:
        grey = grey_image(mosaic.light, mosaic.pattern)
        corners = find_target(grey, target)
    except TargetError:
        return None, None, None
    return corners, blur_px(grey, target, corners), margin_px(corners, grey.shape)
