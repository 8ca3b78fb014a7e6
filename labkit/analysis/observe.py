"""Prepare a session's frames for fits: calibrate, find the target, and cut to the target."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from labkit.analysis.locate import Corners, locate, locate_all
from labkit.analysis.neighbours import only_own, with_marks, with_neighbours
from labkit.analysis.surround import is_surround_clean, surround_findings
from labkit.analysis.target_places import Places, of_one_place, places_in_frame
from labkit.analysis.target_tiles import (
    TargetPart,
    cut_finding,
    middle_part,
    target_parts,
)
from labkit.analysis.tile_registration import bends_of_parts, one_colour, register_part
from labkit.calibration.calibrate import (
    Calibration,
    ChannelData,
    by_range,
    calibrate,
    channel_data,
)
from labkit.calibration.needed import Needed
from labkit.calibration.photon_transfer import (
    ROUNDING_VARIANCE,
    UNKNOWN_NOISE_STD,
    NoiseEstimate,
    usual_gain,
    usual_read_variance,
)
from labkit.errors import DataError
from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData, low_orders
from labkit.estimation.observation import Observation
from labkit.finder.cut import (
    cut_around,
    cut_within,
    sees_target_only,
)
from labkit.finder.plausibility import Sight, refuse_contradictions
from labkit.findings.findings import Finding, at_range, each_once, found, surround_uneven
from labkit.imaging.brightness import Brightness
from labkit.imaging.warp import Pose
from labkit.jobs.execute import Run
from labkit.key import Key, Tile, same_range
from labkit.panel.target_pixels import as_shown
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import is_constant
from labkit.photographs.photograph import Cut, Photograph
from labkit.plan import Plan
from labkit.session.frame import Frame, distinct
from labkit.session.session import Session
from labkit.target.grid import TargetGrid, open_grid, open_marked
from labkit.target.target import Target
from labkit.types import Bools, Floats, Progress, no_progress

LEAST_TARGET_PIXELS = 100  # usable ones on the target

LEAST_TILE_PX = 16

LEAST_BRIGHT_SHARE = 0.5
"""Of the brighter pixels on a tile's target, that are usable: where white is clipped, little but black is left."""


@dataclass(frozen=True)
class _Shot:
    """The part of a photograph that shows the target, with the corners (in the frame) of every tile found."""

    frame: Frame
    mosaic: Photograph
    corners_px: Corners


@dataclass(frozen=True)
class _Region:
    """A part of the photographs fitted.

    Attributes
    ----------
    tile : None for a target fitted alone
    corners_px : (4, 2) of the target in each photograph
    cut : of the photographs
    part : of the target; None for the whole
    bend : of the part by the lens's distortion, see `Pose`; None where that is not known
    """

    tile: Tile | None
    corners_px: list[Floats]
    cut: Cut
    part: TargetPart | None = None
    bend: Floats | None = None


def observe(
    session: Session,
    plan: Plan,
    target: Target,
    *,
    range_mm: float | Sequence[float] | None = None,
    channel: str | Sequence[str] | None = None,
    run: Run | None = None,
    progress: Progress = no_progress,
) -> tuple[list[Observation], list[Finding]]:
    """Prepare observations of a session.

    The target is searched for in all photographs first. Of each photograph, dark and flat only the part that the target needs
    is then kept: that of one range and one place at a time.

    Parameters
    ----------
    session : the session
    plan : lens, sensor and channels: the session's plan or another one
    target : the target of the plan
    range_mm, channel : one, several, or None for all
    run : maps the searches for the target over processes of this machine; None to search in this process
    progress : called with the step under way

    Returns
    -------
    observations, range by range, and findings about assumptions

    Raises
    ------
    SessionError : one photograph counts as two frames
    DataError : nothing to fit, or the target's sizes contradict plan and ranges
    TargetError : a frame does not show the target
    """
    photographs, again = distinct(
        session.frames,
        lambda frame: is_constant(read_photograph(frame.path, plan.sensor)),
    )
    frames, channels = selected(photographs, plan, range_mm, channel)
    # a panel that is impossible is refused before photographs are looked at
    for name in channels:
        as_shown(plan, target, name)
    groups = by_range(sorted(frames, key=lambda frame: frame.file)).values()
    known = _locate_each([*chain(*groups)], plan, target, run, progress)
    places, at_places = _places(groups, plan, known)
    known |= places
    needed = {group[0].range_mm: _needed(group, known) for group in groups}
    calibration = calibrate(photographs, plan, needed, progress)
    whole = open_grid(plan.target) or open_marked(plan.target)
    observations: list[Observation] = []
    sights = list[Sight]()
    together = [one for group in groups for one in of_one_place(group, places)]
    findings = [*again, *calibration.findings, *at_places]
    parts = list[TargetPart]()
    for done, group in enumerate(together):
        progress(done, len(together), "reading the target's photographs")
        shots = _shots(group, plan, known)
        if done == 0:  # the nearest range, where the target is largest
            parts, in_parts = _parts(shots, plan, target)
            findings += in_parts
        sights += _sights(shots)
        regions, left_out = _regions(shots, plan, target, parts)
        findings += left_out
        for name in channels:
            for region in regions:
                made, assumed = _of_region(calibration, target, shots, name, region, whole)
                observations += [
                    replace(of, order=min(map(frames.index, group))) for of in made
                ]
                findings += assumed
    refuse_contradictions(sights, plan, target.size_mm)
    findings += surround_findings(plan.target.surround, target, observations)
    return observations, each_once(findings)


def _shots(group: Sequence[Frame], plan: Plan, known: Mapping[str, Corners]) -> list[_Shot]:
    """Read the part of photographs that a fit looks at."""
    cut = _needed(group, known).cut
    return [
        _Shot(frame, read_photograph(frame.path, plan.sensor, cut), known[frame.file])
        for frame in group
    ]


def _sights(shots: Sequence[_Shot]) -> list[Sight]:
    """Return the targets in photographs of a range; none without a range."""
    if (range_mm := _measured([shot.frame for shot in shots])) is None:
        return []
    return [Sight(range_mm, at) for shot in shots for at in shot.corners_px.values()]


def selected(
    frames: Sequence[Frame],
    plan: Plan,
    range_mm: float | Sequence[float] | None,
    channel: str | Sequence[str] | None,
) -> tuple[list[Frame], list[str]]:
    """Return the target frames at some ranges, and the names of some channels in the plan's order.

    Parameters
    ----------
    frames : of the session
    plan : names the channels
    range_mm, channel : one, several, or None for all

    Raises
    ------
    DataError : a range or a channel is absent, or none is requested
    """
    targets = [frame for frame in frames if frame.kind == "target"]
    if not targets:
        raise DataError("the session has no target frames: there is nothing to fit")
    known = [c.name for c in plan.channel]
    names = known if channel is None else [channel] if isinstance(channel, str) else channel
    absent = ", ".join(name for name in names if name not in known)
    if absent or not names:
        raise DataError(f"channel {absent or 'is empty'}: allowed are {', '.join(known)}")
    names = [name for name in known if name in names]
    if range_mm is None:
        return targets, names
    wanted = np.atleast_1d(np.asarray(range_mm, dtype=np.float64)).tolist()
    if not wanted:
        raise DataError(
            "range_mm is empty: give one range or more, or None for all of them"
        )
    ranges = {frame.range_mm for frame in targets}
    absent = ", ".join(
        f"{mm:g}" for mm in wanted if not any(same_range(one, mm) for one in ranges)
    )
    if absent:
        has = ", ".join(f"{mm:g}" for mm in sorted(mm for mm in ranges if mm is not None))
        raise DataError(
            f"no target frames at {absent} mm: the session has {has or 'none with a range'}"
        )
    at = [f for f in targets if any(same_range(f.range_mm, mm) for mm in wanted)]
    return at, names


def _parts(
    shots: Sequence[_Shot], plan: Plan, target: Target
) -> tuple[list[TargetPart], list[Finding]]:
    """Return the parts of a single target fitted at all ranges, none if it is fitted whole, and a finding about them.

    shots : of the nearest range
    """
    if open_grid(plan.target) is not None:
        return [], []
    corners = [at for shot in shots for at in shot.corners_px.values()]
    parts = target_parts(corners, plan.field, target, shots[0].mosaic.frame_px)
    return parts, cut_finding(parts, corners[0], plan.field)


def _regions(
    shots: Sequence[_Shot], plan: Plan, target: Target, parts: Sequence[TargetPart]
) -> tuple[list[_Region], list[Finding]]:
    """Return the observations of a range, and findings about a grid's missing targets.

    Observations are a grid's targets in all photographs, parts of a single target, or the whole target.
    """
    shape = shots[0].mosaic.frame_px
    tiles = [
        tile for tile in shots[0].corners_px if all(tile in s.corners_px for s in shots)
    ]
    corners = {tile: [shot.corners_px[tile] for shot in shots] for tile in tiles}
    if (grid := open_grid(plan.target)) is None:
        ((place, whole),) = corners.items()
        if place is not None and parts:
            parts = [replace(middle_part(parts), tile=place)]
        elif place is not None:
            return [_Region(place, whole, cut_around(whole, shape))], []
        cut_up = _cut_up(whole, parts, shape)
        registered = [_registered(region, shots, target) for region in cut_up]
        return _bent(registered, shape, target), []
    regions = [_Region(tile, of, cut_around(of, shape)) for tile, of in corners.items()]
    absent = sorted(set(np.ndindex(grid.grid)) - {*tiles})
    if not absent:
        return regions, []
    range_mm = shots[0].frame.range_mm
    words = {"at": at_range(range_mm), "named": ", ".join(map(str, absent))}
    return regions, [
        found(
            "tiles-not-found",
            None,
            words,
            range_mm=range_mm,
            tiles=[list(tile) for tile in absent],
            count=len(absent),
            every=grid.grid[0] * grid.grid[1],
        )
    ]


def _registered(region: _Region, shots: Sequence[_Shot], target: Target) -> _Region:
    """Return a part of a target with the target's corners by this part alone, which distortion moves."""
    if region.part is None:
        return region
    corners = [
        _register_in(shot.mosaic, target, region.part, one)
        for shot, one in zip(shots, region.corners_px, strict=True)
    ]
    return replace(region, corners_px=corners)


def _bent(
    regions: Sequence[_Region], shape: tuple[int, int], target: Target
) -> list[_Region]:
    """Return registered parts of a target with their bends by the lens's distortion, which their places show."""
    corners = {r.part: r.corners_px for r in regions if r.part is not None}
    bends = bends_of_parts(shape, target.size_mm, corners)
    return [replace(r, bend=None if r.part is None else bends.get(r.part)) for r in regions]


def _register_in(
    photograph: Photograph, target: Target, part: TargetPart, corners: Floats
) -> Floats:
    """Return the target's corners in the frame by a part alone, in a photograph that may be a cut of the frame."""
    counts, period = one_colour(photograph)
    own = register_part(counts, period, target, part, corners - photograph.origin_px)
    return own + photograph.origin_px


def _cut_up(
    corners: list[Floats], parts: Sequence[TargetPart], shape: tuple[int, ...]
) -> Iterator[_Region]:
    """Yield the parts of a single target, each the same in all photographs; or the whole target if there are none."""
    if not parts:
        yield _Region(None, corners, cut_around(corners, shape))
    for part in parts:
        inside = [part.corners(Pose.from_corners(one, (2.0, 2.0))) for one in corners]
        yield _Region(part.tile, corners, cut_within(inside, shape), part)


def _locate_each(
    frames: Sequence[Frame],
    plan: Plan,
    target: Target,
    run: Run | None,
    progress: Progress,
) -> dict[str, Corners]:
    """Return the corners of every tile in each photograph by its file: as the plan states them, or as they are found."""
    if (stated := plan.target.corners_px) is not None:
        return {frame.file: {None: np.array(stated, float)} for frame in frames}
    known = {} if run is None else locate_all(frames, plan, target, run, progress)
    for done, frame in enumerate(frames):
        if frame.file not in known:  # its process was killed: alone it has room
            progress(done, len(frames), "finding the target")
            known[frame.file] = _locate_alone(frame, plan, target)
    return known


def _locate_alone(frame: Frame, plan: Plan, target: Target) -> Corners:
    """Return the corners in a photograph, whose frame is in memory meanwhile."""
    whole = read_photograph(frame.path, plan.sensor)
    return locate(whole, frame.path, frame.range_mm, plan, target)


def _needed(group: Sequence[Frame], known: Mapping[str, Corners]) -> Needed:
    """Return the part of the frame that holds every region of some photographs."""
    return Needed.by_targets(at for one in group for at in known[one.file].values())


def _places(
    groups: Collection[Sequence[Frame]], plan: Plan, known: Mapping[str, Corners]
) -> tuple[Places, list[Finding]]:
    """Return the places of a single target in the frame; none for targets of which each photograph shows several tiles."""
    single = open_grid(plan.target) is None and not plan.field.cuts
    if not single or plan.target.corners_px is not None:
        return {}, []
    corners = {file: at for file, of in known.items() for at in of.values()}
    return places_in_frame(groups, corners)


def _of_region(
    calibration: Calibration,
    target: Target,
    shots: Sequence[_Shot],
    channel: str,
    region: _Region,
    whole: TargetGrid | None,
) -> tuple[list[Observation], Iterable[Finding]]:
    """Return the observation of a channel in a region; none of a tile that cannot be used, and a finding that says why."""
    try:
        of, assumed = _observation(calibration, target, shots, channel, region, whole)
    except DataError as error:
        if region.tile is None:
            raise
        key = Key(shots[0].frame.range_mm, channel, region.tile)
        return [], [found("tile-left-out", key, {"why": str(error)})]
    return [of], assumed


def _observation(
    calibration: Calibration,
    target: Target,
    shots: Sequence[_Shot],
    channel: str,
    region: _Region,
    whole: TargetGrid | None,
) -> tuple[Observation, tuple[Finding, ...]]:
    """Return the observation of one range, channel and tile, and findings about assumptions.

    whole: the grid of targets, or the single target with its marks; None without either.
    """
    first = shots[0].mosaic
    group = [shot.frame for shot in shots]
    rows, columns = cut = region.cut
    if min(rows.stop - rows.start, columns.stop - columns.start) < LEAST_TILE_PX:
        raise DataError(f"{group[0].file}: this part of the target is outside the frame")
    poses = tuple(
        Pose.from_corners(one, target.size_mm).shifted(rows.start, columns.start)
        for one in region.corners_px
    )
    data = [
        channel_data(calibration, shot.frame, shot.mosaic, channel, cut) for shot in shots
    ]
    if whole is not None and not whole.is_marked_one:  # marks are beyond the cut
        data = [
            only_own(part, pose, whole.clear_mm, target.size_mm)
            for part, pose in zip(data, poses, strict=True)
        ]
    pixels = first.pixels(channel)
    if region.tile is not None:
        own = pixels.mask(data[0].mask.shape)
        for part, pose, frame in zip(data, poses, group, strict=True):
            _refuse_clipped(part, pose, own, f"{frame.file}, channel {channel}")
    noise = noise_prior(data[0].noise, first.full_light)
    # flats leave out light that is not the display's
    clean = (bool(calibration.illumination) and target.surround is not None) or all(
        is_surround_clean(part.counts, part.mask, pose, target, noise, part.rounding)
        for part, pose in zip(data, poses, strict=True)
    )
    frames = tuple(
        _frame_data(
            calibration,
            part,
            part.mask if clean else part.mask & sees_target_only(pose, part.mask.shape),
            f"{frame.file}: only {{}} usable pixels of channel {channel}",
        )
        for part, pose, frame in zip(data, poses, group, strict=True)
    )
    if whole is not None and whole.is_marked_one:
        frames = with_marks(frames, whole, region.corners_px, cut)
    elif whole is not None:
        found_px = [shot.corners_px for shot in shots]
        frames = with_neighbours(frames, target, found_px, region.tile, cut)
    if region.part is not None:
        poses = tuple(replace(region.part.of(pose), bend=region.bend) for pose in poses)
    observation = Observation(
        range_mm=group[0].range_mm,
        measured_range_mm=_measured(group),
        channel=channel,
        names=tuple(frame.file for frame in group),
        frames=frames,
        poses=poses,
        noise=noise,
        places=pixels.places,  # the cut begins on an even row and column
        period=pixels.period,
        origin_px=(rows.start, columns.start),
        homings=tuple(
            int(frame.meta["homing"]) for frame in group if "homing" in frame.meta
        ),
        tile=region.tile,
        photograph_px=first.frame_px,
    )
    findings = [finding for part in data for finding in part.findings]
    if not clean and target.surround is not None:
        findings.append(surround_uneven(group[0].range_mm, target.surround))
    return observation, tuple(findings)


def _refuse_clipped(data: ChannelData, pose: Pose, own: Bools, where: str) -> None:
    """Raise DataError for a tile whose bright pixels are mostly clipped or unlit. own: pixels of the channel."""
    inside = sees_target_only(pose, own.shape) & own
    bright = inside & (data.counts > data.counts[inside].max(initial=0.0) / 2)
    usable = data.mask[bright].mean() if bright.any() else 0.0
    if usable < LEAST_BRIGHT_SHARE:
        raise DataError(
            f"{where}: {usable:.0%} of the bright pixels are usable, the others are clipped or unlit"
        )


def _frame_data(
    calibration: Calibration, data: ChannelData, used: Bools, too_few: str
) -> FrameData:
    if used.sum() < LEAST_TARGET_PIXELS:
        raise DataError(f"{too_few.format(used.sum())} on the target")
    frame = FrameData(
        data.counts, used, data.illumination, data.relative_std, rounding=data.rounding
    )
    if not calibration.light_known:
        return replace(frame, departures=low_orders(*used.shape))
    return replace(
        frame, brightness=Brightness.fitted(data.illumination / data.falloff, used)
    )


def _measured(group: Sequence[Frame]) -> float | None:
    readings = [
        float(frame.meta["measured_range_mm"])
        for frame in group
        if "measured_range_mm" in frame.meta
    ]
    return float(np.mean(readings)) if readings else group[0].range_mm


def noise_prior(noise: NoiseEstimate, white: float) -> NoisePrior:
    """Return a prior for the noise from flats, darks and plan, or a wide prior without them.

    white: counts above black at saturation
    """
    gain = noise.gain
    read = noise.read_noise
    gain_relative_std = (
        max(noise.gain_std / gain, 1e-3) if gain and noise.gain_std else UNKNOWN_NOISE_STD
    )
    read_variance_relative_std = (
        max(2 * noise.read_noise_std / read, 1e-3)
        if read and noise.read_noise_std
        else UNKNOWN_NOISE_STD
    )
    return NoisePrior(
        gain if gain else usual_gain(white),
        gain_relative_std,
        read**2 + ROUNDING_VARIANCE if read else usual_read_variance(white),
        read_variance_relative_std,
    )
