"""Whether a program has enlarged, smoothed or sharpened a picture: its noise and its edges show it.

Noise of neighbouring pixels is independent where the sensor sampled the light. Enlarging makes new pixels between the old ones,
so that noise ends at a frequency below Nyquist's, and its strength repeats with the old pixels (Gallagher, CRV 2005). Light's
point spread is nowhere negative and makes no edge overshoot; sharpening does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labkit.photographs.photograph import Photograph
from labkit.plan.sensor import IN_COLOURS, MONO
from labkit.types import Counts, Floats

NOISE_TILE_PX = 32
MOST_TILES = 4096
LEAST_TILES = 32
SEEN = 8.0
"""Noise is seen where it has this many times the variance of rounding."""

SLOW_BAND, MIDDLE_BAND, UPPER_BAND = (0.04, 0.10), (0.10, 0.20), (0.42, 0.50)
"""Bands, cycles per pixel: noise in the upper one is compared with that in the middle."""

ACROSS_BAND = (0.05, 0.20)
"""Frequencies across those of the upper band. Offsets of rows or columns, whatever their pattern, have the frequency 0 there,
which the window widens to 0.03, and a checkerboard's 0.5."""

SMOOTH_RATIO = 3.0
"""A part is smooth whose slow band has no more than this times its middle one's power: structure has far more."""

EMPTY, ENLARGED = 0.06, 0.1
"""Noise in the upper band over noise in the middle band: 1 for a sensor, 0.3 for demosaiced green, 0.08 for JPEGs of low
quality, 0.05 and 0.01 for pictures enlarged 1.25 and 1.5 times. A picture is altered below the first limit, or below the
second if the noise's strength is periodic."""

AMPLIFIED = 1.25
PERIODIC = 100.0
"""Power of a period over the median of all periods: at most 12 in 4,000 random pictures, 46 in JPEGs, 120 and far more in
enlarged pictures."""

FLAT_PX, HALO_PX = (8, 14), 7
"""From an edge: where it must be flat on both sides, and how far a halo reaches."""

EVEN_EDGE = 0.03
"""Of an edge's contrast: how much the mean of all edges may vary there."""

LEAST_PROFILES, MOST_PROFILES, MOST_PROFILE_ROWS = 40, 20_000, 512
OVERSHOOT = 0.05
"""Of an edge's contrast."""

OFFSET_SIGMAS, OFFSET_SHARE = 8.0, 0.5
"""Black levels differ if they do by this many standard errors, and by this share of a pixel's noise."""


@dataclass(frozen=True, slots=True)
class Alterations:
    """Changes made to a picture by a program.

    refusal: reason why the picture cannot be used, as the end of a sentence, or None;
    notes: further remarks, one line each
    """

    refusal: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the smooth parts of a picture.

    upper: power near Nyquist's frequency over that in the middle, along rows and columns;
    periodic: power of the strongest period over the median's;
    offsets: by name, differences of black levels that stand out of a pixel's noise, in
    counts
    """

    upper: tuple[float, float]
    periodic: float
    offsets: Mapping[str, float]


def alterations(photograph: Photograph) -> Alterations:
    """Return the traces of a program in a picture; none of a mosaic, which was never altered."""
    if photograph.pattern not in (MONO, IN_COLOURS):
        return Alterations()
    plane = photograph.part("G")  # green is interpolated least
    noise, overshoot = noise_of(plane), edge_overshoot(plane.counts)
    notes: list[str] = []
    periodic = noise is not None and noise.periodic > PERIODIC
    if noise is not None and max(noise.upper) < (ENLARGED if periodic else EMPTY):
        share = f"{100 * max(noise.upper):.1f} %"
        percent = f"{share} near Nyquist's frequency of what it is below"
        if periodic:
            return Alterations(
                f"has been enlarged by a program: its noise is {percent}, and its strength repeats with the pixels that were "
                "there before; give the picture as the camera made it"
            )
        # compression hides the period of what was enlarged before it, and empties a spectrum a little by itself
        how = "smoothed by noise reduction or by a program"
        if photograph.compressed:
            how = "enlarged or smoothed by a program, or much compressed"
        notes.append(
            f"the photographs were {how}, noise is {percent}: that is part of the PSF; give them as the camera made them"
        )
    if noise is not None and noise.offsets and photograph.tone is None:
        listed = ", ".join(f"{name} by {by:.2g}" for name, by in noise.offsets.items())
        notes.append(
            f"black levels differ, in counts: {listed}; dark frames of the same exposure remove it"
        )
    how = ""
    if overshoot > OVERSHOOT:
        how = f"edges overshoot by {100 * overshoot:.0f} %"
    elif noise is not None and min(noise.upper) > AMPLIFIED:
        how = "noise grows with frequency"
    if how:
        notes.append(
            f"the photographs were sharpened, {how}: that is part of the PSF, and no wavefront makes it; develop them again "
            "without sharpening"
        )
    return Alterations(None, tuple(notes))


def noise_of(photograph: Photograph) -> Noise | None:
    """Return the noise of a picture of one colour; None if structure and rounding hide it."""
    plane = photograph.counts
    if min(plane.shape) < 2 * NOISE_TILE_PX:
        return None
    rows, cols = (size // NOISE_TILE_PX for size in plane.shape)
    places = np.argwhere(np.ones((rows, cols), bool))
    places = places[:: -(-len(places) // MOST_TILES)]
    tiles = (
        plane[: rows * NOISE_TILE_PX, : cols * NOISE_TILE_PX]
        .reshape(rows, NOISE_TILE_PX, cols, NOISE_TILE_PX)
        .swapaxes(1, 2)
    )
    chosen = tiles[places[:, 0], places[:, 1]].astype(np.float64)
    power, rounding = _spectra(chosen), _rounding(photograph, chosen.mean(axis=(1, 2)))
    middle = _band(power, MIDDLE_BAND, MIDDLE_BAND)
    seen = (middle > SEEN * rounding) & (
        _band(power, SLOW_BAND, SLOW_BAND) < SMOOTH_RATIO * middle
    )
    if np.count_nonzero(seen) < LEAST_TILES:
        return None
    noise = np.mean((middle - rounding)[seen])
    along_rows, along_cols = (
        float(np.mean((_band(turned, UPPER_BAND, ACROSS_BAND) - rounding)[seen]) / noise)
        for turned in (power, power.swapaxes(1, 2))
    )
    return Noise(
        (max(0.0, along_rows), max(0.0, along_cols)),
        _periodic(plane, places[seen], photograph.compressed),
        _offsets(chosen[seen], float(np.sqrt(noise))),
    )


def _offsets(tiles: Floats, noise_std: float) -> dict[str, float]:
    """Return by name the differences between the four places of a cell of two by two that stand out, in counts.

    tiles: (tiles, rows, columns) of smooth parts; noise_std: of a pixel.
    """
    signs = {
        "even and odd rows": ((1, 1), (-1, -1)),
        "even and odd columns": ((1, -1), (1, -1)),
        "the two diagonals of each four pixels": ((1, -1), (-1, 1)),
    }
    rows, columns = tiles.shape[1:]
    pairs = tiles.reshape(-1, rows // 2, 2, columns // 2, 2).mean(axis=(1, 3))
    offsets = dict[str, float]()
    for name, of in signs.items():
        each = np.einsum("trc,rc->t", pairs, np.array(of)) / 2
        difference = abs(float(each.mean()))
        std = float(each.std(ddof=1)) / np.sqrt(len(each))
        if difference > max(OFFSET_SIGMAS * std, OFFSET_SHARE * noise_std):
            offsets[name] = difference
    return offsets


def edge_overshoot(plane: ArrayLike) -> float:
    """Return the overshoot of upright and lying edges between even parts, as a share of their contrast; 0
    without edges.

    plane: (rows, cols), any scale. The mean over edges of each direction, the larger of
    both.
    """
    picture = np.asarray(plane, dtype=np.float64)
    return max(_overshoot_along_rows(picture), _overshoot_along_rows(picture.T))


def _rounding(photograph: Photograph, level: Floats) -> Floats:
    """Return the variance (tiles,) of rounding at those levels."""
    if photograph.tone is None:
        return np.full(level.shape, 1 / 12)
    return photograph.tone.rounding_variance(level)


def _spectra(tiles: Floats) -> Floats:
    """Return power (tiles, size, size), in which white noise has its variance at every frequency; a tile's slope is
    subtracted.
    """
    size = tiles.shape[-1]
    ramp = np.broadcast_to(np.linspace(-1.0, 1.0, size), (size, size))
    level = tiles - tiles.mean(axis=(1, 2), keepdims=True)
    for slope in (ramp, ramp.T):
        level = (
            level
            - np.einsum("tij,ij->t", level, slope)[:, None, None] / np.sum(slope**2) * slope
        )
    window = np.outer(np.hanning(size), np.hanning(size))
    return np.asarray(np.abs(np.fft.fft2(level * window)) ** 2 / np.sum(window**2))


def _band(power: Floats, first: tuple[float, float], second: tuple[float, float]) -> Floats:
    """Return the mean power (tiles,) in bands of frequencies along rows and along columns, cycles per pixel."""
    frequency = np.abs(np.fft.fftfreq(power.shape[-1]))
    along, across = (
        (frequency >= low) & (frequency <= high) for low, high in (first, second)
    )
    return np.asarray(power[:, along][:, :, across].mean(axis=(1, 2)))


def _periodic(plane: Counts, places: NDArray[np.intp], compressed: bool) -> float:
    """Return how much the strength of differences in these tiles repeats from column to column, or from row to row.

    Second differences of pixels made at the same places between old ones are as strong; where those places lie
    symmetrically, as in twice as many pixels, first differences decide.
    """
    strongest = 0.0
    for picture, turned in ((plane, places), (plane.T, places[:, ::-1])):
        for order in (1, 2):
            strength = np.zeros(picture.shape[1])
            for row, col in turned * NOISE_TILE_PX:
                part = picture[row : row + NOISE_TILE_PX, col : col + NOISE_TILE_PX].astype(
                    np.float64
                )
                steps = np.abs(np.diff(part, order, axis=1))
                strength[col + 1 : col + 1 + steps.shape[1]] += (
                    steps / max(float(steps.mean()), 1e-12) - 1
                ).sum(axis=0)
            strongest = max(strongest, _strongest_period(strength, compressed))
    return strongest


def _strongest_period(strength: Floats, compressed: bool) -> float:
    """Return the power of the strongest period of 10 or fewer pixels, relative to the median's.

    compressed: without those of JPEG's blocks of eight, seen through tiles.
    """
    power, cycles = (
        np.abs(np.fft.rfft(strength)) ** 2,
        NOISE_TILE_PX * np.fft.rfftfreq(len(strength)),
    )
    kept = cycles > 0.1 * NOISE_TILE_PX
    if compressed:
        kept &= np.abs(cycles - np.round(cycles)) > 0.15
    return float(power[kept].max() / max(np.median(power[kept]), 1e-12))


def _overshoot_along_rows(plane: Floats) -> float:
    """Return the overshoot of edges that rows cross."""
    (near, far), (rows, cols) = FLAT_PX, plane.shape
    if cols < 4 * far:
        return 0.0
    picture = plane[:: -(-rows // MOST_PROFILE_ROWS)]
    low, high = np.percentile(picture, (2, 98))
    slope = np.abs(picture[:, 2:] - picture[:, :-2])[:, far : -far - 2]
    steep = np.argwhere(slope > 0.1 * (high - low))
    steep = steep[:: -(-len(steep) // MOST_PROFILES) or 1]
    profiles = picture[steep[:, :1], steep[:, 1:] + far + 1 + np.arange(-far, far + 1)]
    steps = np.abs(profiles[:, 2:] - profiles[:, :-2])[:, far - HALO_PX : far + HALO_PX - 1]
    before, after = profiles[:, : far - near + 1], profiles[:, near - far - 1 :]
    contrast = after.mean(axis=1) - before.mean(axis=1)
    flat = np.maximum(np.ptp(before, axis=1), np.ptp(after, axis=1)) < 0.25 * np.abs(
        contrast
    )
    middle = steps.argmax(axis=1) == HALO_PX - 1  # the edge stands where it is steepest
    chosen = flat & middle & (np.abs(contrast) > 0.4 * (high - low))
    if np.count_nonzero(chosen) < LEAST_PROFILES:
        return 0.0
    mean = np.where(
        contrast[chosen, None] > 0, profiles[chosen], profiles[chosen, ::-1]
    ).mean(axis=0)
    # a bright side may be clipped, so that only the dark one shows it
    return max(_overshoot_of(mean), _overshoot_of(-mean[::-1]))


def _overshoot_of(profile: Floats) -> float:
    """Return the overshoot on the bright side of a mean edge, dark first; 0 if this side is uneven."""
    near, far = FLAT_PX
    dark, bright = profile[: far - near + 1].mean(), profile[near - far - 1 :].mean()
    overshoot = float((profile[far : far + HALO_PX + 1].max() - bright) / (bright - dark))
    # structure nearby, out of focus, looks like a halo; a wide halo reaches there too, but less than at the edge
    uneven = np.ptp(profile[near - far - 1 :]) / (bright - dark)
    return 0.0 if uneven > max(EVEN_EDGE, overshoot / 3) else overshoot
