"""The edge-based spatial frequency response of ISO 12233:2023 (edition 4), from pixels of a colour, nothing demosaiced.

Each line's derivative has its centroid where the edge crosses it; a polynomial of fifth order through these; pixels projected
along it into bins of a quarter of a pixel; their means' derivative, a Tukey window about its peak, the modulus of its Fourier
transform, and the correction of the three-point derivative. Counts are linear in light already: there is no
opto-electronic conversion to invert. Edition 3 (2017) has a straight line, and Hamming's window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicSpline

from labkit.arrays import positive
from labkit.edges.response import UNKNOWN_FREQUENCY, Response, crossing
from labkit.errors import DataError
from labkit.optics.mtf import modulus
from labkit.types import Floats, Indices
from labkit.uncertain import Uncertain

OVERSAMPLING = 4  # bins to a pixel
LEAST_SLANT = 1.5  # degrees from the lines' normal: slants between fill the bins evenly
MOST_SLANT = 45.0
LEAST_LINES = 8  # lines that cross the edge
LEAST_CHANGE = 0.2  # of such a line, over the largest change
LEAST_DEPTH = 4  # samples on either side of the edge
OUTERMOST = (2, 98)  # percentiles of distances from the edge
POOLED = 9  # bins
MOST_CORRECTION = 10.0  # of the derivative's own response
ABOUT = (
    2 * OVERSAMPLING
)  # bins on either side of the edge, of which no two neighbours may be empty
PLACE_PASSES = 2  # of the edge's place, and of the samples' places in their bins
HIGHEST_FREQUENCY = 2.0  # cycles a sample, up to which curves are given
TINY = 1e-9  # in place of a divisor of 0
MOST_RISE = 0.2  # of a response beyond the samples' Nyquist frequency; lobes of a defocused lens have 0.13
MOST_UNSURE = 1 / 3  # of the frequency of a crossing: its standard error
UNSURE = (
    "where the response falls to a half is not known to a third: noise, lines that cross the edge at too few places between "
    "pixels, light that changes along it, or an edge that is not straight; take a longer box, or turn the edge to about "
    "5 degrees"
)


class Edition(NamedTuple):
    """The prescriptions of an edition of the standard.

    Attributes
    ----------
    order : of the polynomial that is the edge's place
    even : share of a constant in a window, beside a raised cosine
    steady : share of a constant in the window of a line's centroid, in addition
    """

    order: int
    even: float
    steady: float


EDITIONS = {2017: Edition(1, 0.08, 0.0), 2023: Edition(5, 0.0, 0.05)}
LATEST = max(EDITIONS)


@dataclass(frozen=True)
class Plane:
    """Samples of a colour on a square lattice, in lines that may follow the edge.

    Attributes
    ----------
    values : (rows, columns) counts above black
    first : (row, column) of the first sample in the raw
    step : pixels from sample to sample
    shifts : (rows,) whole samples that each line begins after the first column; empty for none
    index : (rows, columns) places of the samples among the pixels of a box; empty where unknown
    """

    values: Floats
    first: tuple[float, float] = (0.0, 0.0)
    step: int = 1
    shifts: Floats = field(default_factory=lambda: np.empty(0))
    index: Indices = field(default_factory=lambda: np.empty((0, 0), int))

    @property
    def turned(self) -> Plane:
        """The plane turned by 90 degrees, its rows counted by the columns' negatives. ValueError where lines are shifted."""
        if self.shifts.size:
            raise ValueError("lines that follow the edge cannot be exchanged with columns")
        row, column = self.first
        last = column + self.step * (self.values.shape[1] - 1)
        index = np.rot90(self.index)
        return Plane(np.rot90(self.values), (-last, row), self.step, index=index)

    @property
    def rows(self) -> Floats:
        """(rows,) rows of the raw."""
        return np.asarray(self.first[0] + self.step * np.arange(len(self.values)), float)

    @property
    def begins(self) -> Floats:
        """(rows,) column of the raw of each line's first sample."""
        shifts = self.shifts if self.shifts.size else np.zeros(len(self.values))
        return np.asarray(self.first[1] + self.step * shifts)


@dataclass(frozen=True)
class Esfr(Response):
    """A response by ISO 12233.

    Its errors are by the scatter within the bins, by the bins' width, by the tails that the window takes, and by what light
    adds that changes along and across the edge. A fall that is not known to a third is nan.

    Attributes
    ----------
    slant_deg : of the edge against the nearest axis of the lattice
    edition : year of the standard
    noise : (n,) standard errors by noise alone
    """

    slant_deg: float
    edition: int = LATEST
    noise: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def problem(self) -> str:
        """Sentence on an unknown MTF50, empty for a known one."""
        return "" if np.isfinite(self.mtf50.value) else UNSURE


def esfr(planes: Sequence[Plane], pitch_um: float, edition: int = LATEST) -> Esfr:
    """Measure the response across an edge.

    Parameters
    ----------
    planes : of a colour, one or several, such as the two green planes
    pitch_um : of the raw's pixels
    edition : year of the standard, of `EDITIONS`

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
        planes = [plane.turned for plane in planes]
    line, straight = _edge_place(planes, EDITIONS[edition])
    slope = abs(straight)
    slant = float(np.degrees(np.arctan(slope)))
    if not LEAST_SLANT <= slant <= MOST_SLANT:
        raise DataError(
            f"the edge is slanted by {slant:.1f} degrees against the pixels: the method of ISO 12233 needs "
            f"{LEAST_SLANT:g} to {MOST_SLANT:g}"
        )
    # at 45 degrees, too, all lines cross alike between samples
    passages = min(slope, 1 - slope) * sum(len(plane.values) for plane in planes)
    if passages < 1:
        raise DataError(
            f"the edge passes {passages:.1f} of a sample within the box: the method of ISO 12233 needs a longer edge"
        )
    # bins begin at samples of the first line, not at the edge
    row, column = planes[0].first
    bins = (line(row) - column) / planes[0].step * OVERSAMPLING
    into = (bins - round(bins)) / OVERSAMPLING
    samples = np.concatenate([_projected(plane, line, slope) for plane in planes], axis=1)
    samples[0] += into
    window = EDITIONS[edition].even
    cycles, value, std, noise = _response(samples, planes[0].values.shape[1], window)
    # of one sample along a line, across the edge
    across_mm = planes[0].step * pitch_um * 1e-3 * np.cos(np.arctan(slope))
    frequency = cycles / across_mm
    known = slice(_rise_again(cycles, value))
    mtf50, mtf10 = (
        _fall(frequency[known], value[known], std[known], level) for level in (0.5, 0.1)
    )
    return Esfr(frequency, value, std, mtf50, mtf10, slant, edition, noise)


def _edge_place(planes: Sequence[Plane], edition: Edition) -> tuple[Polynomial, float]:
    """Return the edge's column by the row, a polynomial, and the slope of a straight line, in pixels of the raw.

    It runs through the centroids of the lines' derivatives, first with a window about the largest change of each line,
    then about the previous polynomial.
    """
    place: Polynomial | None = None
    for _ in range(PLACE_PASSES):
        row, column = np.concatenate(
            [_crossings(plane, place, edition) for plane in planes], axis=1
        )
        if row.size < LEAST_LINES:
            raise DataError(
                f"{row.size} lines cross the edge: the method of ISO 12233 needs {LEAST_LINES}"
            )
        place = Polynomial.fit(row, column, edition.order)
    assert place is not None
    return place, float(Polynomial.fit(row, column, 1).convert().coef[1])


def _crossings(plane: Plane, place: Polynomial | None, edition: Edition) -> Floats:
    """Return rows and columns (2, n) of the raw where lines cross the edge: centroids of their windowed derivatives."""
    _, width = plane.values.shape
    change = np.diff(plane.values, axis=1)
    # as long as the line, both ends repeated
    change = np.concatenate([change[:, 1:2], change[:, 1:], change[:, -1:]], axis=1)
    at = np.arange(width) + 0.5
    if place is None:
        size = np.abs(change)
        middle = (size @ at) / np.maximum(size.sum(axis=1), TINY)
    else:
        middle = (place(plane.rows) - plane.begins) / plane.step
    # as wide as the farther border is away
    wide = 2 * np.maximum(middle, width - middle)[:, None] - 1
    window = _window(at - middle[:, None], wide, edition.even)
    weighed = change * (edition.steady + (1 - edition.steady) * window)
    total = weighed.sum(axis=1)
    good = np.abs(total) > LEAST_CHANGE * np.abs(total).max()
    column = plane.begins[good] + plane.step * (weighed @ at)[good] / total[good]
    return np.stack([plane.rows[good], column])


def _window(off: Floats, width: Floats | float, even: float) -> Floats:
    """Return a raised cosine of a width about 0, with an even share, 0 outside: Tukey's window of full taper, or Hamming's."""
    window = (1 + even) / 2 + (1 - even) / 2 * np.cos(2 * np.pi * off / width)
    return np.where(np.abs(off) <= width / 2, window, 0.0)


def _projected(plane: Plane, place: Polynomial, slope: float) -> Floats:
    """Project samples along the edge.

    Only lines of a whole number of the edge's passages from column to column are used, so that all phases are alike.

    Returns
    -------
    (3, n) distance from the edge along a line in samples, row of the raw, value
    """
    count, width = plane.values.shape
    passages = int(count * slope)
    kept = round(passages / slope) if passages else count
    row = plane.rows[:kept, None]
    column = plane.begins[:kept, None] + plane.step * np.arange(width)
    distance = (column - place(row)) / plane.step
    samples = np.broadcast_arrays(distance, row, plane.values[:kept])
    return np.stack(samples).reshape(3, -1)


def _response(
    samples: Floats, width: int, even: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return frequencies in cycles a sample, response, its errors, and those by noise, by samples (3, n).

    width : of a line
    even : of the window
    """
    low, high = np.percentile(samples[0], OUTERMOST)
    if min(-low, high) < LEAST_DEPTH:
        raise DataError(
            f"the edge lies {min(-low, high):.1f} samples from the box's border: the method of ISO 12233 needs {LEAST_DEPTH}"
        )
    half = width * OVERSAMPLING // 2  # as wide as the box, about the edge
    count = 2 * half
    bins = np.ceil(samples[0] * OVERSAMPLING).astype(int) - 1 + half
    inside = (bins >= 0) & (bins < count)
    bins = bins[inside]
    samples = samples[:, inside]
    mean, variance, aside = _binned(samples, bins, count)
    # the three-point derivative, zero at both ends, and the window about its peak
    derivative = (np.eye(count, k=1) - np.eye(count, k=-1)) / 2
    derivative[[0, -1]] = 0
    line = derivative @ mean
    at: Floats = np.arange(float(count))
    peak = float(np.average(at, weights=line**2))
    window = _window(at - peak, count, even)[:, None] * derivative
    cycles = np.arange(int(HIGHEST_FREQUENCY / OVERSAMPLING * count) + 1) / count  # a bin
    transform = np.exp(-2j * np.pi * np.outer(cycles, at)) @ window
    spectrum = transform @ mean
    light = spectrum[0]
    by_bin = (transform - np.outer(spectrum / light, transform[0])) / light
    value, slopes = modulus(spectrum / light, by_bin.T)
    repeating = np.stack([aside, *_uneven_light(mean)])
    systematic = np.linalg.norm(repeating @ by_bin.T, axis=0)
    # a bin's mean is that of its width; and the window takes from the tails what it shows next to frequency 0
    loss = value * (1 - np.sinc(cycles))
    cut = value * (1 - even) * abs(1 - value[1])
    noise = np.sqrt(variance @ slopes**2)
    errors = [noise, systematic, loss, cut]
    std = np.linalg.norm(errors, axis=0)
    correction = np.minimum(1 / np.maximum(np.sinc(2 * cycles), TINY), MOST_CORRECTION)
    curve = np.stack([value, std, noise]) * correction
    return cycles * OVERSAMPLING, *curve


def _binned(samples: Floats, bins: Indices, count: int) -> tuple[Floats, Floats, Floats]:
    """Return each bin's mean (count,) at its middle, its variance, and the last change by the samples' places.

    Where lines cross the edge at few places between samples, as at slopes near 1/3 and 2/5, a bin's samples are all off its
    middle, and some bins are empty: it would look like a response at one cycle a sample.
    """
    distance, _, values = samples
    many = np.bincount(bins, minlength=count)
    empty = many[count // 2 - ABOUT : count // 2 + ABOUT] == 0
    if np.any(empty[1:] & empty[:-1]):
        raise DataError(
            f"{empty.mean():.0%} of the quarter-pixel bins about the edge are empty: the method of ISO 12233 needs a "
            "longer edge, or another slant"
        )
    place = distance * OVERSAMPLING - bins + count // 2 - 0.5
    off = _bin_means(bins, place, many)
    plain = _bin_means(bins, values, many)
    mean = plain
    before = plain
    for _ in range(PLACE_PASSES):
        before = mean
        mean = plain - off * np.gradient(mean)
    left = values - mean[bins] - place * np.gradient(mean)[bins]
    scatter = np.bincount(bins, left**2, minlength=count)
    # the scatter follows the light: pooled over neighbouring bins
    squares, freedom = (
        np.convolve(each, np.ones(POOLED), "same") for each in (scatter, (many - 1).clip(0))
    )
    return mean, squares / freedom.clip(1) / many.clip(1), mean - before


def _bin_means(bins: Indices, values: Floats, many: Indices) -> Floats:
    """Return each bin's mean (count,), of an empty bin on a cubic spline between the others. many: (count,) samples."""
    filled = np.flatnonzero(many)
    means = np.bincount(bins, values, minlength=many.size)[filled] / many[filled]
    at = np.arange(many.size).clip(filled[0], filled[-1])
    return np.asarray(CubicSpline(filled, means)(at))


def _uneven_light(mean: Floats) -> tuple[Floats, Floats]:
    """Return what light adds to the bins' means (count,) that changes along the edge, and that changes across it.

    Every fourth bin is filled by the same lines, so bins of one phase are brighter where light changes along the edge: it
    looks like a response at one cycle a sample. A side that rises looks like a part of the blur. Both show far from the edge.
    """
    at = np.arange(mean.size) + 0.5 - mean.size / 2
    phase = np.arange(mean.size) % OVERSAMPLING
    share = np.clip((mean - mean[0]) / (mean[-1] - mean[0]), 0, 1)
    along = np.zeros(mean.size)
    across = np.zeros(mean.size)
    for side, weight in ((at < 0, 1 - share), (at > 0, share)):
        far = side & (np.abs(at) > mean.size / 4)
        rising = np.polynomial.Polynomial.fit(at[far], mean[far], 1)
        left = mean[far] - rising(at[far])
        by_phase = np.bincount(phase[far], left) / np.bincount(phase[far])
        along += weight * by_phase[phase]
        across[side] = rising(at[side]) - rising(0.0)
    return along, across


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
