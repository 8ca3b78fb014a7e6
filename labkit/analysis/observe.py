"""What a session's frames say, ready to be fitted: corrected, the target found, cut to what matters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from labkit.calibration.calibrate import Calibration, ChannelData, calibrate, channel_data
from labkit.errors import DataError, TargetError
from labkit.finder.find_target import find_target, grey_image
from labkit.imaging.warp import Pose
from labkit.inference.fisher_scoring import NoisePrior
from labkit.inference.likelihood import FrameData, low_orders
from labkit.optics.lens import ThinLens, ground_sample_mm
from labkit.plan import Plan
from labkit.raw.decode import read_raw
from labkit.raw.mosaic import Mosaic
from labkit.session.session import Frame, Session
from labkit.target import Target
from labkit.types import Bools, Floats, Progress

MARGIN = 0.06  # of the target's size: surround that is kept around it, for the ambient light and the halo
MARGIN_PX = 10
INSET = 0.04  # of the target's size: what is left out along its edge where the surround is unknown
INSET_PX = 4
UNKNOWN_NOISE_STD = 2.0  # relative, of gain and read variance that no flat or dark tells
ROUNDING_VARIANCE = 1 / 12  # of whole counts; the read noise comes without it
ELECTRONS_AT_WHITE = 40_000  # of a usual pixel, the starting point where no flat tells the gain


@dataclass(frozen=True)
class Observation:
    """The frames of one channel at one range, cut to the target, and where it stands in them.

    range_mm: as planned, which names it. measured_range_mm: as the rail's scale had it, where it said; else the same.
    names: of the files. poses: in pixels of the cut. places: (row, column) of the channel's planes in the cut,
    each of which repeats every `period` pixels.
    """

    range_mm: float | None
    measured_range_mm: float | None
    channel: str
    names: tuple[str, ...]
    frames: tuple[FrameData, ...]
    poses: tuple[Pose, ...]
    noise: NoisePrior
    places: tuple[tuple[int, int], ...]
    period: int


def observe(
    session: Session, target: Target, *, range_mm: float | None, channel: str | None, progress: Progress
) -> tuple[list[Observation], list[str]]:
    """All observations of a session, or only those of a range or channel; and warnings of what was assumed.

    Raises DataError where there is nothing to fit, TargetError where a frame does not show the target.
    """
    plan = session.plan
    shots = _chosen(session, range_mm)
    channels = [c.name for c in plan.channel if channel in (None, c.name)]
    if not channels:
        raise DataError(f"channel {channel}: allowed are {', '.join(c.name for c in plan.channel)}")
    calibration = calibrate(session)
    warnings = list(calibration.warnings)
    found: list[Observation] = []
    ranges = list(dict.fromkeys(frame.range_mm for frame in shots))
    for done, one in enumerate(ranges):
        progress(done, len(ranges), "finding the target")
        group = [frame for frame in shots if frame.range_mm == one]
        corners = [_locate(frame, plan, target) for frame in group]
        found += [_observation(calibration, plan, target, group, corners, name) for name in channels]
    return found, list(dict.fromkeys(warnings))


def _chosen(session: Session, range_mm: float | None) -> list[Frame]:
    shots = [f for f in session.frames if f.kind == "target"]
    if not shots:
        raise DataError(f"{session.folder} has no target frames: there is nothing to fit")
    chosen = [f for f in shots if range_mm is None or f.range_mm == range_mm]
    if not chosen:
        known = ", ".join(sorted({f"{f.range_mm:g}" for f in shots if f.range_mm is not None}))
        raise DataError(f"no target frames at {range_mm:g} mm: the session has {known or 'none with a range'}")
    return sorted(chosen, key=lambda f: (f.range_mm is not None, f.range_mm or 0.0, f.file))


def _locate(frame: Frame, plan: Plan, target: Target) -> Floats:
    """Corners (4, 2) of the target in a frame, in pixels."""
    if plan.target.corners_px is not None:
        return np.array(plan.target.corners_px, float)
    mosaic = read_raw(frame.path, plan.sensor)
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    scale = (
        None if frame.range_mm is None else float(ground_sample_mm(lens, frame.range_mm, plan.sensor.pixel_pitch_um))
    )
    try:
        return find_target(grey_image(mosaic.counts - mosaic.black_map(), mosaic.pattern), target, mm_per_pixel=scale)
    except TargetError as error:
        raise TargetError(f"{frame.file}: {error}") from error


def _observation(
    calibration: Calibration,
    plan: Plan,
    target: Target,
    group: Sequence[Frame],
    corners: Sequence[Floats],
    channel: str,
) -> Observation:
    data = [channel_data(calibration, frame, channel) for frame in group]
    rows, columns = _cut(corners, data[0].counts.shape)
    outline = Pose.from_corners
    poses = tuple(outline(c, target.size_mm).shifted(rows.start, columns.start) for c in corners)
    frames = []
    for one, pose, frame in zip(data, poses, group, strict=True):
        used = one.mask[rows, columns]
        if target.surround is None:
            used = used & _inside(pose, used.shape)
        if used.sum() < 100:
            raise DataError(f"{frame.file}: only {used.sum()} usable pixels of channel {channel} on the target")
        known = FrameData(
            one.counts[rows, columns], used, one.illumination[rows, columns], one.relative_std[rows, columns]
        )
        frames.append(known if calibration.illumination else replace(known, departures=low_orders(*used.shape)))
    mosaic = read_raw(group[0].path, plan.sensor)
    period = 1 if len(mosaic.pattern) == 1 else 2
    places = ((0, 0),) if period == 1 else mosaic.places(channel)  # the cut begins on an even row and column
    names = tuple(frame.file for frame in group)
    return Observation(
        group[0].range_mm,
        _measured(group),
        channel,
        names,
        tuple(frames),
        poses,
        _noise(data[0], mosaic),
        places,
        period,
    )


def _measured(group: Sequence[Frame]) -> float | None:
    readings = [float(frame.meta["measured_range_mm"]) for frame in group if "measured_range_mm" in frame.meta]
    return float(np.mean(readings)) if readings else group[0].range_mm


def _cut(corners: Sequence[Floats], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns around the target in all frames, beginning at even ones."""
    every = np.concatenate(list(corners))
    size = np.ptp(every, axis=0).max()
    margin = max(MARGIN_PX, MARGIN * size)
    low = np.maximum(np.floor(every.min(axis=0) - margin), 0).astype(int) // 2 * 2
    high = np.minimum(np.ceil(every.max(axis=0) + margin).astype(int) + 1, shape)
    high -= (high - low) % 2
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))


def _inside(pose: Pose, shape: tuple[int, ...]) -> Bools:
    """Pixels that see nothing but the target."""
    corners = pose.corners_px()
    polygon = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(polygon, np.round(corners[:, ::-1]).astype(np.int32), 1)
    inset = int(np.ceil(max(INSET_PX, INSET * np.ptp(corners, axis=0).max())))
    framed = cv2.copyMakeBorder(polygon, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    eroded = cv2.erode(framed, np.ones((2 * inset + 1, 2 * inset + 1), np.uint8), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(eroded[1:-1, 1:-1] > 0)


def _noise(data: ChannelData, mosaic: Mosaic) -> NoisePrior:
    """The noise as flats and darks tell it; wide open where they do not."""
    gain, gain_std = data.gain, data.gain_std
    read, read_std = data.read_noise, data.read_noise_std
    white = mosaic.white - float(np.mean(mosaic.black))
    return NoisePrior(
        gain if gain else white / ELECTRONS_AT_WHITE,
        max(gain_std / gain, 1e-3) if gain and gain_std else UNKNOWN_NOISE_STD,
        read**2 + ROUNDING_VARIANCE if read else max(1.0, (white / 4000) ** 2),
        max(2 * read_std / read, 1e-3) if read and read_std else UNKNOWN_NOISE_STD,
    )
