"""Mean, temporal variance and spatial variance of flats and darks at each level of light.

EMVA Standard 1288, *Standard for Characterization of Image Sensors and Cameras*, Release 4.0
Linear (2021): sections 6.3 (pairs of frames) and 8.2 (averaged frames).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from scipy import ndimage

from labkit.calibration.masters import outliers, smooth_illumination
from labkit.calibration.stack import Stack, Stacks
from labkit.errors import DataError, shown
from labkit.noise.shared import pooled, shared_noise
from labkit.photographs.photograph import Cut, Photograph
from labkit.plan import Sensor
from labkit.session.frame import Frame
from labkit.types import Bools, Counts, Floats, Floats32, Progress
from labkit.uncertain import Uncertain

LEAST_EVEN = 0.9
"""Pixels that get less than this share of the brightest place's light are left out: saturation needs even light."""

FEW_CLIPPED = 0.01
"""Flats with a larger share of clipped pixels do not show where the light is even."""

FILTER_PX = 11
"""Side of the mean, in pixels of one colour, whose subtraction removes uneven light from spatial variances."""

SAME_EXPOSURE = 0.01
"""Relative difference below which exposure times are equal: cameras round their times."""


@dataclass(frozen=True, slots=True)
class Level:
    """Frames of one exposure time and light, in one channel.

    exposure_s; photons: mean for each pixel, None if unknown; signal: mean counts, of flats
    above darks, of darks above the black level; variance: temporal, counts², rounding
    included, with its standard error, both without hot pixels; spatial: variance of the
    averaged frames beyond temporal noise and slow changes, of all pixels, counts²;
    spatial_whole: with slow changes. means: mean counts of each frame; clipped:
    share of clipped pixels; pixels: their number; files: names; shared: sum of the
    correlations of a pixel's noise with its neighbours', 0 of a sensor; ends: the lowest and
    the highest count that pixels pile up at, nan where they do not.
    """

    exposure_s: float
    photons: float | None
    signal: float
    signal_std: float
    variance: float
    variance_std: float
    spatial: Uncertain
    spatial_whole: Uncertain
    means: tuple[float, ...]
    clipped: float
    pixels: int
    files: tuple[str, ...]
    shared: Uncertain
    ends: tuple[float, float]

    @property
    def light(self) -> float:
        """Photons where they are known, else the exposure time."""
        return self.exposure_s if self.photons is None else self.photons


@dataclass(frozen=True, slots=True)
class Series:
    """All levels of one channel, rising.

    dark_missing: exposures whose flats took other darks; white: counts above black, and
    white_level: counts, as stated.
    """

    flats: tuple[Level, ...]
    darks: tuple[Level, ...]
    dark_missing: tuple[float, ...]
    white: float
    white_level: float


@dataclass(frozen=True, slots=True)
class _Group:
    """Frames of one exposure and light."""

    exposure_s: float
    photons: float | None
    frames: tuple[Frame, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """(rows, cols) masks of a channel's evenly lit pixels: all of them, and without hot pixels."""

    name: str
    every: Bools
    steady: Bools


@dataclass(frozen=True, slots=True, eq=False)
class _Offset:
    """counts: (rows, cols) to subtract; variance: of their own temporal noise."""

    counts: Floats32
    variance: float


def read_series(
    frames: Sequence[Frame], sensor: Sensor, channels: Sequence[str], progress: Progress
) -> dict[str, Series]:
    """Return each channel's levels.

    Raises RawError for a file that cannot be read, DataError for frames that do not suffice.
    """
    _refuse_untimed(frames)
    flats = _groups(frames, "flat")
    darks = _groups(frames, "dark")
    total = len(flats) + len(darks) + 1
    progress(0, total, "looking where the light is even")
    even, first = _even_light(flats, sensor, channels)
    good = ~_hot(_stack(darks[-1], sensor))
    pixels = {name: _Pixels(name, mask, mask & good) for name, mask in even.items()}
    dark_levels: dict[str, list[Level]] = {name: [] for name in channels}
    for done, group in enumerate(darks, start=1):
        progress(done, total, f"reading darks of {group.exposure_s:g} s")
        stack = _stack(group, sensor)
        black = _Offset(stack.first.black_map.astype(np.float32), 0.0)
        for name in channels:
            dark_levels[name].append(_level(group, stack, pixels[name], black))
    levels: dict[str, list[Level]] = {name: [] for name in channels}
    missing = []
    offset_of = -1
    for done, group in enumerate(flats, start=len(darks) + 1):
        progress(done, total, f"reading flats of {group.exposure_s:g} s")
        apart_s = [abs(dark.exposure_s - group.exposure_s) for dark in darks]
        k = int(np.argmin(apart_s))
        if not _same(darks[k].exposure_s, group.exposure_s):
            missing.append(group.exposure_s)
        if k != offset_of:
            offset = _mean_counts(Stacks(sensor).read(darks[k].frames))
            offset_of = k
        stack = _stack(group, sensor)
        for name in channels:
            dark = dark_levels[name][k]
            of = _Offset(offset, dark.variance / len(dark.means))
            levels[name].append(_level(group, stack, pixels[name], of))
    return {
        name: Series(
            tuple(sorted(levels[name], key=lambda level: level.light)),
            tuple(dark_levels[name]),
            tuple(dict.fromkeys(missing)),
            first.full_light,
            first.white,
        )
        for name in channels
    }


def _hot(darks: Stack) -> Bools:
    """Return the (rows, cols) pixels that are much brighter than others without light."""
    hot = np.zeros(darks.saturated.shape, dtype=np.bool_)
    for plane in darks.first.every_plane:
        values = _mean(darks, plane)
        hot[plane] = outliers(values, np.ones(values.shape, dtype=np.bool_), least=1.0)
    return hot


def _same(one_s: float, other_s: float) -> bool:
    return abs(one_s - other_s) <= SAME_EXPOSURE * max(one_s, other_s)


def _groups(frames: Sequence[Frame], kind: str) -> list[_Group]:
    """Return the frames of a kind by exposure and light. Raises DataError for missing frames and pairs."""
    chosen = [frame for frame in frames if frame.kind == kind]
    if not chosen:
        raise DataError(
            f"the session has no {kind}s: photon transfer needs two or more {kind}s at each of several "
            "exposure times; [noise] in a plan has labkit capture take them"
        )
    sorted_ = sorted(chosen, key=lambda frame: (_exposure_s(frame), _photons(frame) or 0.0))
    groups: list[list[Frame]] = []
    for frame in sorted_:
        last = groups[-1][0] if groups else None
        if (
            last is not None
            and _same(_exposure_s(last), _exposure_s(frame))
            and (kind == "dark" or _photons(last) == _photons(frame))
        ):
            groups[-1].append(frame)
        else:
            groups.append([frame])
    if single := [group[0] for group in groups if len(group) < 2]:
        times = ", ".join(f"{_exposure_s(frame):g} s" for frame in single[:5])
        raise DataError(
            f"{len(single)} exposure times have a single {kind} ({times}): photon transfer needs two or more "
            f"{kind}s of each; take another, or leave {single[0].file} out"
        )
    light = kind == "flat"
    return [
        _Group(_exposure_s(g[0]), _photons(g[0]) if light else None, tuple(g))
        for g in groups
    ]


def _refuse_untimed(frames: Sequence[Frame]) -> None:
    """Raise DataError for flats and darks without an exposure time."""
    series = [frame for frame in frames if frame.kind in ("flat", "dark")]
    untimed = [
        frame.file
        for frame in series
        if _column(frame, "exposure_s") is None and frame.exposure_s is None
    ]
    if untimed:
        raise DataError(
            f"{len(untimed)} of {len(series)} flats and darks state no exposure time, such as {untimed[0]}: add a column "
            "exposure_s to the list and import it anew"
        )


def _exposure_s(frame: Frame) -> float:
    """Return the exposure time that the list states, or else the file."""
    stated = _column(frame, "exposure_s")
    return float(frame.exposure_s or 0.0) if stated is None else stated


def _photons(frame: Frame) -> float | None:
    return _column(frame, "photons")


def _column(frame: Frame, name: str) -> float | None:
    """Return a number of a further column of the imported list. Raises DataError for other text."""
    text = frame.meta.get("columns", {}).get(name, "")
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not (isfinite(number) and number >= 0):
        raise DataError(f"{frame.file}: {name} is {shown(text)}: allowed is a number >= 0")
    return number


def _even_light(
    flats: Sequence[_Group], sensor: Sensor, channels: Sequence[str]
) -> tuple[Mapping[str, Bools], Photograph]:
    """Return where each channel's light is within LEAST_EVEN of its brightest, and a photograph of the series.

    Raises DataError where all flats are clipped.
    """
    for group in sorted(
        flats, key=lambda g: (g.exposure_s, g.photons or 0.0), reverse=True
    ):
        stack = _stack(group, sensor)
        masks = {name: stack.first.channel_mask(name) for name in channels}
        if not any(_is_full(stack, mask) for mask in masks.values()):
            break
    else:
        raise DataError(
            f"all flats are clipped, those of {group.exposure_s:g} s too: take flats of shorter exposures, "
            "or with less light"
        )
    for name in channels:
        for plane in stack.first.planes(name):
            light = _mean(stack, plane) - stack.first.black_of(plane)
            even = smooth_illumination(light, ~stack.saturated[plane])
            relative = np.where(even.lit, even.relative, 0.0)
            masks[name][plane] = relative > LEAST_EVEN * np.percentile(relative, 99)
    return masks, stack.first


def _stack(group: _Group, sensor: Sensor) -> Stack:
    """Read the frames of a level. Raises DataError for processed pictures and copies of a frame."""
    stack = Stacks(sensor).read(group.frames)
    first = group.frames[0]
    if stack.first.tone is not None:
        raise DataError(
            f"{first.file} is a processed picture, whose noise is no sensor's: photon transfer needs raw files, "
            "or TIFF, PNG or PGM of linear counts"
        )
    copies = len({frame.sha256 for frame in group.frames}) < len(group.frames)
    # frames without noise, of pixels at an end of the scale, are alike without being copies
    if copies and any(np.ptp(stack.counts[:, *cut]) > 0 for cut in stack.first.every_plane):
        raise DataError(
            f"the {first.kind}s of {group.exposure_s:g} s hold copies of one photograph, such as {first.file}: "
            "photon transfer needs separate exposures"
        )
    return stack


def _is_full(stack: Stack, where: Bools) -> bool:
    """Return whether pixels are clipped at the stated white level, or at a lower one."""
    return bool(
        stack.saturated[where].mean() >= FEW_CLIPPED
        or np.isfinite(_ends(stack.counts[0][where])[1])
    )


def _ends(counts: Counts) -> tuple[float, float]:
    """Return the lowest and the highest of counts (n,) that pixels pile up at; nan where they do not.

    Counts become fewer towards both ends of a noise's distribution; a clipped one has its
    most at the end.
    """
    low, high = int(counts.min()), int(counts.max())
    at = [np.mean(counts == count) for count in (low, low + 1, high - 1, high)]
    bottom = low if low == 0 and at[0] > max(at[1], FEW_CLIPPED) else np.nan
    top = high if high > low + 1 or at[3] == 1 else np.nan
    return bottom, top if at[3] > max(at[2], FEW_CLIPPED) else np.nan


def _mean(stack: Stack, plane: Cut) -> Floats:
    """Return the mean counts of a plane: of a whole frame these numbers would fill a fifth of a gigabyte."""
    return np.asarray(stack.counts[(slice(None), *plane)].mean(axis=0, dtype=np.float64))


def _mean_counts(stack: Stack) -> Floats32:
    mean = np.empty(stack.saturated.shape, dtype=np.float32)
    for plane in stack.first.every_plane:
        mean[plane] = _mean(stack, plane)
    return mean


def _level(group: _Group, stack: Stack, used: _Pixels, offset: _Offset) -> Level:
    where = used.steady
    means = np.array([counts[where].mean() for counts in stack.counts])
    means -= offset.counts[where].mean(dtype=np.float64)
    lit = group.frames[0].kind == "flat" and bool(means.min() > 0)
    pairs = next(stack.scatter(where, offset.counts, lit=lit))
    variance = float(pairs.variance.mean())
    pixels = int(np.count_nonzero(where))
    planes = [
        (_mean(stack, plane) - offset.counts[plane], used.every[plane])
        for plane in stack.first.planes(used.name)
    ]
    rough = np.concatenate([_high_pass(*plane) for plane in planes])
    whole = np.concatenate([values[at] - values[at].mean() for values, at in planes])
    temporal = variance / len(means) + offset.variance
    return Level(
        exposure_s=group.exposure_s,
        photons=group.photons,
        signal=float(means.mean()),
        signal_std=float(np.sqrt(variance / len(means) / pixels)),
        variance=variance,
        variance_std=float(pairs.variance.std() / np.sqrt(pairs.variance.size)),
        spatial=_beyond(rough**2 / (1 - 1 / FILTER_PX**2), temporal),
        spatial_whole=_beyond(whole**2, temporal),
        means=tuple(means.tolist()),
        clipped=float(stack.saturated[where].mean()),
        shared=pooled(
            [
                shared_noise(stack.counts[:, *plane], where[plane])
                for plane in stack.first.planes(used.name)
            ]
        ),
        ends=_ends(stack.counts[0][where]),
        pixels=pixels,
        files=tuple(frame.file for frame in group.frames),
    )


def _beyond(squares: Floats, temporal: float) -> Uncertain:
    """Return the mean of squares beyond temporal noise, with its standard error."""
    std = float(squares.std() / np.sqrt(squares.size))
    return Uncertain(float(squares.mean()) - temporal, std)


def _high_pass(values: Floats, where: Bools) -> Floats:
    """Return (m,) values of the pixels `where`, less the mean of FILTER_PX x FILTER_PX neighbours."""
    weight = ndimage.uniform_filter(where.astype(np.float64), FILTER_PX, mode="constant")
    total = ndimage.uniform_filter(np.where(where, values, 0.0), FILTER_PX, mode="constant")
    return np.asarray(values[where] - total[where] / weight[where])


def each_frame(levels: Sequence[Level]) -> Iterator[tuple[float, float, str]]:
    """Yield exposure, mean counts and file of each frame."""
    for level in levels:
        for mean, file in zip(level.means, level.files, strict=True):
            yield level.exposure_s, mean, file
