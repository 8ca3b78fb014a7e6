"""How a camera blurs a straight edge: line- and edge-spread functions, exact from the OTF's slice (thesis 5.8-5.27, §5.2.3).

A picture of an edge changes only across it, so all of the transfer function that it sees is a slice along its normal: the
autocorrelation of the pupil there, times the pixel's active square and what else the camera adds. The slice's odd
harmonics of a long period make a train of edges that lie far apart; what the others' halo adds is taken off in closed form.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.polynomial import chebyshev
from scipy.interpolate import make_interp_spline

from labkit.imaging.optics import Optics
from labkit.optics.mtf import steepness, turning_transfer_function
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Complexes, Floats

SLICE_NODES, NODES_PER_STEEPNESS = 30, 0.75
"""Of a slice's Chebyshev series in sqrt(1 - f lambda N), in which it is smooth to both ends: right to 1e-8 (tests hold it)."""

SPREAD_PERIODS, LEAST_REACH = (
    8.0,
    150.0,
)  # of the train, in reaches, of which each is at least so many lambda N
FINER = 6.0  # samples to a period of the highest frequency: a quintic spline errs by 2e-6 of a perfect lens
TURN = 1e-4  # radians, of the difference that gives the slope of pixel and camera by the azimuth


@dataclass(frozen=True)
class Slice:
    """The camera's transfer function along an azimuth: (f,) value, (modes, f) by_waves per wave RMS, (f,) by_azimuth per
    radian, at frequencies (f,) cycles/um."""

    frequency: Floats
    value: Complexes
    by_waves: Complexes
    by_azimuth: Complexes


def camera_slice(
    optics: Optics,
    waves: Floats,
    azimuth: float,
    frequency: Floats,
    lens_only: bool = False,
) -> Slice:
    """Return the slice at frequencies (f,), cycles/um, in any order.

    waves: (modes,) RMS at the reference; azimuth: radians from x (right) towards y (down). lens_only: without pixel and camera.
    Thesis §5.2.3, with the active pixel in the place of the sampling period (2.45, corrected).
    """
    lens: Complexes = np.zeros(frequency.size, complex)
    slopes: Complexes = np.zeros((len(optics.noll) + 1, frequency.size), complex)
    for share, node in optics.light.shares:
        value, slope = _lens_slice(optics, waves, azimuth, frequency, node)
        lens += share * value
        slopes += share * slope
    if lens_only:
        return Slice(frequency, lens, slopes[:-1], slopes[-1])
    beyond, low, high = (
        _beyond(optics, azimuth + turn, frequency) for turn in (0.0, -TURN, TURN)
    )
    turning = slopes[-1] * beyond + lens * (high - low) / (2 * TURN)
    return Slice(frequency, lens * beyond, slopes[:-1] * beyond, turning)


def _lens_slice(
    optics: Optics, waves: Floats, azimuth: float, frequency: Floats, node: float
) -> tuple[Complexes, Complexes]:
    """Return the lens's value in one wavelength, and its slopes by modes and azimuth; 0 beyond the cutoff."""
    wavefront = wavefront_of(optics, waves, node)
    cutoff = wavefront.cutoff_per_mm * 1e-3
    count = SLICE_NODES + int(NODES_PER_STEEPNESS * steepness(wavefront))
    angle = np.pi * (np.arange(count) + 0.5) / count
    at = ((1 + np.cos(angle)) / 2) ** 2  # 1 - f lambda N
    value, slopes = turning_transfer_function(
        wavefront, (1 - at) * 1e3 * cutoff, float(np.rad2deg(azimuth))
    )
    series = (
        scipy.fft.dct(
            np.stack([part for row in (value, *slopes) for part in (row.real, row.imag)]),
            axis=1,
        )
        / count
    )
    series[:, 0] /= 2
    below = frequency < cutoff
    spread = np.zeros((len(series), frequency.size))
    spread[:, below] = (
        series
        @ chebyshev.chebvander(2 * np.sqrt(1 - frequency[below] / cutoff) - 1, count - 1).T
    )
    rows = spread[0::2] + 1j * spread[1::2]
    return rows[0], rows[1:]


def wavefront_of(optics: Optics, waves: Floats, node: float = 1.0) -> FittedWavefront:
    """Return the wavefront without errors, in one of the light's wavelengths relative to the nominal one."""
    none = np.zeros((len(optics.noll), len(optics.noll)))
    return FittedWavefront(
        optics.noll,
        waves,
        none,
        node * optics.wavelength_nm,
        optics.reference_nm,
        optics.f_number,
        rim=optics.rim,
    )


def _beyond(optics: Optics, azimuth: float, frequency: Floats) -> Floats:
    """Return the transfer function behind the lens: of the pixel's active square and the camera's parts."""
    columns, rows = frequency * np.cos(azimuth), frequency * np.sin(azimuth)
    beyond: Floats = np.sinc(columns * optics.active_um) * np.sinc(rows * optics.active_um)
    for part in (*optics.given, *optics.parts):
        beyond = beyond * part.transfer(rows * optics.pitch_um, columns * optics.pitch_um)
    return beyond


@dataclass(frozen=True)
class EdgeSpread:
    """The picture of a step from 0 to 1 across its line, as a pixel at a distance r (um) beyond the line sees it.

    read: of distances (n,), (rows, n): the edge-spread function, its slope by r, which is the line-spread function, its
    slopes by each mode, per wave RMS, and by the azimuth at r held, per radian. reach_um: the largest distance that it serves.
    """

    read: Callable[[Floats], Floats]
    reach_um: float


def edge_spread(
    optics: Optics, waves: Floats, azimuth: float, reach_um: float
) -> EdgeSpread:
    """Return the edge-spread function of a camera for an edge whose normal has an azimuth, radians from x
    towards y.

    waves: (modes,) RMS at the reference. Raises ValueError for no reach. Thesis (5.12),
    (5.16), (5.20), (5.27).
    """
    if not reach_um > 0:
        raise ValueError(f"reach_um = {reach_um:g}: a distance above 0 is needed (um)")
    airy_um = optics.airy_um * min(optics.light.nodes) / optics.rim.reach
    period_um = SPREAD_PERIODS * max(reach_um, LEAST_REACH * airy_um)
    harmonic = np.arange(1, int(period_um / airy_um) + 1, 2)
    of = camera_slice(optics, waves, azimuth, harmonic / period_um)
    size = scipy.fft.next_fast_len(int(FINER * period_um / airy_um), real=True)
    steps = (
        (-2j / np.pi)
        * np.concatenate([of.value[None], of.by_waves, of.by_azimuth[None]])
        / harmonic
    )
    line = 4 / period_um * of.value
    spectrum = np.zeros((len(steps) + 1, size // 2 + 1), complex)
    spectrum[:, harmonic] = np.concatenate([steps[:1], line[None], steps[1:]]) * size / 2
    every = scipy.fft.irfft(spectrum, size, axis=1)
    half = int(np.ceil(reach_um / period_um * size)) + 6
    places = np.arange(-half, half + 1)
    at_um, rows = places * period_um / size, every[:, places]
    halo, slope = _other_edges(2 * np.pi * at_um / period_um)
    tail = (
        sum(share * node for share, node in optics.light.shares)
        * 2
        * optics.airy_um
        * optics.rim.halo
        / np.pi**3
    )
    rows[0] += 0.5 + tail * 2 * np.pi / period_um * halo
    rows[1] += tail * (2 * np.pi / period_um) ** 2 * slope
    spline = make_interp_spline(at_um, rows.T, k=5)
    return EdgeSpread(lambda r_um: np.asarray(spline(r_um).T), reach_um)


def _other_edges(x: Floats) -> tuple[Floats, Floats]:
    """Return 1/sin x - 1/x and its slope: the tails, falling as 1/r, of the other edges of a train of alternating ones."""
    terms = (1 / 6, 7 / 360, 31 / 15120, 127 / 604800, 73 / 3421440)
    value = sum(c * x ** (2 * k + 1) for k, c in enumerate(terms))
    slope = sum((2 * k + 1) * c * x ** (2 * k) for k, c in enumerate(terms))
    return np.asarray(value), np.asarray(slope)
