"""Separate the effects between light and counts: offset, illumination, pixel response, unusable pixels.

The offset is subtracted. Illumination (display and vignetting) and pixel response multiply
the *model*: dividing them out of the data would falsify the noise (thesis §4.5.2).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labkit.calibration.darks import dark_findings, reduce_darks
from labkit.calibration.flats import (
    Falloff,
    Flat,
    flat_findings,
    pixel_response,
    reduce_flats,
)
from labkit.calibration.needed import EVERYTHING, Needed
from labkit.calibration.photon_transfer import NoiseEstimate, photon_transfer
from labkit.calibration.stack import Stacks
from labkit.calibration.stated_noise import UNMEASURED, noise_findings, with_stated
from labkit.errors import DataError
from labkit.findings.findings import Finding, at_range, each_once, flats_of_another_range
from labkit.photographs.photograph import WHOLE, Cut, Photograph, overlap
from labkit.plan import Plan
from labkit.session.frame import Frame
from labkit.types import Bools, Floats, Floats32, Progress, no_progress


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Results of a session's darks and flats on the raw grid of the sensor, or of a box of it.

    offset: counts without light, None = as each file states; illumination: for each range
    with flats, NaN where unlit; response: relative to neighbours, with its posterior
    standard deviation (relative too); usable: neither hot nor dead; panel_seen: whether
    flats show the panel's own pixels, which were removed. box: rows and columns of the
    frame; frame_px: of the whole frame, None without darks and flats.
    """

    offset: Floats32 | None
    illumination: Mapping[float | None, Floats32]
    response: Floats32 | None
    response_std: Floats32 | None
    usable: Bools | None
    noise: Mapping[str, NoiseEstimate]
    findings: tuple[Finding, ...]
    panel_seen: bool = False
    box: Cut = WHOLE
    frame_px: tuple[int, int] | None = None

    @property
    def light_known(self) -> bool:
        """Return whether flats determine the illumination, low orders and all."""
        return bool(self.illumination) and not self.panel_seen


@dataclass(frozen=True, slots=True, eq=False)
class ChannelData:
    """One channel of a photograph or of a cut, ready for a fit.

    counts: (rows, cols) less the dark level; mask: usable pixels of this channel;
    illumination: relative illumination (mean about 1) times pixel response, which
    multiplies the model; relative_std: standard deviation of this factor, relative;
    falloff: the lens's share of the factor, 1 without flats. rounding: counts², variance of
    the rounding to stored numbers where known beside the read noise, as with a tone curve;
    else 0. noise: gain and read noise as measured. findings: assumptions made.
    """

    counts: Floats
    mask: Bools
    illumination: Floats
    relative_std: Floats
    falloff: Floats
    rounding: Floats
    noise: NoiseEstimate
    findings: tuple[Finding, ...]


def calibrate(
    frames: Iterable[Frame],
    plan: Plan,
    needed: Mapping[float | None, Needed] | None = None,
    progress: Progress = no_progress,
) -> Calibration:
    """Return the masters of a session's dark (or else bias) and flat frames.

    A finding reports each assumption made for missing frames. Each photograph is decoded
    once; memory holds the needed pixels of one range at a time.

    Parameters
    ----------
    frames : of the session
    plan : gives sensor and channels
    needed : what the target photographs of each range need; None for whole frames. Flats
        are of light on the target: what they show elsewhere, a room, would bend the
        illumination
    progress : called with the step under way

    Raises
    ------
    RawError : a file cannot be read
    DataError : frames are of different sensors
    """
    names = [channel.name for channel in plan.channel]
    kinds: dict[str, list[Frame]] = {"dark": [], "bias": [], "flat": [], "target": []}
    for frame in frames:
        kinds[frame.kind].append(frame)
    unlit = kinds["dark"] or kinds["bias"]
    groups = by_range(kinds["flat"])
    needed = needed or {None: EVERYTHING}
    of_flats = _needed_of_flats([*groups], needed)
    box = Needed.by_all(needed.values()).cut
    stacks = Stacks(plan.sensor)
    steps = len(groups) + 1
    progress(0, steps, "reading darks")
    dark = reduce_darks(stacks.read(unlit, box), names) if unlit else None
    flats: dict[float | None, Flat] = {}
    for done, (range_mm, group) in enumerate(groups.items(), start=1):
        progress(done, steps, f"reading flats{at_range(range_mm)}")
        part = of_flats[range_mm]
        stack = stacks.read(group, part.cut)
        flats[range_mm] = reduce_flats(stack, names, dark, box, part)
    measured = {
        name: photon_transfer(
            [scatter for flat in flats.values() for scatter in flat.scatter[name]],
            dark.scatter[name] if dark else (),
        )
        for name in names
    }
    noise = {
        channel.name: with_stated(measured[channel.name], channel)
        for channel in plan.channel
    }
    response = pixel_response(tuple(flats.values()), noise) if flats else None
    usable = dark.usable if dark else None
    if response:
        usable = ~response.dead if usable is None else usable & ~response.dead
    return Calibration(
        offset=dark.offset if dark else None,
        illumination={range_mm: flat.illumination for range_mm, flat in flats.items()},
        response=response.relative if response else None,
        response_std=response.relative_std if response else None,
        usable=usable,
        noise=noise,
        findings=(
            *dark_findings(kinds),
            *flat_findings(flats, noise),
            *noise_findings(measured, plan.channel),
        ),
        panel_seen=any(flat.panel is not None for flat in flats.values()),
        box=box,
        frame_px=stacks.frame_px,
    )


def _needed_of_flats(
    ranges_mm: Sequence[float | None], needed: Mapping[float | None, Needed]
) -> dict[float | None, Needed]:
    """Return what is needed of the flats of each range, by all ranges that they serve."""
    served: dict[float | None, list[Needed]] = {range_mm: [] for range_mm in ranges_mm}
    if ranges_mm:
        for range_mm, part in needed.items():
            served[_nearest(range_mm, ranges_mm)].append(part)
    # the others' still show the gain and the pixels' response
    return {mm: Needed.by_all(parts or needed.values()) for mm, parts in served.items()}


def by_range(frames: Iterable[Frame]) -> dict[float | None, list[Frame]]:
    """Return frames by range: those without a range first, then from the nearest on."""
    groups: dict[float | None, list[Frame]] = {}
    for frame in sorted(
        frames, key=lambda frame: (frame.range_mm is not None, frame.range_mm or 0.0)
    ):
        groups.setdefault(frame.range_mm, []).append(frame)
    return groups


def channel_data(
    calibration: Calibration,
    frame: Frame,
    mosaic: Photograph,
    channel: str,
    cut: Cut = WHOLE,
) -> ChannelData:
    """Return a channel of a photograph with its calibration.

    mosaic: the photograph, decoded, or a part of it that holds the cut; cut: rows and
    columns of the frame, both starting at an even one, within the calibration's box. Raises
    RawError if the photograph lacks the channel, DataError if its sensor differs from the
    calibration frames' or no pixel is usable.
    """
    _refuse_other_sensor(calibration, frame, mosaic)
    part = mosaic.part(channel, cut)
    where = mosaic.where(channel, part.box, overlap(calibration.box, mosaic.frame_box))
    offset = part.black_map if calibration.offset is None else calibration.offset[where]
    factor = np.ones(part.counts.shape)
    falloff = np.ones(part.counts.shape)
    factor_std = np.zeros(part.counts.shape)
    findings = [*mosaic.notes, *calibration.findings]
    mask = part.channel_mask(channel) & ~part.saturated
    if calibration.illumination:
        range_mm = _nearest(frame.range_mm, [*calibration.illumination])
        if range_mm != frame.range_mm:
            findings.append(flats_of_another_range(frame.range_mm, range_mm))
        illumination = calibration.illumination[range_mm]
        factor *= illumination[where]
        falloff = Falloff.of(illumination, mosaic.frame_px, calibration.box).at(part.box)
    if calibration.response is not None and calibration.response_std is not None:
        factor *= calibration.response[where]
        factor_std += calibration.response_std[where]
    if calibration.usable is not None:
        mask &= calibration.usable[where]
    mask &= np.isfinite(factor)
    if not mask.any():
        raise DataError(
            f"{frame.file}: channel {channel} has no usable pixel: all are saturated or unlit in the flats"
        )
    return ChannelData(
        counts=part.counts.astype(np.float64) - offset,
        mask=mask,
        illumination=np.nan_to_num(factor, nan=1.0),
        relative_std=factor_std,
        falloff=falloff,
        rounding=part.rounding_variance,
        noise=calibration.noise.get(channel, UNMEASURED),
        findings=tuple(each_once(findings)),
    )


def _refuse_other_sensor(
    calibration: Calibration, frame: Frame, mosaic: Photograph
) -> None:
    if calibration.frame_px not in (None, mosaic.frame_px):
        rows, columns = mosaic.frame_px
        raise DataError(
            f"{frame.file} has {rows}×{columns} pixels, other than the session's darks and flats"
        )


def _nearest(range_mm: float | None, ranges_mm: Sequence[float | None]) -> float | None:
    """Return the range whose flats serve a range."""
    known = [mm for mm in ranges_mm if mm is not None]
    if range_mm in ranges_mm:
        return range_mm
    if range_mm is None or not known:
        return ranges_mm[0]
    return min(known, key=lambda mm: abs(mm - range_mm))
