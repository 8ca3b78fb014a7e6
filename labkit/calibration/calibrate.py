"""What stands between light and counts, kept apart: offset, illumination, pixel response, and pixels not to be used.

The offset is subtracted. Illumination (display and vignetting) and pixel response multiply the *model*: dividing them
out of the data would falsify its noise (thesis §4.5.2).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labkit.calibration.masters import Plane, clipped_mean, outliers, planes_of, shrunk, smooth_illumination
from labkit.calibration.photon_transfer import (
    OUTLIER_PROBABILITY,
    ROUNDING_VARIANCE,
    NoiseEstimate,
    Scatter,
    photon_transfer,
    scatter_of,
)
from labkit.errors import DataError
from labkit.plan import Sensor
from labkit.raw.decode import read_raw
from labkit.raw.mosaic import Mosaic
from labkit.session.session import Frame, Session
from labkit.types import Floats

Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

SATURATION_MARGIN = 0.01
"""Counts this near to the white level, as a share of the way up from black, count as saturated: noise is cut there."""

LEAST_DEFECT = 0.05
"""A pixel whose response is nearer than this to its neighbours' is no defect, however well it is measured."""

NOISE_PIXELS = 400_000
"""Pixels of a channel that photon transfer looks at: enough for 0.2 % from two flats."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelData:
    """One channel of one photograph on the full raw grid, ready for a fit.

    counts: (rows, cols) with the dark level taken off; mask: usable pixels of this channel; illumination: relative
    illumination (mean about 1) times pixel response, by which the model is multiplied; relative_std: standard deviation
    of that factor, relative. gain (counts per electron) and read_noise (counts, without the rounding to whole counts,
    which adds a variance of 1/12) with standard errors, None if unknown. warnings: what was assumed.
    """

    counts: Floats
    mask: Mask
    illumination: Floats
    relative_std: Floats
    gain: float | None
    gain_std: float | None
    read_noise: float | None
    read_noise_std: float | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """All that a session's darks and flats tell, on the full raw grid of the sensor.

    offset: counts without light, None = as each file says; illumination: for each range that has flats, NaN where they
    are unlit; response: relative to neighbours, with its posterior standard deviation; usable: neither hot nor dead.
    """

    sensor: Sensor
    offset: Singles | None
    illumination: Mapping[float | None, Singles]
    response: Singles | None
    response_std: Singles | None
    usable: Mask | None
    noise: Mapping[str, NoiseEstimate]
    warnings: tuple[str, ...]


def calibrate(session: Session) -> Calibration:
    """Masters from a session's dark (or else bias) and flat frames; what is missing is assumed, and said.

    Raises RawError for a file that cannot be read, DataError for frames of different sensors.
    """
    sensor, names = session.plan.sensor, [channel.name for channel in session.plan.channel]
    kinds: dict[str, list[Frame]] = {"dark": [], "bias": [], "flat": [], "target": []}
    for frame in session.frames:
        kinds[frame.kind].append(frame)
    darks = _Stack.read(kinds["dark"] or kinds["bias"], sensor)
    offset, usable = _offset(darks) if darks else (None, None)
    scatters: dict[str, tuple[list[Scatter], list[Scatter]]] = {name: ([], []) for name in names}
    if darks and offset is not None and usable is not None:
        for name in names:
            scatters[name][1].extend(darks.scatter(darks.first.channel_mask(name) & usable, offset, lit=False))
    flats: dict[float | None, _Flat] = {}
    for range_mm in sorted({frame.range_mm for frame in kinds["flat"]}, key=lambda r: (r is None, r or 0.0)):
        stack = _Stack.read([frame for frame in kinds["flat"] if frame.range_mm == range_mm], sensor)
        assert stack is not None
        flats[range_mm] = flat = _flat(stack, names, offset, usable)
        for name in names:
            where = stack.first.channel_mask(name) & np.isfinite(flat.illumination) & ~stack.saturated
            level = stack.first.black_map() if offset is None else offset
            scatters[name][0].extend(stack.scatter(where, level, lit=True))
    noise = {name: photon_transfer(*groups) for name, groups in scatters.items()}
    response, response_std, dead = _response(tuple(flats.values()), noise) if flats else (None, None, None)
    if dead is not None:
        usable = ~dead if usable is None else usable & ~dead
    return Calibration(
        sensor=sensor,
        offset=offset,
        illumination={range_mm: flat.illumination for range_mm, flat in flats.items()},
        response=response,
        response_std=response_std,
        usable=usable,
        noise=noise,
        warnings=(*_dark_warnings(kinds), *_flat_warnings(flats, noise)),
    )


def channel_data(calibration: Calibration, frame: Frame, channel_name: str) -> ChannelData:
    """A photograph's channel with everything that belongs to it.

    Raises RawError if the file cannot be read or lacks the channel, DataError if it is of another sensor than the
    calibration frames or has no usable pixel.
    """
    mosaic = read_raw(frame.path, calibration.sensor)
    shape = mosaic.counts.shape
    offset = mosaic.black_map() if calibration.offset is None else calibration.offset
    if offset.shape != shape or (calibration.response is not None and calibration.response.shape != shape):
        raise DataError(f"{frame.file} has {shape[0]}×{shape[1]} pixels, other than the session's darks and flats")
    factor, factor_std, warnings = np.ones(shape), np.zeros(shape), list(calibration.warnings)
    mask = mosaic.channel_mask(channel_name) & ~_saturated(mosaic)
    if calibration.illumination:
        range_mm, warning = _nearest(frame, calibration.illumination)
        warnings += warning
        factor *= calibration.illumination[range_mm]
    if calibration.response is not None and calibration.response_std is not None:
        factor *= calibration.response
        factor_std += calibration.response_std
    if calibration.usable is not None:
        mask &= calibration.usable
    mask &= np.isfinite(factor)
    if not mask.any():
        raise DataError(
            f"{frame.file}: channel {channel_name} has no usable pixel: all are saturated or unlit in the flats"
        )
    noise = calibration.noise.get(channel_name, NoiseEstimate(None, None, None, None))
    return ChannelData(
        counts=mosaic.counts.astype(np.float64) - offset,
        mask=mask,
        illumination=np.nan_to_num(factor, nan=1.0),
        relative_std=factor_std,
        gain=noise.gain,
        gain_std=noise.gain_std,
        read_noise=noise.read_noise,
        read_noise_std=noise.read_noise_std,
        warnings=tuple(dict.fromkeys(warnings)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """Frames of one kind: counts (frames, rows, cols), and the first one for all that they share."""

    counts: NDArray[np.uint16]
    first: Mosaic
    saturated: Mask

    @staticmethod
    def read(frames: Sequence[Frame], sensor: Sensor) -> _Stack | None:
        if not frames:
            return None
        mosaics = [read_raw(frame.path, sensor) for frame in frames]
        first = mosaics[0]
        for frame, mosaic in zip(frames, mosaics, strict=True):
            if mosaic.counts.shape != first.counts.shape or mosaic.pattern != first.pattern:
                raise DataError(f"{frame.file} is of another sensor than {frames[0].file}: {_kind_of(mosaic)}")
        saturated = np.logical_or.reduce([_saturated(mosaic) for mosaic in mosaics])
        return _Stack(np.stack([mosaic.counts for mosaic in mosaics]), first, saturated)

    def scatter(self, where: Mask, offset: Singles | Floats, *, lit: bool) -> Iterator[Scatter]:
        """Variance from frame to frame of some of the pixels `where`; nothing from a single frame."""
        chosen = np.flatnonzero(where)
        if len(self.counts) > 1 and chosen.size:
            chosen = chosen[:: -(-chosen.size // NOISE_PIXELS)]
            counts = self.counts.reshape(len(self.counts), -1)[:, chosen]
            yield scatter_of(counts - offset.ravel()[chosen].astype(np.float64), lit=lit)


def _kind_of(mosaic: Mosaic) -> str:
    return f"{mosaic.counts.shape[0]}×{mosaic.counts.shape[1]} pixels, {mosaic.cfa}"


def _saturated(mosaic: Mosaic) -> Mask:
    black = mosaic.black_map()
    return np.asarray(mosaic.counts >= mosaic.white - SATURATION_MARGIN * (mosaic.white - black))


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """One range's flats: their number, illumination (NaN where unlit), mean counts (NaN where saturated), the planes of
    each channel, and the counts that illumination 1 means there."""

    frames: int
    illumination: Singles
    mean: Singles
    places: Mapping[str, tuple[Plane, ...]]
    level: Mapping[str, float]


def _flat(stack: _Stack, names: Sequence[str], offset: Singles | None, usable: Mask | None) -> _Flat:
    """Smooth illumination, mean 1 in each channel; two greens keep their ratio."""
    mean = clipped_mean(stack.counts) - (stack.first.black_map() if offset is None else offset)
    good = ~stack.saturated if usable is None else usable & ~stack.saturated
    illumination = np.full(mean.shape, np.nan, dtype=np.float32)
    places, levels = {}, {}
    for name in names:
        places[name] = _planes(stack.first, name)
        found = [smooth_illumination(mean[plane], good[plane]) for plane in places[name]]
        levels[name] = float(np.mean([one.level for one in found]))
        for plane, one in zip(places[name], found, strict=True):
            illumination[plane] = np.where(one.lit, one.relative * one.level / levels[name], np.nan)
    mean[stack.saturated] = np.nan
    return _Flat(len(stack.counts), illumination, mean.astype(np.float32), places, levels)


def _planes(mosaic: Mosaic, name: str) -> tuple[Plane, ...]:
    """The slices of the full grid that hold a channel."""
    if len(mosaic.pattern) == 1:
        return planes_of(mosaic.pattern)
    return tuple((slice(row, None, 2), slice(col, None, 2)) for row, col in mosaic.places(name))


def _response(flats: Sequence[_Flat], noise: Mapping[str, NoiseEstimate]) -> tuple[Singles, Singles, Mask]:
    """(response, its posterior std, dead): pixels' gain relative to their neighbours', from all ranges' flats."""
    shape = flats[0].mean.shape
    response, std = np.ones(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    dead = np.zeros(shape, dtype=np.bool_)
    for name, planes in flats[0].places.items():
        if noise[name].gain is None:
            continue  # without the noise a pixel's response cannot be told from it
        for plane in planes:
            ratio, weights = _mean_ratio(flats, plane, name, noise[name])
            seen = weights > 0
            dead[plane] = outliers(ratio, seen, least=LEAST_DEFECT)
            good = seen & ~dead[plane]
            response[plane][good], posterior = shrunk(ratio[good], 1 / weights[good])
            std[plane] = response[plane][good].std()  # of a pixel that no flat shows, no more is known
            std[plane][good] = posterior
    return response, std, dead


def _mean_ratio(flats: Sequence[_Flat], plane: Plane, name: str, noise: NoiseEstimate) -> tuple[Floats, Floats]:
    """Measured over expected counts of a plane's pixels, averaged over flats, and the inverse of its variance."""
    shape = flats[0].mean[plane].shape
    weighted, weights = np.zeros(shape), np.zeros(shape)
    floor = (noise.read_noise or 0.0) ** 2 + ROUNDING_VARIANCE
    for flat in flats:
        expected = flat.illumination[plane].astype(np.float64) * flat.level[name]
        weight = np.nan_to_num(flat.frames * expected**2 / ((noise.gain or 0.0) * expected + floor))
        weight[np.isnan(flat.mean[plane])] = 0.0
        weighted += weight * np.nan_to_num(flat.mean[plane] / expected)
        weights += weight
    return np.where(weights > 0, weighted / np.maximum(weights, 1e-300), 1.0), weights


def _flat_warnings(flats: Mapping[float | None, _Flat], noise: Mapping[str, NoiseEstimate]) -> Iterable[str]:
    if not flats:
        yield (
            "no flat frames: light is taken to vary by low orders, which are fitted with gain and read noise, "
            "and pixels to be equal"
        )
        return
    for range_mm, flat in flats.items():
        planes = [flat.illumination[plane] for own in flat.places.values() for plane in own]  # of the plan's colours
        unlit = float(np.mean([np.mean(np.isnan(plane)) for plane in planes]))
        if unlit > 0.01:
            yield f"flat frames{_at(range_mm)} leave {100 * unlit:.0f} % of the frame unlit: that part is not used"
    if any(found.gain is None for found in noise.values()):
        yield "no range has two flat frames: gain is not measured, and equal pixels are assumed"


def _nearest(frame: Frame, illumination: Mapping[float | None, Singles]) -> tuple[float | None, list[str]]:
    """The range whose flats serve a frame, and a warning if that is not its own."""
    if frame.range_mm in illumination:
        return frame.range_mm, []
    known = [range_mm for range_mm in illumination if range_mm is not None]
    if frame.range_mm is None or not known:
        taken = next(iter(illumination))
    else:
        taken = min(known, key=lambda range_mm: abs(range_mm - (frame.range_mm or 0.0)))
    return taken, [f"no flat frames{_at(frame.range_mm)}: those{_at(taken)} are taken instead"]


def _at(range_mm: float | None) -> str:
    return " without a range" if range_mm is None else f" at {range_mm:g} mm"


def _dark_warnings(kinds: Mapping[str, Sequence[Frame]]) -> Iterable[str]:
    if not kinds["dark"] and not kinds["bias"]:
        yield "no dark frames: the black level of the files (or the plan) is taken, and no pixel is known to be hot"
        return
    if not kinds["dark"]:
        yield "no dark frames: bias frames are taken instead, and dark current as none"
    exposures = {frame.exposure_s for frame in (*kinds["dark"], *kinds["target"]) if frame.exposure_s is not None}
    if kinds["dark"] and exposures and max(exposures) > 1.05 * min(exposures):
        yield "dark and target frames differ in exposure time: dark current may be off"


def _offset(darks: _Stack) -> tuple[Singles, Mask]:
    """(offset, usable): the level of each plane, with what single pixels reliably add to it; hot pixels left out."""
    mean = clipped_mean(darks.counts)
    offset, usable = np.empty(mean.shape, dtype=np.float32), np.ones(mean.shape, dtype=np.bool_)
    for plane in planes_of(darks.first.pattern):
        values, frames = mean[plane], len(darks.counts)
        good = ~outliers(values, np.ones(values.shape, dtype=np.bool_), least=1.0)
        if frames > 1:
            variance = darks.counts[(slice(None), *plane)].var(axis=0, ddof=1, dtype=np.float64)
            typical = float(np.median(variance) / (chi2.median(frames - 1) / (frames - 1)))
            limit = chi2.isf(OUTLIER_PROBABILITY, frames - 1) / (frames - 1)
            good &= variance <= limit * max(typical, ROUNDING_VARIANCE)
            offset[plane] = shrunk(values, float(variance[good].mean()) / frames)[0]
        else:
            offset[plane] = values[good].mean()  # one frame cannot tell a pixel's own level from noise
        usable[plane] = good
    return offset, usable
