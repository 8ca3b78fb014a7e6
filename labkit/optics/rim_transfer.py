"""Transfer function of a pupil that is no clear disc, by the line spread of its samples.

By Parseval's theorem, the light summed across a direction is the sum over rows of the pupil
of squared one-dimensional transforms. The transform of this line spread along the direction
is the transfer function. The halo beyond its window equals that of a disc with the same
halo, whose transfer function is a closed form.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from labkit.optics.psf import diffraction_mtf
from labkit.optics.pupil import ARC_SPACING, OUTLINE_REACH, smooth_outline
from labkit.optics.rim import ROUND_RIM, Rim
from labkit.optics.wavefront import FittedWavefront, modes_at
from labkit.types import Complexes, Floats

SAMPLED_RADIUS = 100.0
"""Of the pupil, samples; its window is as many times 2 lambda N wide."""


def rim_transfer(
    wavefront: FittedWavefront, frequency_per_mm: Floats, azimuth_deg: float
) -> tuple[Complexes, Complexes]:
    """Return the transfer function of a pupil of any rim, as `labkit.optics.mtf.transfer_function`.

    Parameters
    ----------
    wavefront : modes and light
    frequency_per_mm : (f,) cycles/mm on the sensor
    azimuth_deg : direction of the frequencies, from x towards y

    Returns
    -------
    (f,), and (modes, f) its derivatives per wave RMS
    """
    value = np.zeros(len(frequency_per_mm), complex)
    slopes = np.zeros((len(wavefront.noll), len(frequency_per_mm)), complex)
    for share, light in wavefront.lights:
        airy_mm = light.wavelength_um * light.f_number * 1e-3
        nu = frequency_per_mm * airy_mm
        spread, by_mode = _line_spread(light, np.deg2rad(azimuth_deg))
        halo = wavefront.rim.halo
        size = spread.size
        places = np.arange(size) - size // 2
        turn = np.exp(-2j * np.pi * 2 * SAMPLED_RADIUS / size * np.outer(places, nu))
        passes = np.abs(nu) < wavefront.rim.reach
        departure = (spread - _disc_spread(halo, size)) @ turn
        value += share * passes * (departure + diffraction_mtf(nu * halo))
        slopes += share * passes * (by_mode @ turn)
    return value, slopes


def _line_spread(wavefront: FittedWavefront, azimuth: float) -> tuple[Floats, Floats]:
    """Return shares of light (n,) at places along an azimuth, and derivatives (modes, n), at one wavelength."""
    rim = wavefront.rim.turned(-azimuth)
    offsets, clear = _amplitude(rim, SAMPLED_RADIUS, SAMPLED_RADIUS * rim.longest)
    x, y = np.meshgrid(offsets / SAMPLED_RADIUS, offsets / SAMPLED_RADIUS)
    cosine = np.cos(azimuth)
    sine = np.sin(azimuth)
    modes = modes_at(wavefront.noll, x * cosine - y * sine, x * sine + y * cosine)
    factor = 1j * wavefront.radians_per_wave
    pupil = clear * np.exp(factor * np.tensordot(wavefront.waves, modes, 1))
    size = _size(offsets.size)
    field = _transformed(pupil, size)
    spread = np.sum(np.abs(field) ** 2, axis=0)
    slopes = [
        2
        * np.sum((np.conj(field) * _transformed(factor * pupil * mode, size)).real, axis=0)
        for mode in modes
    ]
    light = size * np.pi * SAMPLED_RADIUS**2
    return spread / light, np.array(slopes).reshape(-1, size) / light


def _disc_spread(halo: float, size: int) -> Floats:
    """Return shares of light (n,) of a perfect disc with a halo."""
    radius = SAMPLED_RADIUS / halo
    _, clear = _amplitude(ROUND_RIM, radius, radius)
    spread = np.sum(np.abs(_transformed(clear, size)) ** 2, axis=0)
    return np.asarray(spread / (size * np.pi * radius**2))


def _amplitude(rim: Rim, radius: float, longest: float) -> tuple[Floats, Floats]:
    """Return coordinates (n,), samples, and the amplitude (n, n)."""
    half = int(np.ceil(longest)) + OUTLINE_REACH
    offsets = np.arange(-half, half + 1.0)
    arcs = int(np.ceil(2 * np.pi * radius / ARC_SPACING))
    return offsets, smooth_outline(offsets, [radius * edge for edge in rim.edges(arcs)])


def _size(width: int) -> int:
    """Return an even number of samples of an intensity without aliases."""
    return 2 * int(scipy.fft.next_fast_len(width))


def _transformed(pupil: Floats | Complexes, size: int) -> Complexes:
    """Return the transform of each row, frequency 0 in the middle, without a phase common to all rows."""
    return np.asarray(scipy.fft.fftshift(scipy.fft.fft(pupil, size, axis=1), axes=1))
