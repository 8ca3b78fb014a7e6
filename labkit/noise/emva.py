"""The linear camera model of EMVA 1288 from levels of light: gain, noise, saturation, linearity, each with its error.

EMVA Standard 1288, Release 4.0 Linear (2021). Its equations (10) to (16) are straight lines;
here they are fitted by weighted least squares, which gives errors too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from labkit.calibration.photon_transfer import ROUNDING_VARIANCE
from labkit.errors import DataError
from labkit.noise.levels import Level, Series, each_frame
from labkit.noise.shared import pooled
from labkit.photographs.photograph import SATURATION_MARGIN
from labkit.types import Floats
from labkit.uncertain import Uncertain

SENSITIVITY_SHARE = 0.7
"""Of saturation: the gain's line ends there (section 6.6)."""

LINEARITY_SHARES = 0.05, 0.95
"""Of saturation: deviations from linearity count between them (section 6.7)."""

LEAST_LEVELS = 4
"""In the gain's range: a straight line and its error need as many."""

HIDDEN_VARIANCE = 0.24
"""Dark variance, counts², below which rounding hides the noise (section 6.6)."""

MOST_SHARED, SURELY_SHARED = 0.05, 5.0
"""Sum of a pixel's correlations with its neighbours, and its standard errors, above which raw data were filtered: charges that
pixels of a sensor pass on make less."""

MOST_RESTLESS = 0.05
"""Relative change of light between flats of a level: pairs cancel half its square, 0.1 % of the gain."""

NAN = Uncertain(np.nan)


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """A channel's camera model.

    levels: flats, rising; gain_counts_per_e ... as `labkit.measure_noise` describes;
    deviations_percent: (levels,) from the straight line; notes: remarks, a sentence each.
    """

    series: Series
    gain_counts_per_e: Uncertain
    read_noise_counts: Uncertain
    read_noise_e: Uncertain
    saturation_e: Uncertain
    dynamic_range: Uncertain
    snr_max: Uncertain
    threshold_e: Uncertain
    linearity_error_percent: Uncertain
    prnu_percent: Uncertain
    prnu_whole_percent: Uncertain
    dsnu_e: Uncertain
    dsnu_whole_e: Uncertain
    dark_current_e_per_s: Uncertain
    dark_current_from_noise_e_per_s: Uncertain
    quantum_efficiency_percent: Uncertain
    threshold_photons: Uncertain
    saturation_photons: Uncertain
    deviations_percent: Floats
    dark_variance: float
    fitted_to: float
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """Coefficients and covariance of a linear model."""

    values: Floats
    covariance: Floats

    def __getitem__(self, k: int) -> Uncertain:
        return Uncertain(self.values[k], np.sqrt(self.covariance[k, k]))


def camera_model(series: Series) -> ChannelNoise:
    """Return the model of a channel. Raises DataError for levels that do not suffice."""
    flats = series.flats
    _refuse_one_light(flats)
    _refuse_restless(flats)
    _refuse_warm(series.darks)
    peak = int(np.argmax([level.variance for level in flats]))
    reached = peak + 1 < len(flats)
    top = flats[peak].signal
    fitted = [flat for flat in flats[: peak + 1] if flat.signal <= SENSITIVITY_SHARE * top]
    if len(fitted) < LEAST_LEVELS:
        raise DataError(_too_few(flats, peak, len(fitted)))
    shared = _shared(fitted)
    line = _photon_transfer(fitted, _unclipped(series.darks), shared.value)
    gain = line[0]
    read_counts, read_e = _read_noise(line)
    saturation_e = _saturation(flats, peak, gain) if reached else NAN
    threshold_e = _threshold(line)
    dark_line = _dark_line(series.darks)
    linear = [
        flat
        for flat in flats[: peak + 1]
        if LINEARITY_SHARES[0] * top <= flat.signal <= LINEARITY_SHARES[1] * top
    ]
    deviations, linearity = _linearity(flats, linear)
    half = min(flats, key=lambda flat: abs(flat.signal - top / 2))
    dark = min(series.darks, key=lambda level: abs(level.exposure_s - half.exposure_s))
    efficiency = _efficiency(fitted, gain)
    return ChannelNoise(
        series=series,
        gain_counts_per_e=gain,
        read_noise_counts=read_counts,
        read_noise_e=read_e,
        saturation_e=saturation_e,
        dynamic_range=_over(saturation_e, threshold_e),
        snr_max=_root(saturation_e),
        threshold_e=threshold_e,
        linearity_error_percent=linearity,
        prnu_percent=_times(_root(half.spatial), 100 / half.signal),
        prnu_whole_percent=_times(_root(half.spatial_whole), 100 / half.signal),
        dsnu_e=_over(_root(dark.spatial), gain),
        dsnu_whole_e=_over(_root(dark.spatial_whole), gain),
        dark_current_e_per_s=_over(dark_line[1], gain) if dark_line else NAN,
        dark_current_from_noise_e_per_s=(
            _over(line[2], _times(gain, gain.value)) if len(line.values) > 2 else NAN
        ),
        quantum_efficiency_percent=_times(efficiency, 100),
        threshold_photons=_over(threshold_e, efficiency),
        saturation_photons=_over(saturation_e, efficiency),
        deviations_percent=deviations,
        dark_variance=float(line.values[1]),
        fitted_to=SENSITIVITY_SHARE * top,
        notes=tuple(_notes(series, reached, line, linear, shared)),
    )


def _refuse_one_light(flats: Sequence[Level]) -> None:
    """Raise DataError for flats of a single exposure time and light."""
    if len(flats) > 1:
        return
    levels = sorted(flats[0].means)
    if levels[-1] - levels[0] > MOST_RESTLESS * max(levels[-1], 1.0):
        raise DataError(
            f"all flats have one exposure time, {flats[0].exposure_s:g} s, but means of {levels[0]:.0f} to {levels[-1]:.0f} "
            "counts, and no column photons tells their light apart: state each frame's own exposure time, or its light as "
            "photons, in the list and import it anew"
        )
    raise DataError(
        f"all flats have one exposure time, {flats[0].exposure_s:g} s, and one light: photon transfer needs flats at "
        f"{LEAST_LEVELS} or more levels of light, better 15; take flats and darks of several exposure times"
    )


def _too_few(flats: Sequence[Level], peak: int, fitted: int) -> str:
    """Return why the levels between dark and saturation do not suffice."""
    beyond = [flat for flat in flats[peak + 1 :] if np.isnan(flat.ends[1])]
    if len(beyond) >= LEAST_LEVELS:
        return (
            f"noise falls where light grows, from {flats[peak].signal:.0f} counts on, where nothing is clipped: the counts are "
            "not linear in light; photon transfer needs raw files, without a tone curve such as sRGB's"
        )
    return (
        f"flats at {fitted} levels of light between dark and {SENSITIVITY_SHARE:.0%} of saturation: photon transfer "
        f"needs {LEAST_LEVELS} or more, better 15; add exposure times below {flats[peak].exposure_s:g} s"
    )


def _unclipped(darks: Sequence[Level]) -> list[Level]:
    """Return the darks whose noise is not cut off at 0 counts."""
    return [dark for dark in darks if np.isnan(dark.ends[0])]


def _shared(flats: Sequence[Level]) -> Uncertain:
    """Return the mean sum of correlations with neighbours; 0 where chance, or a sensor, explains it."""
    every = pooled([(flat.shared, flat.pixels) for flat in flats])
    seen = every.value > max(MOST_SHARED, SURELY_SHARED * every.std)
    return every if seen else Uncertain(0.0, every.std)


def _with_shared(levels: Sequence[Level]) -> list[Level]:
    """Return levels with the variance that pixels have together with what they share."""
    found = []
    for level in levels:
        whole = 1 + max(level.shared.value, 0.0)
        std = np.hypot(level.variance_std * whole, level.variance * level.shared.std)
        found.append(
            replace(level, variance=whole * level.variance, variance_std=float(std))
        )
    return found


def _refuse_restless(flats: Sequence[Level]) -> None:
    """Raise DataError where the light changed between flats of one level."""
    changes = [np.ptp(flat.means) / max(flat.signal, 1.0) for flat in flats]
    k = int(np.argmax(changes))
    if changes[k] > MOST_RESTLESS:
        raise DataError(
            f"the light changed by {changes[k]:.1%} between flats of {flats[k].exposure_s:g} s ({flats[k].files[0]}): "
            f"allowed is {MOST_RESTLESS:.0%}; let the lamp warm up, or expose for whole periods of its flicker"
        )


def _refuse_warm(darks: Sequence[Level]) -> None:
    """Raise DataError for darks brighter than the others' dark current explains, by more than a pixel's noise."""
    frames = [*each_frame(darks)]
    seconds, means = (np.array([frame[k] for frame in frames]) for k in (0, 1))
    noise = float(np.sqrt(np.median([dark.variance for dark in darks])))
    slopes = [
        (means[i] - means[j]) / (seconds[i] - seconds[j])
        for i in range(len(means))
        for j in range(i)
        if seconds[i] != seconds[j]
    ]
    level = means - seconds * (np.median(slopes) if slopes else 0.0)  # Theil and Sen
    off = level - np.median(level)
    k = int(np.argmax(np.abs(off)))
    if abs(off[k]) > max(noise, 1.0):
        raise DataError(
            f"{frames[k][2]}, a dark of {seconds[k]:g} s, is {off[k]:+.1f} counts off the other darks, more than a pixel's "
            f"noise of {noise:.1f}: its temperature differs, or light came in; take all darks at one temperature, "
            "right after the flats"
        )


def _fit(design: Floats, values: Floats, std: Floats, misfit: Floats) -> _Line:
    """Fit a linear model by weighted least squares.

    Where residuals are larger than `std`, a multiple of `misfit` is added to it in
    quadrature, such that chi² equals its expectation (Mandel and Paule, Anal. Chem. 42,
    1970). A real sensor departs from the model by more than the many pixels' noise.
    """
    freedom = max(len(values) - design.shape[1], 1)

    def fitted(multiple: float) -> tuple[float, _Line]:
        whole = np.hypot(std, multiple * misfit)
        weighed = design / whole[:, None]
        covariance = np.linalg.inv(weighed.T @ weighed)
        answer = covariance @ (weighed.T @ (values / whole))
        chi2 = np.sum(((values - design @ answer) / whole) ** 2)
        return float(chi2) - freedom, _Line(answer, np.asarray(covariance))

    excess, line = fitted(0.0)
    if excess <= 0:
        return line
    most = float(np.max(np.abs(values) / misfit))
    if fitted(most)[0] > 0:
        return fitted(most)[1]
    return fitted(float(brentq(lambda multiple: fitted(multiple)[0], 0.0, most)))[1]


def _photon_transfer(
    flats: Sequence[Level], darks: Sequence[Level], shared: float
) -> _Line:
    """Fit variance = gain × signal + dark variance + slope × exposure time, the last with darks of several times.

    The signal is counted above darks of the same time, so that their current adds to the
    variance by time alone. shared: sum of a pixel's correlations with its neighbours; what
    they share counts as noise, and half of it as error: a mean keeps all noise at frequency
    0, a median of nine adds 32 %, other filters take some.
    """
    levels = [*flats, *darks]
    if shared > 0:
        line = _photon_transfer(_with_shared(flats), _with_shared(darks), 0.0)
        error = shared / (1 + shared) / 2 * line.values
        return _Line(line.values, line.covariance + np.outer(error, error))
    signal = np.array([flat.signal for flat in flats] + [0.0] * len(darks))
    seconds = np.array([level.exposure_s for level in levels])
    columns = [signal, np.ones(len(levels))]
    if len({dark.exposure_s for dark in darks}) > 1:
        columns.append(seconds)
    variance = np.array([level.variance for level in levels])
    std = np.array([level.variance_std for level in levels])
    return _fit(np.column_stack(columns), variance, std, variance)


def _read_noise(line: _Line) -> tuple[Uncertain, Uncertain]:
    """Return the read noise in counts and in electrons, without the rounding."""
    gain = line.values[0]
    counts = _root(Uncertain(line.values[1] - ROUNDING_VARIANCE, line[1].std))
    slopes = np.zeros(len(line.values))
    slopes[0] = -counts.value / gain**2
    slopes[1] = 0.5 / max(counts.value, np.sqrt(line[1].std)) / gain
    std = float(np.sqrt(slopes @ line.covariance @ slopes))
    return counts, Uncertain(counts.value / gain, std)


def _threshold(line: _Line) -> Uncertain:
    """Return the electrons at a signal-to-noise ratio of 1, equation (26)."""
    gain, dark = line.values[:2]
    root = np.sqrt(max(dark, ROUNDING_VARIANCE) / gain**2 + 0.25)
    slopes = np.zeros(len(line.values))
    slopes[0] = -dark / gain**3 / root
    slopes[1] = 0.5 / gain**2 / root
    return Uncertain(root + 0.5, float(np.sqrt(slopes @ line.covariance @ slopes)))


def _saturation(flats: Sequence[Level], peak: int, gain: Uncertain) -> Uncertain:
    """Return the electrons where the variance is largest; the levels' distance is the error."""
    lower = flats[max(peak - 1, 0)].signal
    apart = (flats[peak + 1].signal - lower) / np.sqrt(24)  # a triangular law between both
    return _over(Uncertain(flats[peak].signal, apart), gain)


def _light(flats: Sequence[Level]) -> Floats:
    """Return the light of each level: photons, or exposure times."""
    return np.array([flat.light for flat in flats])


def _signal_std(flats: Sequence[Level]) -> Floats:
    """Return errors of mean signals: pixels' noise, and the light's changes from frame to frame."""
    changes = [
        np.var(flat.means, ddof=1) / flat.signal**2 for flat in flats if flat.signal > 0
    ]
    restless = float(np.median(changes)) if changes else 0.0
    return np.array(
        [
            np.hypot(flat.signal_std, flat.signal * np.sqrt(restless / len(flat.means)))
            for flat in flats
        ]
    )


def _linearity(flats: Sequence[Level], linear: Sequence[Level]) -> tuple[Floats, Uncertain]:
    """Return each level's relative deviation from a straight line, per cent, and their mean size."""
    if len(linear) < LEAST_LEVELS:
        return np.full(len(flats), np.nan), NAN
    x = _light(linear)
    y = np.array([flat.signal for flat in linear])
    line = _fit(np.column_stack([x, np.ones(len(x))]), y, y, y)
    every = np.array([flat.signal for flat in flats])
    expected = _light(flats) * line.values[0] + line.values[1]
    deviations = 100 * (every - expected) / expected
    inside = np.isin(every, y)
    noise = 100 * _signal_std(linear) / y
    # the mean size of pure noise is 0.8 of its standard deviation: less than this cannot be told
    error = np.hypot(noise.mean() * np.sqrt(2 / np.pi), noise.std() / np.sqrt(len(y)))
    return deviations, Uncertain(float(np.abs(deviations[inside]).mean()), error)


def _efficiency(fitted: Sequence[Level], gain: Uncertain) -> Uncertain:
    """Return electrons per photon; nan where photons are unknown."""
    if any(not flat.photons for flat in fitted):
        return NAN
    signal = np.array([flat.signal for flat in fitted])
    line = _fit(_light(fitted)[:, None], signal, _signal_std(fitted), signal)
    return _over(line[0], gain)


def _dark_line(darks: Sequence[Level]) -> _Line | None:
    """Fit the darks' mean counts against exposure time; None for fewer than three times."""
    if len({dark.exposure_s for dark in darks}) < 3:
        return None
    seconds = np.array([dark.exposure_s for dark in darks])
    means = np.array([dark.signal for dark in darks])
    drift = np.median([np.var(dark.means, ddof=1) for dark in darks])
    std = np.array(
        [np.hypot(dark.signal_std, np.sqrt(drift / len(dark.means))) for dark in darks]
    )
    return _fit(
        np.column_stack([np.ones(len(seconds)), seconds]), means, std, np.ones(len(means))
    )


def _root(square: Uncertain) -> Uncertain:
    """Return the square root, 0 of a negative number; its error stays finite at 0."""
    if np.isnan(square.value):
        return NAN
    root = float(np.sqrt(max(square.value, 0.0)))
    least = float(np.sqrt(square.std)) if square.std > 0 else 1e-300
    return Uncertain(root, square.std / (2 * max(root, least)))


def _times(number: Uncertain, factor: float) -> Uncertain:
    return Uncertain(number.value * factor, number.std * abs(factor))


def _over(above: Uncertain, below: Uncertain) -> Uncertain:
    """Return a quotient of independent numbers."""
    ratio = above.value / below.value
    return Uncertain(
        ratio, float(np.hypot(above.std / below.value, ratio * below.std / below.value))
    )


def _notes(
    series: Series,
    reached: bool,
    line: _Line,
    linear: Sequence[Level],
    shared: Uncertain,
) -> list[str]:
    notes = []
    if shared.value > 0:
        notes.append(
            f"neighbouring pixels share noise, their correlations sum to {shared}: the raw data were filtered (raw noise "
            "reduction); gain and read noise count what is shared, with half of it as error, PRNU and DSNU are what the filter "
            "left; turn noise reduction off"
        )
    full = [flat.ends[1] for flat in series.flats if np.isfinite(flat.ends[1])]
    if full and min(full) < series.white_level - SATURATION_MARGIN * series.white:
        notes.append(
            f"the flats pile up at {min(full):g} counts, below the white level of {series.white_level:g}: saturation is there; "
            "correct sensor.white_level"
        )
    if len(_unclipped(series.darks)) < len(series.darks):
        notes.append(
            "darks are clipped at 0 counts, which cuts their noise off: the read noise is by the other frames; keep the black "
            "level in the files"
        )
    if not reached:
        notes.append(
            f"the flats do not reach saturation, the brightest is at {series.flats[-1].signal / series.white:.0%} of white: "
            "saturation and dynamic range are not determined, and the gain ends at 70 % of the brightest; add longer exposures"
        )
    if line.values[1] < HIDDEN_VARIANCE:
        notes.append(
            f"the darks vary by {np.sqrt(max(line.values[1], 0)):.2f} counts, hardly more than by rounding: the read noise "
            "is an upper limit; take a higher gain (ISO)"
        )
    if series.dark_missing:
        times = ", ".join(f"{seconds:g}" for seconds in series.dark_missing[:5])
        notes.append(
            f"flats of {times} s have no darks of their own exposure time: the nearest are taken, and dark current is in error"
        )
    if len({dark.exposure_s for dark in series.darks}) < 3:
        notes.append(
            "darks of fewer than three exposure times do not determine the dark current: take darks with every exposure time"
        )
    if len(linear) < LEAST_LEVELS:
        notes.append(
            f"{len(linear)} levels between 5 and 95 % of saturation do not determine the linearity: {LEAST_LEVELS} are needed"
        )
    return notes
