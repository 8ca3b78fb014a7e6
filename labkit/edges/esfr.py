"""The edge-based spatial frequency response of ISO 12233:2017 (its Annex D), from pixels of one colour, nothing demosaiced.

Each line's derivative has its centroid where the edge crosses it; a straight line through these; pixels projected along it
into bins of a quarter of a pixel; their means' derivative, a Hamming window about its peak, the modulus of its Fourier
transform, and the correction of the three-point derivative. Counts are linear in light already: there is no
opto-electronic conversion to invert.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.arrays import positive
from labkit.errors import DataError
from labkit.types import Bools, Floats
from labkit.uncertain import Uncertain

OVERSAMPLING = 4  # bins to a pixel
LEAST_SLANT, MOST_SLANT = (
    1.5,
    42.0,
)  # degrees from the lines' normal, between which the bins are filled evenly
LEAST_LINES, LEAST_CHANGE = (
    8,
    0.2,
)  # that cross the edge; and how much of the greatest change counts as that
MOST_CORRECTION = 10.0  # of the derivative's own response
BINS_ABOUT_EDGE = (
    2 * OVERSAMPLING
)  # bins on either side of the edge, none of which may be empty
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
    """Samples of one colour on a square lattice: values (rows, columns) with black removed, and in the raw the (row, column)
    of the first one and how many pixels lie from one to the next."""

    values: Floats
    first: tuple[float, float] = (0.0, 0.0)
    step: int = 1


@dataclass(frozen=True)
class Esfr:
    """A response: (n,) frequency_per_mm on the sensor along the edge's normal, value, and std.

    std: by the scatter within the bins, and by what repeats from sample to sample across the edge (`_repeating`).
    mtf50, mtf10: where it first falls to 0.5 and to 0.1, cycles/mm; nan where it does not, or where that is not known to a
    third. slant_deg: of the edge against the nearest axis of the lattice. problem: why mtf50 is nan.
    """

    frequency_per_mm: Floats
    value: Floats
    std: Floats
    mtf50: Uncertain
    mtf10: Uncertain
    slant_deg: float
    problem: str = ""


@dataclass(frozen=True)
class _Samples:
    """Samples of an edge, (n,) each: distance from it along a line in samples, row of the raw, value."""

    distance: Floats
    row: Floats
    values: Floats


def esfr(planes: Sequence[Plane], pitch_um: float) -> Esfr:
    """Of one edge, by one plane of a colour or by several together, such as the two green ones.

    pitch_um: of the raw's pixels. Raises DataError, one line, for an edge that the method cannot measure.
    """
    positive("pitch_um", pitch_um, "um")
    if not planes or len({plane.step for plane in planes}) > 1:
        raise ValueError("one plane or more of one step are needed")
    step = planes[0].step
    sideways = sum(_rise(plane.values, 0) - _rise(plane.values, 1) for plane in planes) > 0
    turned = [_transposed(plane) if sideways else plane for plane in planes]
    slope, offset = _line(turned)
    slant = float(np.degrees(np.arctan(slope)))
    passages = abs(slope) * sum(plane.values.shape[0] for plane in turned)
    if not LEAST_SLANT <= abs(slant) <= MOST_SLANT:
        raise DataError(
            f"the edge is slanted by {abs(slant):.1f} degrees against the pixels: the method of ISO 12233 needs "
            f"{LEAST_SLANT:g} to {MOST_SLANT:g}"
        )
    if passages < 1:
        raise DataError(
            f"the edge passes {passages:.1f} of a sample within the box: the method of ISO 12233 needs a longer edge"
        )
    samples = _projected(turned, slope, offset)
    across_mm = (
        step * pitch_um * 1e-3 * np.cos(np.arctan(slope))
    )  # of one sample along a line, across the edge
    return _response(samples, turned[0].values.shape[1], across_mm, slant)


def _rise(values: Floats, axis: int) -> float:
    """How much a picture changes along an axis, from one border to the other, over all its lines."""
    return float(abs(np.diff(values, axis=axis).sum()))


def _transposed(plane: Plane) -> Plane:
    return Plane(plane.values.T, (plane.first[1], plane.first[0]), plane.step)


def _line(planes: Sequence[Plane]) -> tuple[float, float]:
    """column = offset + slope * row, in pixels of the raw, through the centroids of the lines' derivatives.

    First with a Hamming window about where each line changes most, then twice about the line found before.
    """
    fitted: tuple[float, float] | None = None
    for _ in range(3):
        crossings = [_crossings(plane, fitted) for plane in planes]
        row, column = (np.concatenate(each) for each in zip(*crossings, strict=True))
        if row.size < LEAST_LINES:
            raise DataError(
                f"{row.size} lines cross the edge: the method of ISO 12233 needs {LEAST_LINES}"
            )
        slope, offset = np.polyfit(row, column, 1)
        fitted = float(slope), float(offset)
    assert fitted is not None
    return fitted


def _crossings(plane: Plane, line: tuple[float, float] | None) -> tuple[Floats, Floats]:
    """(n,) rows and columns of the raw where the plane's lines cross the edge: centroids of their windowed derivatives."""
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
    return row[good], plane.first[1] + plane.step * (weighed @ at)[good] / total[good]


def _hamming(off: Floats, width: float) -> Floats:
    """Hamming's window of a width about 0, 0 outside it."""
    return np.where(
        np.abs(off) <= width / 2, 0.54 + 0.46 * np.cos(2 * np.pi * off / width), 0.0
    )


def _projected(planes: Sequence[Plane], slope: float, offset: float) -> _Samples:
    """Project the samples along the line.

    Of the lines only a whole number of the edge's passages from column to column, so that all phases have equal parts.
    """
    distances, rows, values = [], [], []
    for plane in planes:
        count, width = plane.values.shape
        passages = int(count * abs(slope))
        kept = round(passages / abs(slope)) if passages else count
        row = plane.first[0] + plane.step * np.arange(kept)
        column = plane.first[1] + plane.step * np.arange(width)
        distances.append((column - offset - slope * row[:, None]).ravel() / plane.step)
        rows.append(np.repeat(row, width))
        values.append(plane.values[:kept].ravel())
    return _Samples(*map(np.concatenate, (distances, rows, values)))


def _response(samples: _Samples, width: int, across_mm: float, slant: float) -> Esfr:
    """The curve of samples. width: of a line; across_mm: what one of its samples is across the edge."""
    low, high = np.percentile(samples.distance, (2, 98))
    if min(-low, high) < 4:
        raise DataError(
            f"the edge lies {min(-low, high):.1f} samples from the box's border: the method of ISO 12233 needs 4"
        )
    half = width * OVERSAMPLING // 2  # as wide as the box, about the edge
    bins = np.floor(samples.distance * OVERSAMPLING).astype(int) + half
    inside: Bools = (bins >= 0) & (bins < 2 * half)
    bins, samples = bins[inside], _Samples(*(each[inside] for each in astuple(samples)))
    mean, variance = _binned(bins, samples.values, 2 * half)
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
    samples: _Samples, bins: NDArray[np.int_], mean: Floats, line: Floats
) -> Floats:
    """How far the means of bins are off in a way that repeats from sample to sample across the edge, (count,).

    Every fourth bin is filled by the same lines. Where lines cross at few places between samples, as at slopes near 1/3, their
    samples are not in the middle of the bins; and where light changes along the edge, the bins of one phase are brighter.
    Either looks like a response at one cycle a sample.
    """
    far = np.abs(samples.distance) > np.abs(samples.distance).max() / 2
    row = samples.row - samples.row.mean()
    slopes = []
    for side in (samples.distance < 0, samples.distance > 0):
        at, seen = row[far & side], samples.values[far & side]
        slopes.append(
            (at - at.mean()) @ (seen - seen.mean()) / ((at - at.mean()) ** 2).sum()
        )
    share = np.clip((mean[bins] - mean[0]) / (mean[-1] - mean[0]), 0, 1)
    brighter = row * (slopes[0] + share * (slopes[1] - slopes[0]))
    aside = (
        samples.distance * OVERSAMPLING - np.floor(samples.distance * OVERSAMPLING) - 0.5
    )
    many = np.bincount(bins, minlength=mean.size)
    total = np.bincount(bins, brighter + line[bins] * aside, minlength=mean.size)
    filled = many > 0
    return np.interp(
        np.arange(mean.size), np.flatnonzero(filled), total[filled] / many[filled]
    )


def _rise_again(cycles: Floats, value: Floats) -> int:
    """Count the values up to where the curve begins to rise again, beyond the samples' Nyquist frequency; all where it does
    not. cycles: a sample.

    No lens's response does so: it is a copy of the curve about one cycle a sample, which lines at even places would cancel.
    """
    beyond = int(np.searchsorted(cycles, 0.5))
    lowest = np.minimum.accumulate(value[beyond:])
    risen = np.flatnonzero(value[beyond:] > lowest + MOST_RISE)
    if not risen.size:
        return value.size
    return beyond + int(np.argmin(value[beyond : beyond + risen[0]])) + 1


def _fall(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Where the curve first falls to a level; its error reaches from where the curve does less its standard error to where
    it does with that, or to the curve's end. Nan where the error is more than MOST_UNSURE of the number."""
    at = crossing(frequency, value, std, level)
    earliest, latest = (
        crossing(frequency, value + sign * std, std, level).value for sign in (-1, 1)
    )
    if np.isnan(latest):
        latest = float(frequency[-1])
    error = max(at.std, (latest - earliest) / 2)
    if not error <= MOST_UNSURE * at.value:
        return Uncertain(np.nan, np.nan, at.unit)
    return Uncertain(at.value, error, at.unit)


def _binned(bins: Floats, values: Floats, count: int) -> tuple[Floats, Floats]:
    """(count,) mean of each bin and its variance; what no sample fell into is interpolated."""
    bins = bins.astype(int)
    many = np.bincount(bins, minlength=count)
    filled = many > 0
    about = filled[count // 2 - BINS_ABOUT_EDGE : count // 2 + BINS_ABOUT_EDGE]
    if not about.all():
        raise DataError(
            f"{1 - about.mean():.0%} of the quarter-pixel bins about the edge are empty: the method of ISO 12233 needs a "
            "longer edge, or another slant"
        )
    total = np.bincount(bins, values, minlength=count)
    mean = np.interp(np.arange(count), np.flatnonzero(filled), total[filled] / many[filled])
    scatter = np.bincount(bins, (values - mean[bins]) ** 2, minlength=count)
    freedom = np.maximum(many - 1, 0)
    # the scatter follows the light: pooled over neighbouring bins
    wide = np.ones(9)
    pooled = np.convolve(scatter, wide, "same") / np.maximum(
        np.convolve(freedom, wide, "same"), 1
    )
    return mean, pooled / np.maximum(many, 1)


def crossing(frequency: Floats, value: Floats, std: Floats, level: float) -> Uncertain:
    """Where a curve first falls to a level, by straight lines between its samples; nan where it does not."""
    below = np.flatnonzero(value < level)
    if below.size == 0 or below[0] == 0:
        return Uncertain(np.nan, np.nan, "cycles/mm")
    k = int(below[0])
    slope = (value[k] - value[k - 1]) / (frequency[k] - frequency[k - 1])
    at = frequency[k - 1] + (level - value[k - 1]) / slope
    error = float(np.interp(at, frequency, std)) / abs(slope)
    return Uncertain(float(at), error, "cycles/mm")
