"""Find a pattern that repeats over a flat: the resolved pixels of a panel, which are no illumination.

The pattern has a few sharp peaks in the spectrum, possibly aliased by the sensor; noise and
pixel response lie between them. Demodulation recovers the wave of each peak. Its amplitude
and phase may vary slowly over the frame with perspective and field.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy.fft
from scipy import ndimage

from labkit.types import Bools, Floats

SLOWEST = 0.04
"""Cycles a pixel of a plane: slower waves are the illumination's, which is smoothed over 16 pixels."""

SAME_FREQUENCY = 0.03
"""Least difference of two waves' frequencies, cycles a pixel."""

SLOW_FREQUENCY, LEAST_SLOW = 0.15, 5e-3
"""Cycles a pixel, and amplitude: waves as slow and weaker may be an uneven panel, which is illumination."""

LEAST_WAVE = 2e-3
"""Amplitude, of the light, of the strongest wave of a pattern: noise and dust have less."""

BEYOND_CHANCE = 12.0
"""By so much more than the logarithm of their number a power must exceed the mean: chance does so once in 160 000 planes."""

AMPLITUDE_SMOOTHING_PX, KNOT_PX = 10.0, 4.0
"""Standard deviation of the Gaussian window of a wave's amplitude, which passes 1/50 000 of a wave 0.075 cycles a pixel away;
and the distance of the places with an amplitude, interpolated linearly between."""

MOST_PATTERN_WAVES, WAVE_ROUNDS = 40, 3
"""Of a pattern; and how often each is found anew beside the others, whenever more have shown."""

PATTERN_TILE_PX, BORDER_PX = 256, 24
"""Larger planes are looked at in tiles of this side, which lie over one another by twice the border: all of a tile's waves have
about the same frequencies."""


def repeating(relative: Floats, use: Bools) -> Floats | None:
    """Return the pattern (rows, cols) that repeats over a plane, mean 0; None if there is none.

    relative: (rows, cols) light less its smooth part, in units of the latter; use: usable
    pixels, the others may hold anything
    """
    pattern = np.zeros(relative.shape)
    found = False
    for rows, own_rows in _tiles(relative.shape[0]):
        for cols, own_cols in _tiles(relative.shape[1]):
            waves = _waves(np.where(use, relative, 0.0)[rows, cols], use[rows, cols])
            if waves is not None:
                pattern[own_rows, own_cols] = waves[
                    own_rows.start - rows.start : own_rows.stop - rows.start,
                    own_cols.start - cols.start : own_cols.stop - cols.start,
                ]
                found = True
    return pattern if found else None


def _tiles(size: int) -> list[tuple[slice, slice]]:
    """Return overlapping tiles along an axis, and the part of each that no other tile covers."""
    many = max(1, -(-(size - 2 * BORDER_PX) // (PATTERN_TILE_PX - 2 * BORDER_PX)))
    ends = [round(size * k / many) for k in range(many + 1)]
    return [
        (slice(max(0, low - BORDER_PX), min(size, high + BORDER_PX)), slice(low, high))
        for low, high in pairwise(ends)
    ]


def _waves(relative: Floats, use: Bools) -> Floats | None:
    """Return the pattern of one tile."""
    knots = [_knots(n) for n in use.shape]
    weight = np.maximum(knots[0][0] @ use @ knots[1][0].T, 1e-3)
    rest = relative.copy()
    pattern = np.zeros(use.shape)
    strongest = 0.0
    frequencies = list[Floats]()
    while len(frequencies) < MOST_PATTERN_WAVES:
        new = [
            f
            for f in _peaks(rest, use)
            if all(_distance(f, other) > SAME_FREQUENCY for other in frequencies)
        ]
        if not new:
            break
        frequencies += new[: MOST_PATTERN_WAVES - len(frequencies)]
        for frequency in frequencies * WAVE_ROUNDS:
            down, right = (
                np.exp(2j * np.pi * f * np.arange(n))
                for f, n in zip(frequency, use.shape, strict=True)
            )
            # of the other half of the spectrum there is as much again
            amplitude = (
                2
                * ((knots[0][0] * down.conj()) @ rest @ (knots[1][0] * right.conj()).T)
                / weight
            )
            wave = (
                (down[:, None] * knots[0][1]) @ amplitude @ (right[:, None] * knots[1][1]).T
            ).real
            strongest = max(strongest, float(np.abs(amplitude).mean()))
            pattern += wave
            rest -= np.where(use, wave, 0.0)
    return pattern if strongest > LEAST_WAVE else None


def _knots(size: int) -> tuple[Floats, Floats]:
    """Return (knots, size) weights of the mean about each knot, and (size, knots) of linear interpolation."""
    at = np.linspace(0, size - 1, int(np.ceil(size / KNOT_PX)) + 1)
    pixels = np.arange(size)
    sigma = min(AMPLITUDE_SMOOTHING_PX, size / 8)
    near = np.exp(-(((pixels - at[:, None]) / sigma) ** 2) / 2)
    return near, np.maximum(1 - np.abs(pixels[:, None] - at) / (at[1] - at[0]), 0.0)


def _peaks(rest: Floats, use: Bools) -> list[Floats]:
    """Return the frequencies (2,) of the peaks above the noise of a spectrum, cycles a pixel, strongest first."""
    window = np.outer(*(np.hanning(n + 2)[1:-1] for n in rest.shape)) * use
    size = tuple(
        scipy.fft.next_fast_len(2 * n) for n in rest.shape
    )  # between a whole number of waves too
    power = np.abs(scipy.fft.rfft2(np.where(use, rest, 0.0) * window, size)) ** 2 / max(
        float(np.sum(window**2)), 1e-300
    )
    rows, cols = scipy.fft.fftfreq(size[0])[:, None], scipy.fft.rfftfreq(size[1])[None, :]
    fast = np.hypot(rows, cols) > SLOWEST
    level = float(np.median(power[fast])) / np.log(2)
    tops = fast & (power > level * (np.log(power.size) + BEYOND_CHANCE))
    if not tops.any():
        return []
    tops &= power == ndimage.maximum_filter(power, 5, mode="wrap")
    amplitude = 2 * np.sqrt(power * np.sum(window**2)) / max(float(window.sum()), 1e-300)
    tops &= (amplitude > LEAST_SLOW) | (np.hypot(rows, cols) > SLOW_FREQUENCY)
    found = sorted(zip(power[tops], *np.nonzero(tops), strict=True), reverse=True)
    peaks: list[Floats] = []
    for _, row, col in found:
        at = np.array([rows[row, 0], cols[0, col]])
        if all(_distance(at, other) > SAME_FREQUENCY for other in peaks):
            peaks.append(at)
    return peaks


def _distance(one: Floats, other: Floats) -> float:
    """Return the distance of two frequencies of sampled real waves.

    Frequencies are equal modulo 1, and with the opposite sign.
    """
    apart = [np.array(one) - sign * np.array(other) for sign in (1, -1)]
    return float(min(np.hypot(*(a - np.round(a))) for a in apart))
