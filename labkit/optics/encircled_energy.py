"""Energy within circles about a point image, including the halo however far it reaches.

By Parseval's theorem the share within r is the integral of the transfer function against
the transform of a disc, which ends at the cutoff frequency: E(r) = 2 pi r * integral of
T(f) J1(2 pi r f) df, T the transfer function averaged over directions. No window cuts off
the tails. A perfect lens has Rayleigh's 1 - J0^2 - J1^2; Born and Wolf, Principles of
Optics, 7th ed., §8.5.2.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import j0, j1

from labkit.arrays import real_array
from labkit.optics.known_bias import in_any_light
from labkit.optics.mtf import steepness, transfer_function
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import modes_at, noll_to_nm
from labkit.types import Floats
from labkit.uncertain import Uncertain

RADIUS_STEP = 1e-5  # of the pupil's radius, in differences
MOST_ENERGY = 0.99  # share of the energy that a radius is computed for; beyond, 0.2 lambda N / r of the light is the halo's


@dataclass(frozen=True, slots=True, eq=False)
class EncircledEnergy:
    """Shares of all energy within radii, with standard errors, arrays of one shape. radius_um: on the sensor."""

    radius_um: Floats
    value: Floats
    std: Floats


@dataclass(frozen=True)
class _Mean:
    """The transfer function averaged over directions at frequencies, 1/um, with weights of a quadrature; (modes, f) slopes."""

    frequency: Floats
    weight: Floats
    value: Floats
    slopes: Floats

    def energy(self, radius_um: Floats) -> tuple[Floats, Floats]:
        """Return (r,) shares within radii, and (modes, r) their derivatives."""
        argument = 2 * np.pi * np.outer(self.frequency, radius_um)
        kernel = j1(argument) * self.weight[:, None] * 2 * np.pi * radius_um
        return self.value @ kernel, self.slopes @ kernel

    def density(self, radius_um: Floats) -> Floats:
        """Return (r,) energy per um of radius."""
        kernel = (self.frequency * self.weight)[:, None] * j0(
            2 * np.pi * np.outer(self.frequency, radius_um)
        )
        return np.asarray((2 * np.pi) ** 2 * radius_um * (self.value @ kernel))


@in_any_light
def encircled_energy(wavefront: FittedWavefront, radius_um: ArrayLike) -> EncircledEnergy:
    """Return the share of all energy within circles about the PSF's centroid, at radii of any shape.

    Raises ValueError for radii below 0.
    """
    radius = real_array("radius_um", radius_um, None, "um")
    if np.any(radius < 0):
        raise ValueError(f"radius_um, shape {radius.shape}: radii are 0 or more (um)")
    centred = about_centroid(wavefront)
    mean = _mean_transfer(centred, float(radius.max(initial=0.0)))
    value, slopes = mean.energy(radius.ravel())
    by_scale = centred.scale_relative_std * radius.ravel() * mean.density(radius.ravel())
    std = np.hypot(np.sqrt(centred.variance(slopes)), by_scale)
    return EncircledEnergy(radius, value.reshape(radius.shape), std.reshape(radius.shape))


@in_any_light
def radius_of_energy(wavefront: FittedWavefront, share: float) -> Uncertain:
    """Return the radius, um, of the circle about the PSF's centroid with a share of the energy.

    Raises ValueError for a share that is not between 0 and 0.99: the last hundredth is in
    the diffraction halo, which any dust changes.
    """
    if not 0 < share <= MOST_ENERGY:
        raise ValueError(
            f"share = {share:g}: above 0 and at most {MOST_ENERGY:g} of the energy is possible"
        )
    centred = about_centroid(wavefront)
    limit = max(2.0, 0.3 / (1 - share)) * wavefront.wavelength_um * wavefront.f_number
    mean = _mean_transfer(centred, limit)
    while mean.energy(np.array([limit]))[0][0] < share:
        limit *= 2
        mean = _mean_transfer(centred, limit)
    radius = brentq(
        lambda r: mean.energy(np.array([r]))[0][0] - share, 0.0, limit, xtol=1e-10 * limit
    )
    gradient = mean.energy(np.array([radius]))[1][:, 0]
    std = float(np.sqrt(centred.variance(gradient))) / abs(
        float(mean.density(np.array([radius]))[0])
    )
    return Uncertain(radius, np.hypot(std, centred.scale_relative_std * radius), "um")


def about_centroid(wavefront: FittedWavefront) -> FittedWavefront:
    """Return the wavefront with the tilts that move its PSF's centroid to the centre, whatever tilts it had.

    The centroid is the mean slope of the path over the pupil. By Gauss's theorem this is
    the mean over the rim times the outward normal: each mode of azimuthal order 1 counts
    with its value on the rim.
    """
    rest = wavefront.without((2, 3))
    matrix = np.vstack([np.zeros((2, len(rest.noll))), np.eye(len(rest.noll))])
    if not rest.rim.is_round:
        matrix[:2] = -0.5 * _mean_slopes(rest)  # slopes of Noll 2 and 3 are 2
        return rest.mapped((2, 3, *rest.noll), matrix)
    for k, (n, m) in enumerate(noll_to_nm(j) for j in rest.noll):
        if abs(m) == 1:
            matrix[0 if m > 0 else 1, k] = (
                -sqrt(2 * (n + 1)) / 2
            )  # Noll 2 and 3 are 2 on the rim
    return rest.mapped((2, 3, *rest.noll), matrix)


def _mean_slopes(wavefront: FittedWavefront) -> Floats:
    """Return (2, modes) mean slopes of the modes along x and y over a pupil that is no disc."""
    x, y, weights = wavefront.rim.quadrature(24, 96)
    steps = ((RADIUS_STEP, 0.0), (0.0, RADIUS_STEP))
    return np.array(
        [
            (
                modes_at(wavefront.noll, x + dx, y + dy)
                - modes_at(wavefront.noll, x - dx, y - dy)
            )
            @ weights
            / (2 * RADIUS_STEP)
            for dx, dy in steps
        ]
    )


def _mean_transfer(wavefront: FittedWavefront, radius_um: float) -> _Mean:
    """Return the mean over directions at frequencies dense enough for a radius, one wavelength after another."""
    shares, lights = zip(*wavefront.lights, strict=True)
    directions = 12 + int(np.ceil(0.5 * steepness(wavefront)))
    means = [_mean_in_one_light(light, radius_um, directions) for light in lights]
    return _Mean(
        np.concatenate([mean.frequency for mean in means]),
        np.concatenate(
            [share * mean.weight for share, mean in zip(shares, means, strict=True)]
        ),
        np.concatenate([mean.value for mean in means]),
        np.concatenate([mean.slopes for mean in means], axis=1),
    )


def _mean_in_one_light(
    wavefront: FittedWavefront, radius_um: float, directions: int
) -> _Mean:
    cutoff = wavefront.cutoff_per_mm * 1e-3
    steep = steepness(wavefront)
    turns = 2 * np.pi * radius_um * cutoff
    node, weight = np.polynomial.legendre.leggauss(
        24 + int(np.ceil(0.5 * turns + 0.35 * steep))
    )
    angle = (
        np.pi / 4 * (node + 1)
    )  # f = cutoff cos(angle), with which the transfer function is smooth to its end
    frequency = cutoff * np.cos(angle)
    parts = [
        transfer_function(
            wavefront, 1e3 * frequency, k * 180 / directions, not wavefront.exact
        )
        for k in range(directions)
    ]
    value = np.mean([transfer.real for transfer, _ in parts], axis=0)
    slopes = np.mean([by_mode.real for _, by_mode in parts], axis=0)
    return _Mean(frequency, weight * np.pi / 4 * cutoff * np.sin(angle), value, slopes)
