"""How a camera blurs a straight edge: line- and edge-spread functions, exact from the OTF's slice (thesis 5.8-5.27, §5.2.3).

A picture of an edge changes only across it, so all of the transfer function that it sees is a slice along its normal: the
autocorrelation of the pupil there, times the pixel's active square and what else the camera adds. The slice's odd
harmonics of a long period make a train of edges far apart; the others' halo is subtracted in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.polynomial import chebyshev
from scipy.interpolate import BSpline, make_interp_spline

from labkit.edges.blur import Blur
from labkit.imaging.optics import Optics
from labkit.optics.mtf import steepness, turning_transfer_function
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Complexes, Floats

SLICE_NODES, NODES_PER_STEEPNESS = 30, 0.75
"""Of a slice's Chebyshev series in sqrt(1 - f lambda N), in which it is smooth to both ends: right to 1e-8 (tests hold it)."""

SPREAD_PERIODS = 8.0  # of the train, in reaches
LEAST_REACH = 150.0  # lambda N
FINER = 6.0  # samples to a period of the highest frequency: a quintic spline errs by 2e-6 of a perfect lens
SPLINE_DEGREE = 5
TURN = 1e-4  # radians, of the difference that gives the slope of pixel and camera by the azimuth
TAIL = np.polynomial.Polynomial(
    [0, 1 / 6, 0, 7 / 360, 0, 31 / 15120, 0, 127 / 604800, 0, 73 / 3421440]
)
"""1/sin x - 1/x: the tails, falling as 1/r, of the other edges of a train of alternating ones."""


@dataclass(frozen=True)
class Slice:
    """The camera's transfer function along an azimuth.

    Attributes
    ----------
    value : (f,)
    by_waves : (modes, f) per wave RMS
    by_azimuth : (f,) per radian
    by_blur : (numbers, f) of a blur that no wavefront makes
    """

    value: Complexes
    by_waves: Complexes
    by_azimuth: Complexes
    by_blur: Complexes


@dataclass(frozen=True)
class EdgeBlur:
    """A blur of one edge that no wavefront makes: its kind and its numbers."""

    kind: Blur
    numbers: tuple[float, ...]


def camera_slice(
    optics: Optics,
    waves: Floats,
    azimuth: float,
    frequency: Floats,
    blur: EdgeBlur | None = None,
) -> Slice:
    """Return the slice at frequencies (f,), cycles/um, in any order.

    waves: (modes,) RMS at the reference; azimuth: radians from x (right) towards y (down); blur: of the edge.
    Thesis §5.2.3, with the active pixel in the place of the sampling period (2.45, corrected).
    """
    slices = [
        share * _lens_slice(optics, waves, azimuth, frequency, node)
        for share, node in optics.light.shares
    ]
    lens: Complexes = np.sum(slices, axis=0)
    value, by_waves, turning = lens[0], lens[1:-1], lens[-1]
    beyond, low, high = (
        behind_lens(optics, azimuth + turn, frequency) for turn in (0.0, -TURN, TURN)
    )
    by_azimuth = turning * beyond + value * (high - low) / (2 * TURN)
    plain = value * beyond
    if blur is None:
        none = np.empty((0, frequency.size), complex)
        return Slice(plain, by_waves * beyond, by_azimuth, none)
    per_px = frequency * optics.pitch_um
    further = blur.kind.transfer(per_px, blur.numbers)
    by_blur = plain * blur.kind.slopes(per_px, blur.numbers)
    by_waves = by_waves * beyond * further
    return Slice(plain * further, by_waves, by_azimuth * further, by_blur)


def wavefront_at(optics: Optics, waves: Floats, node: float) -> FittedWavefront:
    """Return the wavefront in a wavelength, relative to the nominal one, without errors."""
    return FittedWavefront(
        optics.noll,
        waves,
        np.zeros((waves.size, waves.size)),
        node * optics.wavelength_nm,
        optics.reference_nm,
        optics.f_number,
        rim=optics.rim,
    )


def _lens_slice(
    optics: Optics, waves: Floats, azimuth: float, frequency: Floats, node: float
) -> Complexes:
    """Return the lens's value in a wavelength, then its slopes by modes and azimuth: (modes + 2, f), 0 beyond the cutoff.

    node : wavelength relative to the nominal one
    """
    wavefront = wavefront_at(optics, waves, node)
    count = SLICE_NODES + int(NODES_PER_STEEPNESS * steepness(wavefront))
    at = ((1 + chebyshev.chebpts1(count)[::-1]) / 2) ** 2  # 1 - f lambda N
    value, slopes = turning_transfer_function(
        wavefront, (1 - at) * wavefront.cutoff_per_mm, float(np.rad2deg(azimuth))
    )
    series = scipy.fft.dct(np.concatenate([value[None], slopes]), axis=1) / count
    series[:, 0] /= 2
    left = 1 - frequency * 1e3 / wavefront.cutoff_per_mm
    powers = chebyshev.chebvander(2 * np.sqrt(left.clip(0)) - 1, count - 1)
    return np.asarray(np.where(left > 0, series @ powers.T, 0))


def behind_lens(optics: Optics, azimuth: float, frequency: Floats) -> Floats:
    """Return the transfer function behind the lens: of the pixel's active square and the camera's parts."""
    columns = frequency * np.cos(azimuth)
    rows = frequency * np.sin(azimuth)
    beyond: Floats = np.sinc(columns * optics.active_um) * np.sinc(rows * optics.active_um)
    for part in (*optics.given, *optics.parts):
        beyond = beyond * part.transfer(rows * optics.pitch_um, columns * optics.pitch_um)
    return beyond


@dataclass(frozen=True)
class EdgeSpread:
    """The picture of a step from 0 to 1 across its line, as a pixel at a distance r (um) beyond the line sees it.

    Attributes
    ----------
    spline : of r
    reach_um : largest distance of use
    """

    spline: BSpline
    reach_um: float

    def read(self, r_um: Floats) -> Floats:
        """Return rows (modes + 3 + numbers, n) at distances (n,).

        They are the edge-spread function; its slope by r, which is the line-spread function; its slopes by each mode, per
        wave RMS, by the azimuth at r held, per radian, and by the numbers of the edge's blur.
        """
        return np.asarray(self.spline(r_um).T)


def edge_spread(
    optics: Optics,
    waves: Floats,
    azimuth: float,
    reach_um: float,
    blur: EdgeBlur | None = None,
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
    radians = 2 * np.pi / period_um  # of the train, in a um
    harmonic = np.arange(1, int(period_um / airy_um) + 1, 2)
    of = camera_slice(optics, waves, azimuth, harmonic / period_um, blur)
    size = scipy.fft.next_fast_len(int(FINER * period_um / airy_um), real=True)
    to_step = 1 / (0.5j * np.pi * harmonic)
    line = 4 / period_um * of.value
    steps = [of.value * to_step, line, *of.by_waves * to_step, of.by_azimuth * to_step]
    steps += [*of.by_blur * to_step]
    spectrum = np.zeros((len(steps), size // 2 + 1), complex)
    spectrum[:, harmonic] = steps
    every = scipy.fft.irfft(spectrum, size, axis=1, norm="forward") / 2
    half = int(np.ceil(reach_um / period_um * size)) + SPLINE_DEGREE + 1
    places = np.arange(-half, half + 1)
    at_um = places * period_um / size
    rows = every[:, places]
    nodes = sum(share * node for share, node in optics.light.shares)
    tail = 2 / np.pi**3 * nodes * optics.airy_um * optics.rim.halo
    rows[0] += 0.5 + tail * radians * TAIL(radians * at_um)
    rows[1] += tail * radians**2 * TAIL.deriv()(radians * at_um)
    return EdgeSpread(make_interp_spline(at_um, rows.T, k=SPLINE_DEGREE), reach_um)
