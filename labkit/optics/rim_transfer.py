"""Transfer function behind a pupil of any rim: that of the line spread of the pupil's samples.

By Parseval's theorem, the light summed across a direction is the sum over rows of the pupil
of squared one-dimensional transforms. The transform of this line spread along the direction
is the transfer function. Its window lacks the far halo, which tells at low frequencies only
and hardly depends on the wavefront: there the departure from a perfect lens is added to the
overlap of the pupil with its copy, which is exact.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from labkit.optics.overlap import overlaps
from labkit.optics.psf import ARC_SPACING, OUTLINE_REACH, smooth_outline
from labkit.optics.rim import Rim
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Complexes, Floats

SAMPLED_RADIUS = 100.0
"""Of the pupil, samples; its window is as many times 2 lambda N wide."""

HALO_CYCLES = 0.05
"""Of 1/(lambda N), above which the light beyond the window changes a transfer function by 3e-6."""


def rim_transfer(
    wavefront: FittedWavefront,
    frequency_per_mm: Floats,
    turn: float,
    tables: Floats,
    slopes: bool = True,
) -> tuple[Complexes, Complexes]:
    """Return the transfer function (f,) at frequencies (f,), and its derivatives (modes, f), per wave RMS.

    Parameters
    ----------
    wavefront : its modes and its rim
    frequency_per_mm : along the azimuth
    turn : azimuth, radians from x towards y
    tables : (modes, d + 1, d + 1) modes as polynomials in coordinates with x along the azimuth
    slopes : whether derivatives are computed; they are 0 otherwise
    """
    value = np.zeros(len(frequency_per_mm), complex)
    by_mode = np.zeros((len(wavefront.noll), len(frequency_per_mm)), complex)
    rim = wavefront.rim
    for share, light in wavefront.lights:
        nu = frequency_per_mm * light.wavelength_um * light.f_number * 1e-3
        spread, its_slopes = _line_spread(light, turn, tables, slopes)
        places = np.arange(spread.size) - spread.size // 2
        wave = np.exp(-4j * np.pi * SAMPLED_RADIUS / spread.size * np.outer(places, nu))
        passes = np.abs(nu) < rim.reach
        value += share * passes * (spread @ wave + _far_halo(rim, turn, nu, wave))
        if slopes:
            by_mode += share * passes * (its_slopes @ wave)
    return value, by_mode


def _far_halo(rim: Rim, turn: float, nu: Floats, wave: Complexes) -> Floats:
    """Return what the light beyond the window adds to the transfer function (f,).

    Parameters
    ----------
    rim : of the pupil
    turn : azimuth, radians
    nu : frequencies (f,) of 1/(lambda N)
    wave : (n, f) takes a line spread to its transfer function
    """
    added = np.zeros(len(nu))
    low = np.abs(nu) < HALO_CYCLES
    whole = overlaps(rim, 2 * np.abs(nu[low]), np.array([turn]))[0]
    added[low] = whole - (_perfect_spread(rim, turn) @ wave[:, low]).real
    return added


def _line_spread(
    wavefront: FittedWavefront, turn: float, tables: Floats, slopes: bool
) -> tuple[Floats, Floats]:
    """Return shares of light (n,) at places along an azimuth, and derivatives (modes, n), at one wavelength.

    Modes are polynomials in coordinates with x along the azimuth: the field needs a transform
    for each power of x in place of one for each mode.
    """
    offsets, clear = _amplitude(wavefront.rim, turn)
    powers = (offsets[:, None] / SAMPLED_RADIUS) ** np.arange(tables.shape[1])
    path = powers @ np.tensordot(wavefront.waves, tables, 1).T @ powers.T
    factor = 1j * wavefront.radians_per_wave
    pupil = clear * np.exp(factor * path)
    size = _size(offsets.size)
    field = scipy.fft.fft(pupil, size)
    spread = _spread(field)
    if not slopes:
        return spread, np.zeros((len(tables), 0))
    light = size * np.pi * SAMPLED_RADIUS**2
    turned = 2 * factor / light * np.conj(field)
    by_power = [
        powers.T @ (turned * scipy.fft.fft(pupil * power, size)).real for power in powers.T
    ]  # for each power of x: (powers of y, n)
    its_slopes = np.tensordot(tables, np.array(by_power), 2)
    return spread, scipy.fft.fftshift(its_slopes, axes=1)


@lru_cache(maxsize=128)
def _perfect_spread(rim: Rim, turn: float) -> Floats:
    """Return shares of light (n,) of a perfect lens at places along an azimuth."""
    _, clear = _amplitude(rim, turn)
    return _spread(scipy.fft.fft(clear, _size(len(clear))))


def _spread(field: Complexes) -> Floats:
    """Return shares of light (n,) by the transforms (rows, n) of a pupil's rows."""
    light = field.shape[1] * np.pi * SAMPLED_RADIUS**2
    return np.asarray(scipy.fft.fftshift(np.sum(np.abs(field) ** 2, axis=0) / light))


@lru_cache(maxsize=128)
def _amplitude(rim: Rim, turn: float) -> tuple[Floats, Floats]:
    """Return coordinates (n,), samples, and the amplitude (n, n) with the light of the full pupil, x along an azimuth.

    All wavelengths and wavefronts of a lens have the same; to draw a rim takes twice as long as its transforms.
    """
    half = int(np.ceil(SAMPLED_RADIUS * rim.longest)) + OUTLINE_REACH
    offsets = np.arange(-half, half + 1.0)
    arcs = int(np.ceil(2 * np.pi * SAMPLED_RADIUS / ARC_SPACING))
    edges = rim.turned(-turn).edges(arcs)
    clear = smooth_outline(offsets, [SAMPLED_RADIUS * edge for edge in edges])
    return offsets, clear / np.sqrt(rim.area)


def _size(width: int) -> int:
    """Return an even number of samples of an intensity without aliases."""
    return 2 * int(scipy.fft.next_fast_len(width))
