"""The edge-based spatial frequency response of ISO 12233:2017 (its Annex D), from pixels of one colour, nothing demosaiced.

Each line's derivative has its centroid where the edge crosses it; a straight line through these; pixels projected along it
into bins of a quarter of a pixel; their means' derivative, a Hamming window about its peak, the modulus of its Fourier
transform, and the correction of the three-point derivative. Counts are linear in light already: there is no
opto-electronic conversion to invert.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.arrays import positive
from labkit.errors import DataError
from labkit.types import Floats
from labkit.uncertain import Uncertain

OVERSAMPLING = 4  # bins to a pixel
LEAST_SLANT, MOST_SLANT = (
    1.5,
    42.0,
)  # degrees from the lines' normal that fill the bins evenly
LEAST_LINES, LEAST_CHANGE = (
    8,
    0.2,
)  # lines that cross the edge, and share of the largest change
POOLED = 9  # bins
MOST_CORRECTION = 10.0  # of the derivative's own response
ABOUT = 2 * OVERSAMPLING  # bins on either side of the edge, none of which may be empty
HIGHEST_FREQUENCY = 2.0  # cycles a sample, up to which curves are given
MOST_RISE = 0.2  # of a response beyond the samples' Nyquist frequency; lobes of a defocused lens have 0.13
MOST_UNSURE = 1 / 3  # of the frequency of a crossing: its standard error
UNSURE = (
    "where the response falls to a half is not known to a third: noise, lines that cross the edge at too few places between "
    "pixels, light that changes along it, or an edge that is not straight; take a longer box, or turn the edge to about "
    "5 degrees"
)


@dataclass(frozen=True)
class Plane:
    """Samples of one colour on a square lattice.

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
class Esfr:
    """A response along the edge's normal.

    Attributes
    ----------
    frequency_per_mm, value : (n,) on the sensor
    std : (n,) by the scatter within the bins, and by errors that repeat from sample to sample
    mtf50, mtf10 : first fall to 0.5 and to 0.1, cycles/mm; nan without a fall, or if it is not known to a third
    slant_deg : of the edge against the nearest axis of the lattice
    problem : why mtf50 is nan
    """

    frequency_per_mm: Floats
    value: Floats
    std: Floats
    mtf50: Uncertain
    mtf10: Uncertain
    slant_deg: float
    problem: str = ""


def esfr(planes: Sequence[Plane], pitch_um: float) -> Esfr:
    """Measure the response across an edge.

    Parameters
    ----------
    planes : of one colour: one, or several such as the two green ones
    pitch_um : of the raw's pixels

    Raises
    ------
    DataError : the method cannot measure this edge
    ValueError : planes with different steps
    """
    positive("pitch_um", pitch_um, "um")
    if not planes or len({plane.step for plane in planes}) > 1:
        raise ValueError("one plane or more of one step are needed")
    sideways = sum(_rise(plane.values, 0) - _rise(plane.values, 1) for plane in planes) > 0
    if sideways:
        planes = [
            Plane(plane.values.T, (plane.first[1], plane.first[0]), plane.step)
            for plane in planes
        ]
    slope, offset = _line(planes)
    slant = float(np.degrees(np.arctan(slope)))
    if not LEAST_SLANT <= abs(slant) <= MOST_SLANT:
        raise DataError(
            f"the edge is slanted by {abs(slant):.1f} degrees against the pixels: the method of ISO 12233 needs "
            f"{LEAST_SLANT:g} to {MOST_SLANT:g}"
        )
    passages = abs(slope) * sum(plane.values.shape[0] for plane in planes)
    if passages < 1:
        raise DataError(
            f"the edge passes {passages:.1f} of a sample within the box: the method of ISO 12233 needs a longer edge"
        )
    # of one sample along a line, across the edge
    across_mm = planes[0].step * pitch_um * 1e-3 * np.cos(np.arctan(slope))
    samples = np.concatenate([_projected(p, slope, offset) for p in planes], axis=1)
    return _response(samples, planes[0].values.shape[1], across_mm, slant)


def _rise(values: Floats, axis: int) -> float:
    """Return the change of a picture along an axis, from border to border, over all its lines."""
    return float(abs(np.diff(values, axis=axis).sum()))


def _line(planes: Sequence[Plane]) -> tuple[float, float]:
    """Return slope and offset of the line column = offset + slope row, in pixels of the raw.

    It runs through the centroids of the lines' derivatives, first with a Hamming window about the largest change of each
    line, then twice about the previous line.
    """
    slope = 0.0
    offset = 0.0
    known = False
    for _ in range(3):
        line = (slope, offset) if known else None
        row, column = np.concatenate([_crossings(p, line) for p in planes], axis=1)
        if row.size < LEAST_LINES:
            raise DataError(
                f"{row.size} lines cross the edge: the method of ISO 12233 needs {LEAST_LINES}"
            )
        slope, offset = map(float, np.polyfit(row, column, 1))
        known = True
    return slope, offset


def _crossings(plane: Plane, line: tuple[float, float] | None) -> Floats:
    """Return rows and columns (2, n) of the raw where lines cross the edge: centroids of their windowed derivatives."""
    count, width = plane.values.shape
    row = np.asarray(plane.first[0] + plane.step * np.arange(count), np.float64)
    change = np.diff(plane.values, axis=1)
    at: Floats = np.arange(width - 1) + 0.5
    if line is None:
        middle = (np.abs(change) @ at) / np.maximum(np.abs(change).sum(axis=1), 1e-30)
    else:
        middle = (line[1] + line[0] * row - plane.first[1]) / plane.step
    weighed = change * _hamming(at - middle[:, None], width)
    total = weighed.sum(axis=1)
    good = np.abs(total) > LEAST_CHANGE * np.abs(total).max()
    column = plane.first[1] + plane.step * (weighed @ at)[good] / total[good]
    return np.stack([row[good], column])


def _hamming(off: Floats, width: float) -> Floats:
    """Return Hamming's window of a width about 0, 0 outside."""
    return np.where(
        np.abs(off) <= width / 2, 0.54 + 0.46 * np.cos(2 * np.pi * off / width), 0.0
    )


def _projected(plane: Plane, slope: float, offset: float) -> Floats:
    """Project samples along the line.

    Only lines of a whole number of the edge's passages from column to column are used, so that all phases are alike.

    Returns
    -------
    (3, n) distance from the edge along a line in samples, row of the raw, value
    """
    count, width = plane.values.shape
    passages = int(count * abs(slope))
    kept = round(passages / abs(slope)) if passages else count
    row = plane.first[0] + plane.step * np.arange(kept)[:, None]
    column = plane.first[1] + plane.step * np.arange(width)
    distance = (column - offset - slope * row) / plane.step
    rows = np.broadcast_to(row, distance.shape)
    return np.stack([distance, rows, plane.values[:kept]]).reshape(3, -1)


def _response(samples: Floats, width: int, across_mm: float, slant: float) -> Esfr:
    """Return the response by samples (3, n). width: of a line; across_mm: of one of its samples, across the edge."""
    low, high = np.percentile(samples[0], (2, 98))
    if min(-low, high) < 4:
        raise DataError(
            f"the edge lies {min(-low, high):.1f} samples from the box's border: the method of ISO 12233 needs 4"
        )
    half = width * OVERSAMPLING // 2  # as wide as the box, about the edge
    bins = np.floor(samples[0] * OVERSAMPLING).astype(int) + half
    inside = (bins >= 0) & (bins < 2 * half)
    bins = bins[inside]
    samples = samples[:, inside]
    mean, variance = _binned(bins, samples[2], 2 * half)
    # the three-point derivative, zero at both ends, and the window about its peak
    derivative = np.zeros((2 * half, 2 * half))
    k = np.arange(1, 2 * half - 1)
    derivative[k, k + 1], derivative[k, k - 1] = 0.5, -0.5
    line = derivative @ mean
    place: Floats = np.arange(2.0 * half)
    peak = float(np.sum(place * np.abs(line) ** 2) / np.sum(np.abs(line) ** 2))
    line_of = _hamming(place - peak, 2 * half)[:, None] * derivative
    cycles = np.arange(int(HIGHEST_FREQUENCY / OVERSAMPLING * 2 * half) + 1) / (
        2 * half
    )  # a bin
    transform = np.exp(-2j * np.pi * np.outer(cycles, place)) @ line_of
    correction = np.minimum(1 / np.maximum(np.sinc(2 * cycles), 1e-9), MOST_CORRECTION)
    spectrum = transform @ mean
    value = np.abs(spectrum) / np.abs(spectrum[0]) * correction
    phase = np.conj(spectrum / np.maximum(np.abs(spectrum), 1e-30))
    by_bin = (phase[:, None] * transform).real / np.abs(spectrum[0]) * correction[:, None]
    by_bin -= value[:, None] * (
        transform[0].real * np.sign(spectrum[0].real) / np.abs(spectrum[0])
    )
    repeating = transform @ _repeating(samples, bins, mean, line)
    systematic = np.abs(repeating) / np.abs(spectrum[0]) * correction
    std = np.hypot(np.sqrt(by_bin**2 @ variance), systematic)
    frequency = cycles * OVERSAMPLING / across_mm
    known = _rise_again(cycles * OVERSAMPLING, value)
    curve = frequency[:known], value[:known], std[:known]
    mtf50, mtf10 = (_fall(*curve, level) for level in (0.5, 0.1))
    problem = "" if np.isfinite(mtf50.value) else UNSURE
    return Esfr(frequency, value, std, mtf50, mtf10, abs(slant), problem)


def _repeating(
    samples: Floats, bins: NDArray[np.int_], mean: Floats, line: Floats
) -> Floats:
    """Return errors of the bins' means (count,) that repeat from sample to sample across the edge.

    Every fourth bin is filled by the same lines. Where lines cross at few places between samples, as at slopes near 1/3,
    their samples are off the middle of the bins; and where light changes along the edge, the bins of one phase are brighter.
    Either looks like a response at one cycle a sample.
    """
    distance, row, value = samples
    far = np.abs(distance) > np.abs(distance).max() / 2
    row = row - row.mean()
    slopes = []
    for side in (distance < 0, distance > 0):
        at = row[far & side]
        seen = value[far & side]
        at = at - at.mean()
        slopes.append(at @ (seen - seen.mean()) / (at**2).sum())
    share = np.clip((mean[bins] - mean[0]) / (mean[-1] - mean[0]), 0, 1)
    brighter = row * (slopes[0] + share * (slopes[1] - slopes[0]))
    aside = distance * OVERSAMPLING - np.floor(distance * OVERSAMPLING) - 0.5
    return _bin_means(bins, brighter + line[bins] * aside, mean.size)[0]


def _bin_means(
    bins: NDArray[np.int_], values: Floats, count: int
) -> tuple[Floats, NDArray[np.int_]]:
    """Return each bin's mean (count,), interpolated in empty bins, and its number of samples."""
    many = np.bincount(bins, minlength=count)
    filled = many > 0
    total = np.bincount(bins, values, minlength=count)
    means = total[filled] / many[filled]
    return np.interp(np.arange(count), np.flatnonzero(filled), means), many


def _rise_again(cycles: Floats, value: Floats) -> int:
    """Return the number of values up to where the curve begins to rise beyond the samples' Nyquist frequency.

    No lens's response rises there: it is a copy of the curve about one cycle a sample, which lines at even places would
    cancel. cycles: a sample.
    """
    beyond = int(np.searchsorted(cycles, 0.5))
    lowest = np.minimum.accumulate(value[beyond:])
    risen = np.flatnonzero(value[beyond:] > lowest + MOST_RISE)
    if not risen.size:
        return value.size
    return beyond + int(np.argmin(value[beyond : beyond + risen[0]])) + 1


def _fall(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Return the frequency at which the curve first falls to a level; nan if its error exceeds MOST_UNSURE of it.

    The error reaches from the fall of the curve less its standard error to that of the curve with it, or to the end.
    """
    at = crossing(frequency, value, std, level)
    earliest, latest = (
        crossing(frequency, value + sign * std, std, level).value for sign in (-1, 1)
    )
    if np.isnan(latest):
        latest = float(frequency[-1])
    error = max(at.std, (latest - earliest) / 2)
    known = error <= MOST_UNSURE * at.value
    return Uncertain(at.value, error, at.unit) if known else UNKNOWN_FREQUENCY


def _binned(bins: NDArray[np.int_], values: Floats, count: int) -> tuple[Floats, Floats]:
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
        np.convolve(each, np.ones(POOLED), "same")
        for each in (scatter, np.maximum(many - 1, 0))
    )
    return mean, squares / np.maximum(freedom, 1) / np.maximum(many, 1)


UNKNOWN_FREQUENCY = Uncertain(np.nan, np.nan, "cycles/mm")


def crossing(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Return the frequency at which a curve first falls to a level, by lines between its samples; nan without a fall."""
    below = np.flatnonzero(value < level)
    if below.size == 0 or below[0] == 0:
        return UNKNOWN_FREQUENCY
    k = int(below[0])
    slope = (value[k] - value[k - 1]) / (frequency[k] - frequency[k - 1])
    at = frequency[k - 1] + (level - value[k - 1]) / slope
    error = float(np.interp(at, frequency, std)) / abs(slope)
    return Uncertain(float(at), error, "cycles/mm")
