"""Raw photographs as the counts that a scene is restored from, and whether the session's lens took them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labkit.calibration.calibrate import Calibration, channel_data
from labkit.errors import DataError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import Exif, read_exif
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan
from labkit.plan.sensor import IN_COLOURS, MONO
from labkit.restoration.job import Area, Exposure
from labkit.session.frame import Frame
from labkit.types import Floats

SAME_APERTURE, SAME_FOCAL, SAME_SENSOR_PITCH = (
    0.06,
    0.06,
    0.03,
)  # relative: a third of a stop is 0.12
LEAST_PHOTOGRAPH_PX = 16
"""Of a photograph's side, or a cut of it."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One photograph: counts above black, what of them can be used, its light, and how it was exposed."""

    photograph: Exposure
    mosaic: Photograph
    clipped: float


def read_shot(path: Path, plan: Plan, area: Area | None) -> Shot:
    """A photograph, or a cut of it in whole cells. Raises RawError, and DataError where it is no mosaic or too small a cut."""
    mosaic = _mosaic(path, plan)
    rows, columns = cells = whole_cells(mosaic, area, path)
    counts = (mosaic.light)[cells].astype(np.float32)
    clipped = mosaic.saturated[rows, columns]
    photograph = Exposure(counts, ~clipped, np.ones(counts.shape, np.float32))
    return Shot(photograph, mosaic, float(clipped.mean()))


def read_frame(
    frame: Frame,
    plan: Plan,
    calibration: Calibration,
    names: Sequence[str],
    area: Area | None,
) -> Shot:
    """A session's own photograph, with its darks and flats."""
    mosaic = _mosaic(frame.path, plan)
    cells = whole_cells(mosaic, area, frame.path)
    counts, light = (
        np.zeros(mosaic.counts.shape, np.float32),
        np.ones(mosaic.counts.shape, np.float32),
    )
    used = np.zeros(mosaic.counts.shape, bool)
    for name in names:
        data, here = (
            channel_data(calibration, frame, mosaic, name),
            mosaic.channel_mask(name),
        )
        counts[here], light[here] = data.counts[here], data.illumination[here]
        used |= data.mask
    clipped = float(mosaic.saturated[cells].mean())
    return Shot(Exposure(counts[cells], used[cells], light[cells]), mosaic, clipped)


def whole_cells(mosaic: Photograph, area: Area | None, path: Path) -> Area:
    """An area, or all, in whole cells of the filter array. Raises DataError for one outside the photograph, or too small."""
    rows, columns = mosaic.shape
    area = area or (slice(0, rows), slice(0, columns))
    if not (
        0 <= area[0].start < area[0].stop <= rows
        and 0 <= area[1].start < area[1].stop <= columns
    ):
        given = f"{area[0].start},{area[1].start},{area[0].stop},{area[1].stop}"
        raise DataError(
            f"--crop {given}: {path.name} has rows 0 to {rows} and columns 0 to {columns}"
        )
    period = period_of(mosaic)
    first, last = (
        [-(-part.start // period) * period, part.stop // period * period] for part in area
    )
    if min(first[1] - first[0], last[1] - last[0]) < LEAST_PHOTOGRAPH_PX:
        raise DataError(
            f"{path.name}: a part of {LEAST_PHOTOGRAPH_PX} x {LEAST_PHOTOGRAPH_PX} pixels at least is needed"
        )
    return slice(*first), slice(*last)


def period_of(mosaic: Photograph) -> int:
    """Pixels to a cell of the filter array."""
    return 1 if mosaic.pattern == MONO else 2


def refuse_other_camera(
    path: Path, mosaic: Photograph, own: Exif, own_mosaic: Photograph | None, plan: Plan
) -> None:
    """Raise DataError where a photograph's file says that another camera or aperture took it than the session's.

    own, own_mosaic: what a photograph of the session says, where there is one.
    """
    theirs, wrong = _exif(path), []
    camera = own.camera or (own_mosaic.camera if own_mosaic else "")
    if theirs.camera and camera and theirs.camera != camera:
        wrong.append(f"camera {theirs.camera}, the session's is {camera}")
    if (
        theirs.camera_serial
        and own.camera_serial
        and theirs.camera_serial != own.camera_serial
    ):
        wrong.append(
            f"camera number {theirs.camera_serial}, the session's is {own.camera_serial}"
        )
    if own_mosaic is not None and own_mosaic.cfa != mosaic.cfa:
        wrong.append(f"filter array {mosaic.cfa}, the session's is {own_mosaic.cfa}")
    for what, stated, usual, same in (
        ("aperture f/", theirs.f_number, own.f_number or plan.lens.f_number, SAME_APERTURE),
        (
            "focal length in mm ",
            theirs.focal_length_mm,
            own.focal_length_mm or plan.lens.focal_length_mm,
            SAME_FOCAL,
        ),
        (
            "pixel pitch in um ",
            theirs.pixel_pitch_um,
            plan.sensor.pixel_pitch_um,
            SAME_SENSOR_PITCH,
        ),
    ):
        if stated and abs(stated / usual - 1) > same:
            wrong.append(f"{what}{stated:g}, the session's is {usual:g}")
    if wrong:
        raise DataError(
            f"{path.name} was taken otherwise than the session: {'; '.join(wrong)}; "
            "its PSF is another: give the session of that lens, or --force"
        )


def _mosaic(path: Path, plan: Plan) -> Photograph:
    mosaic = read_photograph(path, plan.sensor)
    if mosaic.pattern == IN_COLOURS:
        raise DataError(
            f"{path.name} is demosaiced: to restore, give the raw file that it was made of"
        )
    return mosaic


def _exif(path: Path) -> Exif:
    """What a file says; nothing where it is no kind that says something."""
    try:
        return read_exif(path)
    except OSError:
        return Exif()


def own_exif(frames: Sequence[Frame]) -> Exif:
    """Of the session's photographs."""
    return _exif(frames[0].path) if frames else Exif()


def with_motion(shot: Shot, motion: Floats) -> Exposure:
    """The photograph where it stands beside the first."""
    return replace(shot.photograph, motion=motion)
