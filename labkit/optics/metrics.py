"""Metrics of a lens test from a fitted wavefront, each with its standard error by the delta method.

Angles run from x (right, along the sensor's rows) towards y (down its columns), like the
pupil's. Path differences are in waves at the reference wavelength.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter

from labkit.arrays import positive
from labkit.optics.known_bias import error_with_bias
from labkit.optics.psf import Pupil
from labkit.optics.rim import Rim
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import modes_at, nm_to_noll, noll_to_nm
from labkit.types import Bools, Floats
from labkit.uncertain import Uncertain

PUPIL_SAMPLES = (
    240  # across; the PSF of a pupil of samples repeats itself after so many lambda N
)
F_NUMBER_STEP = 1e-4  # relative, of a PSF's derivative by the f-number
HALF_WIDTH_AIRY = 32.0  # of a PSF's usual window: 0.6 % of the light lies beyond
RIM_ANGLES, SAMPLED_RADII = (
    512,
    129,
)  # where a wavefront's extremes are looked for: they are known to 1e-3 of themselves


@dataclass(frozen=True, slots=True, eq=False)
class Psf:
    """A sampled PSF, (n, n), n odd, unit sum, its centre at [n // 2, n // 2], rows down and columns right; std: its errors."""

    spacing_um: float
    value: Floats
    std: Floats


@dataclass(frozen=True, slots=True, eq=False)
class OpdMap:
    """Path difference over the pupil, (n, n) waves at the reference wavelength, nan outside; std: its errors."""

    value: Floats
    std: Floats


@dataclass(frozen=True, slots=True)
class Directed:
    """A pair of modes as magnitude, waves RMS, and the angle of the greatest path difference, degrees."""

    magnitude: Uncertain
    angle_deg: Uncertain


def psf(wavefront: FittedWavefront, spacing_um: float, size: int | None = None) -> Psf:
    """Return the PSF of the optics alone on a grid, with standard errors that include that of lambda N.

    Arguments and errors raised as of `psf_value`.
    """
    value, slopes = _psf_at(wavefront, spacing_um, size, slice(None))
    total = value.sum()
    slopes -= value / total * slopes.sum(axis=(1, 2), keepdims=True)
    std = np.sqrt(wavefront.variance(slopes)) / total
    value = value / total
    if wavefront.scale_relative_std:
        slower = replace(wavefront, f_number=wavefront.f_number * (1 + F_NUMBER_STEP))
        by_scale = (psf_value(slower, spacing_um, len(value)) - value) / F_NUMBER_STEP
        std = np.hypot(std, wavefront.scale_relative_std * by_scale)
    changes = [
        _by_light(wavefront, light, spacing_um, value)
        for light in wavefront.in_possible_lights
    ]
    if changes:
        std = error_with_bias(std, np.max(changes, axis=0))
    return Psf(spacing_um, value, std)


def _by_light(
    wavefront: FittedWavefront, light: FittedWavefront, spacing_um: float, value: Floats
) -> Floats:
    """Return the change (n, n) of a PSF in other light, the RMS over squares of an Airy disc's diameter.

    The spectrum's form is unknown too, and moves the rings between which the change is 0.
    """
    change = psf_value(light, spacing_um, len(value)) - value
    across = 2.44 * wavefront.wavelength_um * wavefront.f_number / spacing_um
    return np.asarray(np.sqrt(uniform_filter(change**2, max(1, round(across)))))


def psf_value(
    wavefront: FittedWavefront, spacing_um: float, size: int | None = None
) -> Floats:
    """Return the (size, size) PSF of the optics alone in all of its light, unit sum, its centre in the middle.

    size: samples along a side, odd; by default the window reaches 32 lambda N from the
    centre. Raises ValueError for an even size, and for a spacing above lambda N, at which
    the samples' sum would depend on their position.
    """
    value, _ = _psf_at(wavefront, spacing_um, size, slice(0))
    return np.asarray(value / value.sum())


def psf_difference(wavefront: FittedWavefront, other: FittedWavefront) -> float:
    """Return the summed absolute difference of two PSFs of unit sum at the same points of the sensor."""
    spacing_um = min(w.wavelength_um * w.f_number for w in (wavefront, other)) / 2
    size = 4 * int(HALF_WIDTH_AIRY) + 1
    return float(
        np.abs(
            psf_value(wavefront, spacing_um, size) - psf_value(other, spacing_um, size)
        ).sum()
    )


def _psf_at(
    wavefront: FittedWavefront, spacing_um: float, size: int | None, modes: slice
) -> tuple[Floats, Floats]:
    """Return the PSF on the grid, in any scale, and its derivatives by some modes, for a finely sampled pupil."""
    airy_um = wavefront.wavelength_um * wavefront.f_number
    if not positive("spacing_um", spacing_um, "um") <= airy_um:
        raise ValueError(
            f"spacing_um = {spacing_um:g}: at most lambda N is needed, here {airy_um:g} um"
        )
    half = (
        int(np.ceil(HALF_WIDTH_AIRY * airy_um / spacing_um)) if size is None else size // 2
    )
    if size is not None and (size < 1 or size % 2 == 0):
        raise ValueError(
            f"size = {size}: an odd number of samples is needed, so that one is the centre"
        )
    apart_um = max(PUPIL_SAMPLES * airy_um, 4 * half * spacing_um)
    # in all lights alike: PSFs are shares of light on such samples
    fine_um = airy_um / (2 * wavefront.rim.reach) * min(wavefront.spectrum.nodes)
    across = int(np.ceil(apart_um / fine_um))
    at_um = spacing_um * np.arange(-half, half + 1.0)
    value: Floats = np.zeros((at_um.size, at_um.size))
    slopes: Floats = np.zeros((len(wavefront.noll[modes]), at_um.size, at_um.size))
    for share, w in wavefront.lights:
        pupil = Pupil(
            w.wavelength_um, w.reference_um, w.f_number, fine_um, across, w.noll, w.rim
        )
        of_light, its_slopes = pupil.psf_at(w.waves, at_um, modes)
        value += share * of_light
        slopes += share * its_slopes
    return value, slopes


def opd_map(
    wavefront: FittedWavefront, samples: int, without: Collection[int] = ()
) -> OpdMap:
    """Return the path difference at the centres of samples x samples squares over the pupil.

    A disc's edge touches the border of the squares. without: Noll modes to omit. Raises
    ValueError for fewer than one sample.
    """
    if samples < 1:
        raise ValueError(f"samples = {samples}: at least 1 is needed")
    wavefront = wavefront.without(without)
    at = (2 * np.arange(samples) + 1 - samples) / samples * wavefront.rim.longest
    y, x = np.meshgrid(at, at, indexing="ij")
    inside: Bools = wavefront.rim.inside(x, y)
    value = np.full(x.shape, np.nan)
    std = np.full(x.shape, np.nan)
    modes = modes_at(wavefront.noll, x[inside], y[inside])
    value[inside] = wavefront.waves @ modes
    std[inside] = np.sqrt(wavefront.variance(modes))
    return OpdMap(value, std)


def rms(wavefront: FittedWavefront, without: Collection[int] = ()) -> Uncertain:
    """Return the RMS of the path difference about its mean over the clear pupil, with errors as `magnitude`.

    without: Noll modes to omit
    """
    wavefront = wavefront.without({1, *without})
    if wavefront.rim.is_round:
        return magnitude(wavefront)
    x, y, weights = wavefront.rim.quadrature(24, 96)
    modes = modes_at(wavefront.noll, x, y)
    modes -= (modes @ weights)[:, None]
    # the root of the modes' products: with it a sum of squares is that over the pupil
    values, vectors = np.linalg.eigh((modes * weights) @ modes.T)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return magnitude(wavefront.mapped(wavefront.noll, root))


def rms_by_order(wavefront: FittedWavefront) -> dict[int, Uncertain]:
    """Return the RMS of each radial order's modes, waves at the reference wavelength, with errors as
    `magnitude`.
    """
    orders = sorted({noll_to_nm(j)[0] for j in wavefront.noll})
    return {
        order: rms(
            wavefront, without=[j for j in wavefront.noll if noll_to_nm(j)[0] != order]
        )
        for order in orders
    }


def magnitude(wavefront: FittedWavefront) -> Uncertain:
    """Return the root of the sum of the squared coefficients, waves RMS.

    Near zero the root has no derivative and errors only increase it. The standard error
    therefore comes from the square, of which mean and variance are known exactly for normal
    errors: sqrt(r^2 + e) - r at r^2 with an RMS error e. Far from zero, the delta method
    gives the same.
    """
    a = wavefront.waves
    covariance = wavefront.covariance
    value = float(np.linalg.norm(a))
    if not np.isfinite(covariance).all():
        return Uncertain(value, np.sqrt(np.trace(covariance)), "waves")
    error = np.sqrt(
        4 * a @ covariance @ a + 2 * np.sum(covariance**2) + np.trace(covariance) ** 2
    )
    return Uncertain(
        value, error / (np.sqrt(value**2 + error) + value) if error > 0 else 0.0, "waves"
    )


def peak_to_valley(wavefront: FittedWavefront, without: Collection[int] = ()) -> Uncertain:
    """Return the greatest path difference less the least, to 1e-3 of the result, over the pupil with its rim.

    without: Noll modes to omit. The error belongs to the difference between these two
    points.
    """
    wavefront = wavefront.without(without)
    if not wavefront.noll:
        return Uncertain(0.0, 0.0, "waves")
    modes = _all_over(wavefront.noll, wavefront.rim)
    path = wavefront.waves @ modes
    gradient = modes[:, path.argmax()] - modes[:, path.argmin()]
    return Uncertain(np.ptp(path), float(np.sqrt(wavefront.variance(gradient))), "waves")


@lru_cache(maxsize=4)
def _all_over(noll: tuple[int, ...], rim: Rim) -> Floats:
    """Return (modes, points) the modes over the pupil and its rim."""
    rho, theta = np.meshgrid(
        np.linspace(0, 1, SAMPLED_RADII), 2 * np.pi * np.arange(RIM_ANGLES) / RIM_ANGLES
    )
    if not rim.is_round:
        rho = rim.inner + rho * (rim.outline(theta) - rim.inner)
    return modes_at(noll, rho * np.cos(theta), rho * np.sin(theta)).reshape(len(noll), -1)


def astigmatism(wavefront: FittedWavefront) -> Directed:
    """Return primary astigmatism, Noll 5 and 6; its angle within -90 to 90 degrees.

    Raises ValueError if these modes were not fitted.
    """
    return _directed(wavefront, 2, 2)


def coma(wavefront: FittedWavefront) -> Directed:
    """Return primary coma, Noll 7 and 8; its angle within -180 to 180 degrees.

    Raises ValueError if these modes were not fitted.
    """
    return _directed(wavefront, 3, 1)


def trefoil(wavefront: FittedWavefront) -> Directed:
    """Return primary trefoil, Noll 9 and 10; its angle within -60 to 60 degrees.

    Raises ValueError if these modes were not fitted.
    """
    return _directed(wavefront, 3, 3)


def _directed(wavefront: FittedWavefront, n: int, m: int) -> Directed:
    cosine, sine = (wavefront.index(nm_to_noll(n, sign * m)) for sign in (1, -1))
    pair = wavefront.without(
        set(wavefront.noll) - {wavefront.noll[cosine], wavefront.noll[sine]}
    )
    c, s = wavefront.waves[[cosine, sine]]
    square = c**2 + s**2
    unknown = 360 / m / np.sqrt(12)  # of an angle that may be any
    across = np.zeros(len(wavefront.noll))
    across[[cosine, sine]] = -s, c
    std = (
        np.degrees(np.sqrt(wavefront.variance(across)) / square) / m
        if square > 0
        else unknown
    )
    return Directed(
        magnitude(pair),
        Uncertain(np.degrees(np.arctan2(s, c)) / m, min(std, unknown), "deg"),
    )
