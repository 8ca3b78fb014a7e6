"""The edge-based spatial frequency response of ISO 12233:2017 (its Annex D), from pixels of a colour, nothing demosaiced.

Each line's derivative has its centroid where the edge crosses it; a straight line through these; pixels projected along it
into bins of a quarter of a pixel; their means' derivative, a Hamming window about its peak, the modulus of its Fourier
transform, and the correction of the three-point derivative. Counts are linear in light already: there is no
opto-electronic conversion to invert.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labkit.arrays import positive
from labkit.edges.response import UNKNOWN_FREQUENCY, Response, crossing
from labkit.errors import DataError
from labkit.optics.mtf import modulus
from labkit.types import Floats, Indices
from labkit.uncertain import Uncertain

OVERSAMPLING = 4  # bins to a pixel
LEAST_SLANT = 1.5  # degrees from the lines' normal: slants between fill the bins evenly
MOST_SLANT = 42.0
LEAST_LINES = 8  # lines that cross the edge
LEAST_CHANGE = 0.2  # of such a line, over the largest change
LEAST_DEPTH = 4  # samples on either side of the edge
OUTERMOST = (2, 98)  # percentiles of distances from the edge
POOLED = 9  # bins
MOST_CORRECTION = 10.0  # of the derivative's own response
ABOUT = 2 * OVERSAMPLING  # bins on either side of the edge, none of which may be empty
HIGHEST_FREQUENCY = 2.0  # cycles a sample, up to which curves are given
TINY = 1e-9  # in place of a divisor of 0
MOST_RISE = 0.2  # of a response beyond the samples' Nyquist frequency; lobes of a defocused lens have 0.13
MOST_UNSURE = 1 / 3  # of the frequency of a crossing: its standard error
UNSURE = (
    "where the response falls to a half is not known to a third: noise, lines that cross the edge at too few places between "
    "pixels, light that changes along it, or an edge that is not straight; take a longer box, or turn the edge to about "
    "5 degrees"
)


@dataclass(frozen=True)
class Plane:
    """Samples of a colour on a square lattice.

    Attributes
    ----------
    values : (rows, columns) counts above black
    first : (row, column) of the first sample in the raw
    step : pixels from sample to sample
    """

    values: Floats
    first: tuple[float, float] = (0.0, 0.0)
    step: int = 1


@dataclass(frozen=True)
class Esfr(Response):
    """A response by ISO 12233.

    Its errors are by the scatter within the bins, and by what repeats from sample to sample. A fall that is not known to a
    third is nan.

    Attributes
    ----------
    slant_deg : of the edge against the nearest axis of the lattice
    """

    slant_deg: float

    @property
    def problem(self) -> str:
        """Sentence on an unknown MTF50, empty for a known one."""
        return "" if np.isfinite(self.mtf50.value) else UNSURE


def esfr(planes: Sequence[Plane], pitch_um: float) -> Esfr:
    """Measure the response across an edge.

    Parameters
    ----------
    planes : of a colour, one or several, such as the two green planes
    pitch_um : of the raw's pixels

    Raises
    ------
    DataError : the method cannot measure this edge
    ValueError : planes with different steps
    """
    positive("pitch_um", pitch_um, "um")
    if not planes or len({plane.step for plane in planes}) > 1:
        raise ValueError("one plane or more of one step are needed")
    # change from border to border along either axis
    down, across = (
        sum(np.abs(np.diff(plane.values, axis=axis).sum()) for plane in planes)
        for axis in (0, 1)
    )
    if down > across:
        planes = [Plane(of.values.T, of.first[::-1], of.step) for of in planes]
    line = _line(planes)
    slope = float(abs(line[0]))
    slant = float(np.degrees(np.arctan(slope)))
    if not LEAST_SLANT <= slant <= MOST_SLANT:
        raise DataError(
            f"the edge is slanted by {slant:.1f} degrees against the pixels: the method of ISO 12233 needs "
            f"{LEAST_SLANT:g} to {MOST_SLANT:g}"
        )
    passages = slope * sum(len(plane.values) for plane in planes)
    if passages < 1:
        raise DataError(
            f"the edge passes {passages:.1f} of a sample within the box: the method of ISO 12233 needs a longer edge"
        )
    samples = np.concatenate([_projected(plane, line) for plane in planes], axis=1)
    cycles, value, std = _response(samples, planes[0].values.shape[1])
    # of one sample along a line, across the edge
    across_mm = planes[0].step * pitch_um * 1e-3 * np.cos(np.arctan(slope))
    frequency = cycles / across_mm
    known = slice(_rise_again(cycles, value))
    mtf50, mtf10 = (
        _fall(frequency[known], value[known], std[known], level) for level in (0.5, 0.1)
    )
    return Esfr(frequency, value, std, mtf50, mtf10, slant)


def _line(planes: Sequence[Plane]) -> Floats:
    """Return slope and offset of the line column = offset + slope row, in pixels of the raw.

    It runs through the centroids of the lines' derivatives, first with a Hamming window about the largest change of each
    line, then twice about the previous line.
    """
    line = None
    for _ in range(3):
        row, column = np.concatenate([_crossings(p, line) for p in planes], axis=1)
        if row.size < LEAST_LINES:
            raise DataError(
                f"{row.size} lines cross the edge: the method of ISO 12233 needs {LEAST_LINES}"
            )
        line = np.polyfit(row, column, 1)
    return np.asarray(line)


def _crossings(plane: Plane, line: Floats | None) -> Floats:
    """Return rows and columns (2, n) of the raw where lines cross the edge: centroids of their windowed derivatives."""
    count, width = plane.values.shape
    row = plane.first[0] + plane.step * np.arange(count)
    change = np.diff(plane.values, axis=1)
    at = np.arange(width - 1) + 0.5
    if line is None:
        size = np.abs(change)
        middle = (size @ at) / np.maximum(size.sum(axis=1), TINY)
    else:
        middle = (np.polyval(line, row) - plane.first[1]) / plane.step
    weighed = change * _hamming(at - middle[:, None], width)
    total = weighed.sum(axis=1)
    good = np.abs(total) > LEAST_CHANGE * np.abs(total).max()
    column = plane.first[1] + plane.step * (weighed @ at)[good] / total[good]
    return np.stack([row[good], column])


def _hamming(off: Floats, width: float) -> Floats:
    """Return Hamming's window of a width about 0, 0 outside."""
    window = 0.54 + 0.46 * np.cos(2 * np.pi * off / width)
    return np.where(np.abs(off) <= width / 2, window, 0.0)


def _projected(plane: Plane, line: Floats) -> Floats:
    """Project samples along the line.

    Only lines of a whole number of the edge's passages from column to column are used, so that all phases are alike.

    Returns
    -------
    (3, n) distance from the edge along a line in samples, row of the raw, value
    """
    count, width = plane.values.shape
    slope = abs(line[0])
    passages = int(count * slope)
    kept = round(passages / slope) if passages else count
    row = plane.first[0] + plane.step * np.arange(kept)[:, None]
    column = plane.first[1] + plane.step * np.arange(width)
    distance = (column - np.polyval(line, row)) / plane.step
    samples = np.broadcast_arrays(distance, row, plane.values[:kept])
    return np.stack(samples).reshape(3, -1)


def _response(samples: Floats, width: int) -> tuple[Floats, Floats, Floats]:
    """Return frequencies in cycles a sample, response, and its errors, by samples (3, n). width: of a line."""
    low, high = np.percentile(samples[0], OUTERMOST)
    if min(-low, high) < LEAST_DEPTH:
        raise DataError(
            f"the edge lies {min(-low, high):.1f} samples from the box's border: the method of ISO 12233 needs {LEAST_DEPTH}"
        )
    half = width * OVERSAMPLING // 2  # as wide as the box, about the edge
    count = 2 * half
    bins = np.floor(samples[0] * OVERSAMPLING).astype(int) + half
    inside = (bins >= 0) & (bins < count)
    bins = bins[inside]
    samples = samples[:, inside]
    mean, variance = _binned(bins, samples[2], count)
    # the three-point derivative, zero at both ends, and the window about its peak
    derivative = (np.eye(count, k=1) - np.eye(count, k=-1)) / 2
    derivative[[0, -1]] = 0
    line = derivative @ mean
    place: Floats = np.arange(float(count))
    peak = float(np.average(place, weights=line**2))
    window = _hamming(place - peak, count)[:, None] * derivative
    cycles = np.arange(int(HIGHEST_FREQUENCY / OVERSAMPLING * count) + 1) / count  # a bin
    transform = np.exp(-2j * np.pi * np.outer(cycles, place)) @ window
    spectrum = transform @ mean
    light = spectrum[0]
    by_bin = (transform - np.outer(spectrum / light, transform[0])) / light
    value, slopes = modulus(spectrum / light, by_bin.T)
    systematic = transform @ _repeating(samples, bins, mean, line) / light
    std = np.hypot(np.sqrt(variance @ slopes**2), np.abs(systematic))
    correction = np.minimum(1 / np.maximum(np.sinc(2 * cycles), TINY), MOST_CORRECTION)
    return cycles * OVERSAMPLING, value * correction, std * correction


def _repeating(samples: Floats, bins: Indices, mean: Floats, line: Floats) -> Floats:
    """Return errors of the bins' means (count,) that repeat from sample to sample across the edge.

    Every fourth bin is filled by the same lines. Where lines cross at few places between samples, as at slopes near 1/3,
    their samples are off the middle of the bins; and where light changes along the edge, the bins of one phase are brighter.
    Either looks like a response at one cycle a sample.
    """
    distance, row, value = samples
    far = np.abs(distance) > np.abs(distance).max() / 2
    slopes = [
        np.polyfit(row[far & side], value[far & side], 1)[0]
        for side in (distance < 0, distance > 0)
    ]
    share = np.clip((mean[bins] - mean[0]) / (mean[-1] - mean[0]), 0, 1)
    brighter = (row - row.mean()) * (slopes[0] + share * (slopes[1] - slopes[0]))
    aside = (distance * OVERSAMPLING) % 1 - 0.5
    return _bin_means(bins, brighter + line[bins] * aside, mean.size)[0]


def _bin_means(bins: Indices, values: Floats, count: int) -> tuple[Floats, Indices]:
    """Return each bin's mean (count,), interpolated in empty bins, and its number of samples."""
    many = np.bincount(bins, minlength=count)
    filled = np.flatnonzero(many)
    total = np.bincount(bins, values, minlength=count)
    means = total[filled] / many[filled]
    return np.interp(np.arange(count), filled, means), many


def _rise_again(cycles: Floats, value: Floats) -> int:
    """Return the number of values up to where the curve begins to rise beyond the samples' Nyquist frequency.

    No lens's response rises there: it is a copy of the curve about one cycle a sample, which lines at even places would
    cancel. cycles: a sample.
    """
    beyond = int(np.searchsorted(cycles, 0.5))
    after = value[beyond:]
    risen = np.flatnonzero(after > np.minimum.accumulate(after) + MOST_RISE)
    return beyond + int(np.argmin(after[: risen[0]])) + 1 if risen.size else value.size


def _fall(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Return the frequency at which the curve first falls to a level; nan if its error exceeds MOST_UNSURE of it.

    The error reaches from the fall of the curve less its standard error to the fall of the curve plus the error, or to the end.
    """
    earliest, at, latest = (
        crossing(frequency, value + sign * std, std, level) for sign in (-1, 0, 1)
    )
    last = np.nan_to_num(latest.value, nan=frequency[-1])
    error = max(at.std, (last - earliest.value) / 2)
    known = error <= MOST_UNSURE * at.value
    return Uncertain(at.value, error, at.unit) if known else UNKNOWN_FREQUENCY


def _binned(bins: Indices, values: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the mean of each bin (count,) and its variance."""
    mean, many = _bin_means(bins, values, count)
    about = many[count // 2 - ABOUT : count // 2 + ABOUT] > 0
    if not about.all():
        raise DataError(
            f"{1 - about.mean():.0%} of the quarter-pixel bins about the edge are empty: the method of ISO 12233 needs a "
            "longer edge, or another slant"
        )
    scatter = np.bincount(bins, (values - mean[bins]) ** 2, minlength=count)
    # the scatter follows the light: pooled over neighbouring bins
    squares, freedom = (
        np.convolve(each, np.ones(POOLED), "same") for each in (scatter, (many - 1).clip(0))
    )
    return mean, squares / freedom.clip(1) / many.clip(1)
