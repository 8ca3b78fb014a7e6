"""Raw photographs as exposures of a scene, and whether the session's lens took them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labkit.calibration.calibrate import Calibration, channel_data
from labkit.errors import DataError
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exif import Exif, read_exif
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.plan.sensor import IN_COLOURS
from labkit.restoration.job import Area, Exposure
from labkit.session.frame import Frame

SAME_APERTURE, SAME_FOCAL, SAME_PITCH = (
    0.06,
    0.06,
    0.03,
)  # relative: a third of a stop is 0.12
LEAST_PX = 16  # side of a photograph, or of an area of it


@dataclass(frozen=True, eq=False)
class Shot:
    """An exposure of the scene, and the share of clipped pixels.

    photograph : without its pixels, for what it says of the sensor
    origin : (row, column) of the area's first pixel
    """

    exposure: Exposure
    photograph: Photograph
    clipped: float
    origin: tuple[int, int]

    @property
    def period(self) -> int:
        """Pixels of a side of the filter array's cell."""
        return len(self.photograph.pattern)


def read_shot(
    path: Path,
    plan: Plan,
    area: Area | None,
    names: Sequence[str] = (),
    frame: Frame | None = None,
    calibration: Calibration | None = None,
) -> Shot:
    """Read a photograph.

    Parameters
    ----------
    path, plan : the file and its camera
    area : rows and columns to use, reduced to whole cells; None for all
    names, frame, calibration : of a session's own photograph: its channels, frame, darks and flats

    Raises
    ------
    RawError : the file cannot be read
    DataError : it is demosaiced, or the area is too small
    """
    photograph = read_photograph(path, plan.sensor, area_to_read(area))
    if photograph.pattern == IN_COLOURS:
        raise DataError(
            f"{path.name} is demosaiced: to restore, give the raw file that it was made of"
        )
    cells = _whole_cells(photograph, area, path)
    photograph = photograph.cropped(cells)
    saturated = photograph.saturated
    if frame is None or calibration is None:
        counts = photograph.light.astype(np.float32)
        used = ~saturated
        light = np.ones(saturated.shape, np.float32)
    else:
        counts = np.zeros(saturated.shape, np.float32)
        light = np.ones(saturated.shape, np.float32)
        used = np.zeros(saturated.shape, bool)
        for name in names:
            data = channel_data(calibration, frame, photograph, name, cells)
            here = photograph.channel_mask(name)
            counts[here], light[here] = data.counts[here], data.illumination[here]
            used |= data.mask
    without_pixels = photograph.cropped((slice(0, 0), slice(0, 0)))
    clipped = float(saturated.mean())
    origin = (cells[0].start, cells[1].start)
    return Shot(Exposure(counts, used, light), without_pixels, clipped, origin)


def area_to_read(area: Area | None) -> Cut:
    """Return what is read of a photograph for an area: from an even row and column on, where a cell begins."""
    if area is None:
        return WHOLE
    rows, columns = (slice(max(part.start, 0) // 2 * 2, part.stop) for part in area)
    return rows, columns


def _whole_cells(photograph: Photograph, area: Area | None, path: Path) -> Area:
    """Reduce an area, or all, to whole cells. Raises DataError for an area outside the photograph, or too small."""
    rows, columns = photograph.frame_px
    high, wide = area or (slice(0, rows), slice(0, columns))
    inside = 0 <= high.start < high.stop <= rows and 0 <= wide.start < wide.stop <= columns
    if not inside:
        given = f"{high.start},{wide.start},{high.stop},{wide.stop}"
        raise DataError(
            f"--crop {given}: {path.name} has rows 0 to {rows} and columns 0 to {columns}"
        )
    period = len(photograph.pattern)
    first, last = (
        slice(-(-part.start // period) * period, part.stop // period * period)
        for part in (high, wide)
    )
    if min(first.stop - first.start, last.stop - last.start) < LEAST_PX:
        raise DataError(
            f"{path.name}: a part of {LEAST_PX} x {LEAST_PX} pixels at least is needed"
        )
    return first, last


def refuse_other_camera(path: Path, frames: Sequence[Frame], plan: Plan) -> None:
    """Raise DataError for a file that states another camera or aperture than the session's photographs or plan."""
    theirs = _exif(path)
    own = _exif(frames[0].path) if frames else Exif()
    wrong = [
        f"{what} {stated}, the session's is {usual}"
        for what, stated, usual in (
            ("camera", theirs.camera, own.camera),
            ("camera number", theirs.camera_serial, own.camera_serial),
        )
        if stated and usual and stated != usual
    ]
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
            SAME_PITCH,
        ),
    ):
        if stated and abs(stated / usual - 1) > same:
            wrong.append(f"{what}{stated:g}, the session's is {usual:g}")
    if wrong:
        raise DataError(
            f"{path.name} was taken otherwise than the session: {'; '.join(wrong)}; "
            "its PSF is another: give the session of that lens, or --force"
        )


def _exif(path: Path) -> Exif:
    """Return a file's statements, none if unreadable."""
    try:
        return read_exif(path)
    except OSError:
        return Exif()
