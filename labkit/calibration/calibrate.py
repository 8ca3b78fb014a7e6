"""Separate the effects between light and counts: offset, illumination, pixel response, unusable pixels.

The offset is subtracted. Illumination (display and vignetting) and pixel response multiply
the *model*: dividing them out of the data would falsify the noise (thesis §4.5.2).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from labkit.calibration.darks import dark_findings, reduce_darks
from labkit.calibration.flats import Falloff, flat_findings, pixel_response, reduce_flats
from labkit.calibration.photon_transfer import NoiseEstimate, photon_transfer
from labkit.calibration.stack import read_stack
from labkit.calibration.stated_noise import UNMEASURED, noise_findings, with_stated
from labkit.errors import DataError
from labkit.findings import Finding, each_once, flats_of_another_range
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.session.frame import Frame
from labkit.types import Bools, Floats, Floats32


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Results of a session's darks and flats on the full raw grid of the sensor.

    offset: counts without light, None = as each file states; illumination: for each range
    with flats, NaN where unlit; response: relative to neighbours, with its posterior
    standard deviation (relative too); usable: neither hot nor dead; panel_seen: whether
    flats show the panel's own pixels, which were removed.
    """

    offset: Floats32 | None
    illumination: Mapping[float | None, Floats32]
    response: Floats32 | None
    response_std: Floats32 | None
    usable: Bools | None
    noise: Mapping[str, NoiseEstimate]
    findings: tuple[Finding, ...]
    panel_seen: bool = False

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


def calibrate(frames: Iterable[Frame], plan: Plan) -> Calibration:
    """Return the masters of a session's dark (or else bias) and flat frames.

    A finding reports each assumption made for missing frames. plan: gives sensor and
    channels. Each photograph is decoded once; memory holds the frames of one range at a
    time. Raises RawError for a file that cannot be read, DataError for frames of different
    sensors.
    """
    names = [channel.name for channel in plan.channel]
    kinds: dict[str, list[Frame]] = {"dark": [], "bias": [], "flat": [], "target": []}
    for frame in frames:
        kinds[frame.kind].append(frame)
    unlit = kinds["dark"] or kinds["bias"]
    dark = reduce_darks(read_stack(unlit, plan.sensor), names) if unlit else None
    flats = {
        range_mm: reduce_flats(read_stack(group, plan.sensor), names, dark)
        for range_mm, group in by_range(kinds["flat"]).items()
    }
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
    )


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

    mosaic: the photograph, decoded; cut: only these rows and columns of its pixels, both
    starting at an even one. Raises RawError if the photograph lacks the channel, DataError
    if its sensor differs from the calibration frames' or no pixel is usable.
    """
    _refuse_other_sensor(calibration, frame, mosaic)
    part = mosaic.part(channel, cut)
    where = mosaic.where(channel, cut)
    offset = part.black_map if calibration.offset is None else calibration.offset[where]
    factor = np.ones(part.counts.shape)
    falloff = np.ones(part.counts.shape)
    factor_std = np.zeros(part.counts.shape)
    findings = [*mosaic.notes, *calibration.findings]
    mask = part.channel_mask(channel) & ~part.saturated
    if calibration.illumination:
        range_mm, taken = _nearest(frame, calibration.illumination)
        findings += taken
        factor *= calibration.illumination[range_mm][where]
        falloff = Falloff.of(calibration.illumination[range_mm], mosaic.shape).at(cut)
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
    masters = [calibration.offset, calibration.response, *calibration.illumination.values()]
    rows, cols = mosaic.shape
    if any(
        master is not None and master.shape != mosaic.counts.shape for master in masters
    ):
        raise DataError(
            f"{frame.file} has {rows}×{cols} pixels, other than the session's darks and flats"
        )


def _nearest(
    frame: Frame, illumination: Mapping[float | None, Floats32]
) -> tuple[float | None, list[Finding]]:
    """Return the range whose flats serve a frame, and a finding if they are of another range."""
    if frame.range_mm in illumination:
        return frame.range_mm, []
    known = [range_mm for range_mm in illumination if range_mm is not None]
    if frame.range_mm is None or not known:
        taken = next(iter(illumination))
    else:
        taken = min(known, key=lambda range_mm: abs(range_mm - (frame.range_mm or 0.0)))
    return taken, [flats_of_another_range(frame.range_mm, taken)]
