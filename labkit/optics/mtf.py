"""MTF of a fitted wavefront: the autocorrelation of its pupil, integrated separately for each frequency.

No raster and no window enter. At a frequency f along a direction, two copies of the pupil 2
f lambda N of its radius apart overlap in a lens-shaped region. With y = sin(beta) its
borders are smooth, and Gauss's rule in beta and x converges geometrically. J. W. Goodman,
Introduction to Fourier Optics, 3rd ed. (1996), §6.4.

A pupil that is no clear disc: `rim_transfer`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import atan2, degrees
from typing import Literal

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import comb

from labkit.arrays import positive, real_array
from labkit.optics.known_bias import in_any_light
from labkit.optics.rim_transfer import rim_transfer
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import cartesian, nm_to_noll, noll_to_nm
from labkit.types import Complexes, Floats
from labkit.uncertain import Uncertain

Direction = Literal["x", "y", "tangential", "sagittal"]
FIXED: dict[str, float] = {"x": 0.0, "y": 90.0}
PER_MM = "cycles/mm on the sensor"

BLOCK = 1 << 15
"""Nodes at once: their arrays stay in the cache, and no memory is fetched anew each time."""

TURNS = 1024  # parts of a turn at which cosine and sine are tabulated
COSINES = np.cos(2 * np.pi / TURNS * np.arange(TURNS))
SINES = np.sin(2 * np.pi / TURNS * np.arange(TURNS))
TURN_DEG = 0.05  # of a rim, in differences
HALF_MODULATION_GRID = 200
"""Frequencies up to the cutoff among which the first below one half is searched."""
SEARCHED_AT_ONCE = 20


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Modulation at frequencies with standard errors.

    Parameters
    ----------
    frequency_per_mm : cycles/mm on the sensor
    value, std : modulation and its standard error, of the same shape
    """

    frequency_per_mm: Floats
    value: Floats
    std: Floats


def azimuth_deg(direction: Direction | float, field: Sequence[float] = (0.0, 0.0)) -> float:
    """Return the direction of a frequency, degrees from x (right, along rows) towards y (down, along columns).

    Tangential frequencies point along the field's radius, as in a meridional plane (their
    lines are tangents of circles about the axis); sagittal frequencies point across. On the
    axis, where both are the same by symmetry, the field counts as along y: tangential is y,
    sagittal is x. field: (row, column) of the place on the sensor from the optical axis, in
    any unit. Raises ValueError for another direction.
    """
    if not isinstance(direction, str):
        return float(real_array("direction", direction, (), "degrees from x towards y"))
    if direction in FIXED:
        return FIXED[direction]
    if direction not in ("tangential", "sagittal"):
        raise ValueError(
            f"direction {direction!r}: x, y, tangential, sagittal or degrees from x towards y are possible"
        )
    row, column = real_array("field", field, (2,), "row and column from the optical axis")
    radius = degrees(atan2(row, column)) if row or column else FIXED["y"]
    return radius if direction == "tangential" else radius - 90.0


@in_any_light
def mtf(
    wavefront: FittedWavefront,
    frequency_per_mm: ArrayLike,
    direction: Direction | float,
    field: Sequence[float] = (0.0, 0.0),
) -> Curve:
    """Return the modulation transfer of the optics alone along a direction, with standard errors.

    Errors follow from the delta method and include the f-number's. A zero of the MTF has no
    derivative: there the errors are those of the transfer function itself. Errors of an MTF
    of their own size are rough.

    Parameters
    ----------
    wavefront : the optics
    frequency_per_mm : frequencies of any shape, cycles/mm on the sensor
    direction, field : as in `azimuth_deg`

    Returns
    -------
    Modulation and errors, of the frequencies' shape
    """
    frequency = real_array("frequency_per_mm", frequency_per_mm, None, PER_MM)
    along = frequency.ravel()
    azimuth = azimuth_deg(direction, field)
    value, gradient = modulus(
        *transfer_function(wavefront, along, azimuth, not wavefront.exact)
    )
    variance = wavefront.variance(gradient)
    if wavefront.scale_relative_std:
        slope = _slope(wavefront, along, azimuth)
        variance = variance + (wavefront.scale_relative_std * along * slope) ** 2
    std = np.sqrt(variance)
    return Curve(frequency, value.reshape(frequency.shape), std.reshape(frequency.shape))


def _slope(wavefront: FittedWavefront, frequency: Floats, azimuth: float) -> Floats:
    """Return the derivative of the MTF by frequency, mm; a larger aperture stretches the frequency axis."""
    step = 1e-4 * wavefront.cutoff_per_mm
    after, before = (
        np.abs(transfer_function(wavefront, frequency + d, azimuth, slopes=False)[0])
        for d in (step, -step)
    )
    return np.asarray((after - before) / (2 * step))


def modulus(transfer: Complexes, slopes: Complexes) -> tuple[Floats, Floats]:
    """Return the modulus (f,) of a transfer function (f,), and its slopes (n, f) from the function's."""
    value = np.abs(transfer)
    phase = np.divide(np.conj(transfer), value, out=np.ones_like(transfer), where=value > 0)
    return value, np.asarray((slopes * phase).real)


def mtf50(
    wavefront: FittedWavefront,
    direction: Direction | float,
    field: Sequence[float] = (0.0, 0.0),
    active_um: float | None = None,
) -> Uncertain:
    """Return the lowest frequency, cycles/mm, at which the MTF falls to one half, with errors as `mtf`.

    Such a frequency always exists: every MTF ends at zero. direction, field: as in
    `azimuth_deg`. active_um: width of the pixel's square active area, to include its
    `pixel_mtf`; None for the optics alone.
    """
    azimuth = azimuth_deg(direction, field)
    cutoff = wavefront.cutoff_per_mm

    def pixel(frequency: Floats) -> Floats:
        if active_um is None:
            return np.ones_like(frequency)
        return pixel_mtf(frequency, active_um, azimuth)

    def values(frequency: Floats) -> Floats:
        transfer, _ = transfer_function(wavefront, frequency, azimuth, slopes=False)
        return np.abs(transfer) * pixel(frequency)

    low, high = _first_below_half(values, cutoff)
    half = brentq(
        lambda f: float(values(np.array([f]))[0]) - 0.5, low, high, xtol=1e-10 * cutoff
    )
    step = 1e-5 * cutoff
    after, before = values(np.array([half + step, half - step]))
    slope = float(after - before) / (2 * step)
    std = mtf(wavefront, half, azimuth).std * pixel(np.array(half))
    return Uncertain(half, float(std) / abs(slope), "cycles/mm")


def _first_below_half(values: Callable[[Floats], Floats], cutoff: float) -> Floats:
    """Return the two frequencies of a grid between which a curve first falls below one half."""
    grid = np.linspace(0, cutoff, HALF_MODULATION_GRID + 1)
    blocks = (
        grid[k : k + SEARCHED_AT_ONCE + 1] for k in range(0, grid.size, SEARCHED_AT_ONCE)
    )
    block, low = next((b, low) for b in blocks if (low := values(b) < 0.5).any())
    first = int(np.argmax(low))
    return block[first - 1 : first + 1]


def pixel_mtf(
    frequency_per_mm: ArrayLike,
    active_um: float,
    direction: Direction | float,
    field: Sequence[float] = (0.0, 0.0),
) -> Floats:
    """Return the MTF of a pixel's square active area; times the optics' MTF it is the camera's.

    direction, field: as in `azimuth_deg`. Thesis (2.45), corrected.
    """
    frequency = real_array("frequency_per_mm", frequency_per_mm, None, PER_MM)
    azimuth = np.deg2rad(azimuth_deg(direction, field))
    width_mm = positive("active_um", active_um, "um") * 1e-3
    x, y = frequency * np.cos(azimuth), frequency * np.sin(azimuth)
    return np.asarray(np.abs(np.sinc(x * width_mm) * np.sinc(y * width_mm)))


def transfer_function(
    wavefront: FittedWavefront,
    frequency_per_mm: Floats,
    azimuth_deg: float,
    slopes: bool = True,
) -> tuple[Complexes, Complexes]:
    """Return the transfer function (f,) at frequencies (f,) along an azimuth, and its derivatives (modes, f)
    per wave RMS.

    The function is the Fourier transform of the PSF: light to the right of the origin has a
    falling phase along x. slopes: whether derivatives are computed; they are 0 otherwise
    """
    turn = float(np.deg2rad(azimuth_deg))
    tables = _tables(wavefront.noll, turn)
    if not wavefront.rim.is_round:
        return rim_transfer(wavefront, frequency_per_mm, turn, tables, slopes)
    return _slice(wavefront, frequency_per_mm, tables, slopes)


def turning_transfer_function(
    wavefront: FittedWavefront, frequency_per_mm: Floats, azimuth_deg: float
) -> tuple[Complexes, Complexes]:
    """Return `transfer_function`, with a last derivative by the azimuth, per radian: (modes + 1, f).

    Turning the slice equals turning the wavefront the other way, which costs one more row
    of the same sums.
    """
    if not wavefront.rim.is_round:
        value, slopes = transfer_function(wavefront, frequency_per_mm, azimuth_deg)
        after, before = (
            transfer_function(wavefront, frequency_per_mm, azimuth_deg + d, slopes=False)[0]
            for d in (TURN_DEG, -TURN_DEG)
        )
        by_turn = (after - before) / (2 * np.deg2rad(TURN_DEG))
        return value, np.concatenate([slopes, by_turn[None]])
    turn = np.deg2rad(azimuth_deg)
    turning = np.tensordot(wavefront.waves, _tables(wavefront.noll, turn, slope=True), 1)
    return _slice(
        wavefront,
        frequency_per_mm,
        np.concatenate([_tables(wavefront.noll, turn), turning[None]]),
    )


def _slice(
    wavefront: FittedWavefront,
    frequency_per_mm: Floats,
    tables: Floats,
    with_slopes: bool = True,
) -> tuple[Complexes, Complexes]:
    """Return (f,) the transfer function, and (tables, f) its derivatives by paths, the modes' first."""
    value = np.zeros(len(frequency_per_mm), complex)
    slopes = np.zeros((len(tables), len(frequency_per_mm)), complex)
    for share, light in wavefront.lights:
        of_light, its_slopes = _slice_in_one_light(
            light, frequency_per_mm, tables, with_slopes
        )
        value += share * of_light
        slopes += share * its_slopes
    return value, slopes


def _slice_in_one_light(
    wavefront: FittedWavefront, frequency_per_mm: Floats, tables: Floats, with_slopes: bool
) -> tuple[Complexes, Complexes]:
    """Return `_slice` at one wavelength; 0 beyond the cutoff."""
    apart = np.minimum(
        2 * np.abs(frequency_per_mm) / wavefront.cutoff_per_mm, 2.0
    )  # of the pupil's radius
    radians = wavefront.radians_per_wave * np.where(frequency_per_mm < 0, 1.0, -1.0)
    path = np.tensordot(wavefront.waves, tables[: len(wavefront.noll)], 1)
    rule = _gauss(nodes_for(wavefront))
    size = max(1, BLOCK // rule[0].size ** 2)
    blocks = [slice(k, k + size) for k in range(0, len(apart), size)]
    parts = [
        _autocorrelation(apart[b], radians[b], path, tables, rule, with_slopes)
        for b in blocks
    ]
    values, slopes = (
        zip(*parts, strict=True) if parts else ([np.zeros(0)], [np.zeros((len(tables), 0))])
    )
    return np.concatenate(values), np.concatenate(slopes, axis=1)


def _autocorrelation(
    apart: Floats,
    radians: Floats,
    path: Floats,
    tables: Floats,
    rule: tuple[Floats, Floats],
    with_slopes: bool,
) -> tuple[Complexes, Complexes]:
    """Return (f,) the integral of exp(i radians * difference of path) over the overlap, and (tables, f) its
    derivatives or zeros.

    Paths are polynomials in x, the coefficient of each power one in y; so are their
    differences between the two copies. The sums over the nodes are then moments of the
    powers: products of real matrices.
    """
    node, weight = rule
    top = np.arccos(apart / 2)[:, None]
    beta = top * node
    y = np.sin(beta)
    half = np.cos(beta) - apart[:, None] / 2
    degree = len(path) - 1
    in_y = y ** np.arange(degree + 1)[:, None, None]  # (q, f, beta)
    of_x = np.moveaxis(np.tensordot(path, in_y, 1), 0, 2)  # (f, beta, p)
    apart_by = _differences(degree, apart / 2)  # (f, p, k)
    power = np.arange(apart_by.shape[2])
    scale = half[:, :, None] ** power  # (f, beta, k): x is half a width times a node
    by_x = node[:, None] ** power  # (x, k)
    difference = (radians[:, None, None] * scale * (of_x @ apart_by)) @ by_x.T
    weighed = weight[:, None] * (by_x if with_slopes else by_x[:, :1])
    area = (top * weight * np.cos(beta) * half / np.pi)[:, :, None]
    cosine, sine = _cosine_and_sine(difference)
    moments = (
        area * scale[:, :, : weighed.shape[1]] * (cosine @ weighed + 1j * (sine @ weighed))
    )  # (f, beta, k)
    if not with_slopes:
        return moments[:, :, 0].sum(axis=1), np.zeros((len(tables), len(apart)), complex)
    by_power = np.swapaxes(in_y, 0, 1) @ moments @ np.swapaxes(apart_by, 1, 2)  # (f, q, p)
    slopes: Complexes = np.asarray(
        1j * radians * np.tensordot(tables, by_power, ((2, 1), (1, 2))), complex
    )
    return moments[:, :, 0].sum(axis=1), slopes


def _cosine_and_sine(angle: Floats) -> tuple[Floats, Floats]:
    """Return cosine and sine of angles in radians, right to 1e-13.

    A table and Taylor's series take half the time of NumPy's two functions.
    """
    part = np.rint(angle * (TURNS / (2 * np.pi)))
    at = part.astype(np.int64) & (TURNS - 1)
    left = angle - part * (2 * np.pi / TURNS)
    square = left * left
    cosine = 1 - square * (0.5 - square / 24)
    sine = left * (1 - square / 6)
    here = COSINES[at]
    beside = SINES[at]
    return here * cosine - beside * sine, beside * cosine + here * sine


def _differences(degree: int, by: Floats) -> Floats:
    """Return (f, degree + 1, k) coefficients of (x + by)^p - (x - by)^p in powers of x."""
    p, k = np.meshgrid(np.arange(degree + 1), np.arange(max(degree, 1)), indexing="ij")
    odd = np.where((p - k) % 2 == 1, 2 * comb(p, k), 0.0)
    return np.asarray(odd * by[:, None, None] ** np.maximum(p - k, 0))


@lru_cache(maxsize=64)
def _tables(noll: tuple[int, ...], turn: float, slope: bool = False) -> Floats:
    """Return (modes, d + 1, d + 1) modes, or their slopes, as polynomials in coordinates with x along an
    azimuth.

    turn: azimuth, radians; slope: whether to return the derivatives by the azimuth
    """
    orders = [noll_to_nm(j) for j in noll]
    degree = max((n for n, _ in orders), default=0)
    tables = np.zeros((len(noll), degree + 1, degree + 1))
    for table, (n, m) in zip(tables, orders, strict=True):
        cosine = np.cos(m * turn)
        sine = np.sin(m * turn)
        same, other = (-m * sine, m * cosine) if slope else (cosine, sine)
        table[: n + 1, : n + 1] = same * cartesian(nm_to_noll(n, m))
        if m:
            table[: n + 1, : n + 1] -= other * cartesian(nm_to_noll(n, -m))
    tables.flags.writeable = False
    return tables


@lru_cache(maxsize=64)
def _gauss(count: int) -> tuple[Floats, Floats]:
    """Return nodes and weights, (count,) each, on -1 to 1."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight


@lru_cache(maxsize=16)
def _slopes_of(noll: tuple[int, ...]) -> Floats:
    """Return (2, modes, samples) slopes of the modes, along each axis, at samples of the pupil."""
    rho, theta = np.meshgrid(
        np.linspace(0, 1, 9), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    )
    x, y = (rho * np.cos(theta)).ravel(), (rho * np.sin(theta)).ravel()
    tables = _tables(noll, 0.0)
    return np.array(
        [
            [polynomial.polyval2d(x, y, polynomial.polyder(t, axis=axis)) for t in tables]
            for axis in (0, 1)
        ]
    )


def nodes_for(wavefront: FittedWavefront) -> int:
    """Return the nodes along each side that integrate exp(i phase) over the pupil to about 1e-7, as tested."""
    return 16 + int(np.ceil(0.35 * steepness(wavefront)))


def steepness(wavefront: FittedWavefront) -> float:
    """Return the greatest sampled slope of the phase at the shortest wavelength, radians per pupil radius."""
    slopes = np.tensordot(wavefront.waves, _slopes_of(wavefront.noll), (0, 1))
    return float(
        wavefront.radians_per_wave / min(wavefront.spectrum.nodes) * np.hypot(*slopes).max()
    )
