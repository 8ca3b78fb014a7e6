"""Examine a camera by itself, for `labkit camera`: its settings, and the quality of a photograph."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.acquisition.sequence import shown_target
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import (
    Adjustable,
    Camera,
    CameraInfo,
    Check,
    Checkable,
    ExposureSettings,
    Setting,
)
from labkit.devices.registry import open_camera
from labkit.errors import CameraError, TargetError
from labkit.finder.cut import cut_around
from labkit.finder.lattice import find_targets
from labkit.finder.picture import Picture
from labkit.finder.sharpness import blur_px, sharpest_edge_px
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import exposure_problem, pixel_noise
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.plan.sensor import MONO
from labkit.target.target import open_target
from labkit.types import Counts, Floats

BARE = """
lens = {{ focal_length_mm = 50.0, f_number = 8.0 }}
sensor = {{ pixel_pitch_um = 5.0 }}
target = {{ kind = "sierpinski", order = 5, size_mm = 50.0 }}
channel = [{{ name = "G", wavelength_nm = 550.0 }}]
[camera]
address = "{address}"
exposure_s = 0.01
"""
"""A plan with the camera's address only."""

BLOCKS = 8
"""Noise is looked for in 8 × 8 parts of a photograph."""


@dataclass(frozen=True, slots=True)
class LoneCamera:
    """An open camera and its plan. planned: whether the plan states exposure and target."""

    camera: Camera
    plan: Plan
    planned: bool


@dataclass(frozen=True, slots=True)
class ColourReport:
    """One colour of a photograph: counts above black in the middle, the highest count, saturated share, pixel noise."""

    name: str
    median: float
    brightest: float
    full_percent: float
    noise: float


@dataclass(frozen=True, slots=True)
class Sighting:
    """Result of the search for the plan's target in a photograph.

    words: the result in words; place: rows and columns that light and sharpness are judged in, of the target or the whole
    frame; dark: whether there is no light; light: fault of the light, None without one; tiles_px: (n, 4, 2) corners of the
    targets, None if not found; blur_px: diameter of the blur circle on the first one.
    """

    words: str
    place: Cut
    dark: bool
    light: str | None
    tiles_px: Floats | None = None
    blur_px: float | None = None


@dataclass(frozen=True, slots=True)
class FrameReport:
    """A test photograph: its exposure, light and sharpness, and remarks for the user.

    colours: light on the plan's target where it is found, else in the whole frame;
    edge_px: rise of the sharpest edges, pixels; blur_px: diameter of the blur circle on the
    plan's target; each None if not measured. target: result of the search for the target,
    in words.
    """

    exposure_s: float
    iso: int
    pixels: tuple[int, int]
    colours: tuple[ColourReport, ...]
    edge_px: float | None
    blur_px: float | None
    target: str
    problems: tuple[str, ...]
    by_hand: tuple[str, ...]


def open_lone_camera(where: str, context: DeviceContext | None = None) -> LoneCamera:
    """Open the camera of a plan, or at an address such as "gphoto2:".

    Raises PlanError, and the driver's errors.
    """
    path = Path(where)
    planned = path.suffix == ".toml" or path.is_file()
    plan = Plan.load(path) if planned else Plan.parse(BARE.format(address=where), Path())
    camera = plan.capture_camera
    if camera is None:
        raise CameraError(
            f"plan {where} has no [camera]: add it, or give an address such as gphoto2:"
        )
    return LoneCamera(
        open_camera(camera.address, plan, context or DeviceContext()), plan, planned
    )


def camera_settings(where: str = "gphoto2:") -> tuple[CameraInfo, tuple[Setting, ...]]:
    """List what a camera lets be set or read.

    Parameters
    ----------
    where : path of a plan, or a camera's address

    Raises
    ------
    CameraError
        the camera has no settings, or does not answer
    PlanError
        the plan cannot be read

    >>> info, settings = labkit.camera_settings("gphoto2:")
    """
    with open_lone_camera(where).camera as camera:
        return camera.identify(), offered(camera)


def check_camera(
    where: str = "gphoto2:", context: DeviceContext | None = None
) -> FrameReport:
    """Take one photograph and judge it; nothing is kept.

    With a plan its display shows the target first, and the light is judged in its channels.

    Parameters
    ----------
    where : path of a plan, or a camera's address
    context : what drivers are given, for links and warnings

    Raises
    ------
    DeviceError, RawError, PlanError
        of the camera, its photograph, the plan

    >>> labkit.check_camera("plan.toml").edge_px
    """
    context = context or DeviceContext()
    alone = open_lone_camera(where, context)
    plan = alone.plan
    by_hand = plan.display is not None and plan.display.by_hand
    with alone.camera, nullcontext() if by_hand else shown_target(plan, context):
        return take_test_frame(alone)


def offered(camera: Camera) -> tuple[Setting, ...]:
    """Return all settings of a camera. Raises CameraError for a camera without settings."""
    if not isinstance(camera, Adjustable):
        raise CameraError("this camera has no settings to list")
    return camera.settings()


def take_test_frame(alone: LoneCamera) -> FrameReport:
    """Take one photograph and judge it; nothing is kept. Raises the driver's errors, RawError, PlanError."""
    camera = alone.camera
    settings = alone.plan.camera
    assert settings is not None
    camera.identify()
    if alone.planned:
        camera.configure(ExposureSettings(settings.exposure_s, settings.iso))
    with tempfile.TemporaryDirectory() as folder:
        frame = camera.expose(Path(folder) / "test")
        mosaic = read_photograph(frame.path, alone.plan.sensor)
    check = camera.check(1) if isinstance(camera, Checkable) else Check()
    sighting = sighted(mosaic, alone)
    place, light = sighting.place, sighting.light
    return FrameReport(
        exposure_s=frame.exposure_s,
        iso=frame.iso or mosaic.iso or 0,
        pixels=(mosaic.counts.shape[0], mosaic.counts.shape[1]),
        colours=tuple(_colours(mosaic.cropped(place))),
        edge_px=None if sighting.dark else sharpest_edge_px(mosaic, place),
        blur_px=sighting.blur_px,
        target=sighting.words,
        problems=((f"the photograph {light}",) if light else ()) + check.problems,
        by_hand=check.by_hand,
    )


def sighted(mosaic: Photograph, alone: LoneCamera) -> Sighting:
    """Return where a photograph shows the plan's target, how it is blurred, and how the light is there."""
    dark, light = _light_problem(mosaic, alone, WHOLE)
    if dark:
        return Sighting("not looked for: there is no light", WHOLE, dark, light)
    if not alone.planned:
        why = "not looked for: give a plan that describes it"
        return Sighting(why, WHOLE, dark, light)
    picture = Picture.of(mosaic)
    try:
        tiles = find_targets(picture, alone.plan.target)
    except TargetError as error:
        return Sighting(str(error), WHOLE, dark, light)
    # a window beside the target may be overexposed, and a room bright where the target is dark
    rows, columns = cut_around(list(tiles), picture.shape)
    top, left = picture.whole_cells((rows.start, columns.start)).tolist()
    place = slice(top, rows.stop), slice(left, columns.stop)
    dark, light = _light_problem(mosaic, alone, place)
    blur = blur_px(picture, open_target(alone.plan.target), tiles[0])
    return Sighting("found, wholly in the frame", place, dark, light, tiles, blur)


def _light_problem(
    mosaic: Photograph, alone: LoneCamera, place: Cut
) -> tuple[bool, str | None]:
    """Return whether a place is dark, and what is wrong with its light in the plan's channels, if anything."""
    names = _names(mosaic)
    wanted = {channel.name for channel in alone.plan.channel}
    if alone.planned and mosaic.pattern != MONO:
        names = [name for name in names if name in wanted]
    light = exposure_problem(mosaic, "target", names, place)
    if light is None or not light.startswith("is black"):
        return False, light
    return (
        True,
        f"{light}: is the cap on the lens, the target dark, the exposure too short?",
    )


def _names(mosaic: Photograph) -> list[str]:
    return (
        ["mono"]
        if mosaic.pattern == MONO
        else sorted(set(mosaic.cfa), key=mosaic.cfa.index)
    )


def _colours(mosaic: Photograph) -> Iterator[ColourReport]:
    for name in _names(mosaic):
        first = mosaic.planes(name)[0]
        plane = np.ascontiguousarray(mosaic.counts[first])
        black = mosaic.black_of(first)
        yield ColourReport(
            name,
            median=float(np.median(plane)) - black,
            brightest=float(np.percentile(plane, 99.9)) - black,
            full_percent=100 * float(np.mean(plane >= mosaic.white)),
            noise=_noise(plane, mosaic.white),
        )


def _noise(plane: Counts, white: float) -> float:
    """Return the noise of a pixel where the photograph is smooth and not saturated.

    Saturated pixels have no noise.
    """
    blocks = [
        block
        for band in np.array_split(plane, BLOCKS)
        for block in np.array_split(band, BLOCKS, axis=1)
    ]
    return float(
        np.quantile(
            [pixel_noise(block) for block in blocks if block.max() < white] or [0.0], 0.1
        )
    )
