"""The Strehl ratio of a fitted wavefront: how high its image of a point rises beside a perfect lens's."""

from dataclasses import dataclass

import numpy as np

from labkit.optics.known_bias import in_any_light
from labkit.optics.mtf import steepness
from labkit.optics.psf import Pupil
from labkit.optics.rim import Rim
from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import modes_at
from labkit.types import Complexes, Floats
from labkit.uncertain import Uncertain

TILTS = (2, 3)
FLAT = 0.01  # of a perfect peak's curvature: along directions flatter than that a peak has no place
MOST_CLIMB_STEPS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Peak:
    """A maximum of a PSF: its height over a perfect lens's, and the tilts (2,), waves RMS, that centre the
    maximum.

    slope: (modes,) of the height by the coefficients; hessian: (modes, modes), with the
    maximum's place following.
    """

    value: float
    tilts: Floats
    slope: Floats
    hessian: Floats


@in_any_light
def strehl(wavefront: FittedWavefront) -> Uncertain:
    """Return the PSF's maximum over the maximum of the same pupil without aberration.

    The maximum is over all places of the image, wherever tip and tilt move the light: both
    belong to the target's pose and are ignored. In light of several wavelengths both maxima
    are of all the light. Born and Wolf, Principles of Optics, 7th ed., §9.1.3; V. N.
    Mahajan, J. Opt. Soc. Am. 73, 860 (1983).

    The standard error is the root of the mean squared departure to second order, for normal
    errors C of the coefficients with gradient g and Hessian H: g'Cg + tr(HCHC)/2 +
    tr(HC)^2/4. For a nearly perfect lens g vanishes and the rest remains; its last term is
    the square of a bias, because errors of the modes only lower the ratio.
    """
    rest = wavefront.without(TILTS)
    if not rest.noll:
        return Uncertain(1.0, 0.0)
    tilts = brightest_tilts(rest)
    found = Climber(rest, float(np.linalg.norm(tilts))).peak(rest.waves, tilts)
    return Uncertain(found.value, np.sqrt(mean_square(rest, found)))


class Climber:
    """Climbs to the maximum of the PSFs of a wavefront's modes, from nearby tilts.

    wavefront: without tilts, as steep as any wavefront to climb on; most_tilt: waves RMS,
    largest tilt
    """

    def __init__(self, wavefront: FittedWavefront, most_tilt: float = 0.0) -> None:
        heights = [
            (share / light.wavelength_um**2, light.radians_per_wave)
            for share, light in wavefront.lights
        ]
        whole = sum(height for height, _ in heights)
        self._lights = [(height / whole, factor) for height, factor in heights]
        steep = steepness(wavefront) + 2 * most_tilt * max(
            factor for _, factor in self._lights
        )
        self._weights, self._modes = _over_pupil(
            (*TILTS, *wavefront.noll), steep, wavefront.rim
        )

    def peak(self, waves: Floats, tilts: Floats) -> Peak:
        """Return the maximum for coefficients (modes,), from tilts (2,), waves RMS."""
        free = len(TILTS)
        at = np.concatenate([tilts, waves])
        curvature = 2 * sum(share * factor**2 for share, factor in self._lights)
        path = waves @ self._modes[free:]
        for _ in range(
            MOST_CLIMB_STEPS
        ):  # the other modes' derivatives are wanted at its end alone
            _, slope, bend = self._height(at[:free], self._modes[:free], path)
            values, axes = np.linalg.eigh(bend)
            step = axes @ ((axes.T @ slope) / np.maximum(np.abs(values), FLAT * curvature))
            at[:free] += step
            if np.abs(step).max() < 1e-9:
                break
        value, slope, bend = self._height(at, self._modes)
        values, axes = np.linalg.eigh(bend[:free, :free])
        fixed = values < -FLAT * curvature * value
        moved = axes[:, fixed].T @ bend[:free, free:]
        hessian = bend[free:, free:] - moved.T @ (moved / values[fixed][:, None])
        return Peak(value, at[:free], slope[free:], hessian)

    def _height(
        self, waves: Floats, modes: Floats, path: Floats | float = 0.0
    ) -> tuple[float, Floats, Floats]:
        """Return the PSF at its centre over a perfect lens's, as of `_peak`, over all wavelengths."""
        value = 0.0
        slope = np.zeros(len(waves))
        bend = np.zeros((len(waves), len(waves)))
        for share, factor in self._lights:
            of_light = _peak(waves, self._weights, modes, factor, path)
            value += share * of_light[0]
            slope += share * of_light[1]
            bend += share * of_light[2]
        return value, slope, bend


def mean_square(wavefront: FittedWavefront, peak: Peak) -> float:
    """Return the mean squared departure of a peak's height, as `strehl` defines it."""
    first = float(wavefront.variance(peak.slope))
    if not np.isfinite(wavefront.covariance).all():
        return first
    product = peak.hessian @ wavefront.covariance
    return (
        first + float(np.sum(product * product.T)) / 2 + float(np.trace(product)) ** 2 / 4
    )


def _peak(
    waves: Floats, weights: Floats, modes: Floats, factor: float, path: Floats | float = 0.0
) -> tuple[float, Floats, Floats]:
    """Return |mean of exp(i phase)|^2 with its gradient (modes,) and Hessian (modes, modes) by the waves.

    path: of other modes
    """
    field: Complexes = weights * np.exp(1j * factor * (waves @ modes + path))
    total = field.sum()
    by_mode = 1j * factor * (modes @ field)
    by_two = -(factor**2) * ((modes * field) @ modes.T)
    slope = 2 * (np.conj(total) * by_mode).real
    bend = 2 * (np.outer(np.conj(by_mode), by_mode) + np.conj(total) * by_two).real
    return float(np.abs(total) ** 2), slope, bend


def _over_pupil(noll: tuple[int, ...], steep: float, rim: Rim) -> tuple[Floats, Floats]:
    """Return (points,) weights of unit sum and (modes, points) modes, for a quadrature fine enough for a
    steepness.
    """
    if not rim.is_round:
        steep *= rim.longest
        x, y, weights = rim.quadrature(
            16 + int(np.ceil(0.35 * steep)), 48 + 2 * int(np.ceil(0.7 * steep))
        )
        return weights, modes_at(noll, x, y)
    node, weight = np.polynomial.legendre.leggauss(16 + int(np.ceil(0.35 * steep)))
    angles = 48 + 2 * int(np.ceil(0.7 * steep))
    rho, theta = np.meshgrid(
        (node + 1) / 2, 2 * np.pi * np.arange(angles) / angles, indexing="ij"
    )
    weights = np.broadcast_to(
        (weight * (node + 1) / 2 / angles)[:, None], rho.shape
    ).ravel()
    return weights, modes_at(
        noll, (rho * np.cos(theta)).ravel(), (rho * np.sin(theta)).ravel()
    )


def brightest_tilts(wavefront: FittedWavefront) -> Floats:
    """Return the tilts, waves RMS of Noll 2 and 3, that centre the brightest of samples lambda N / 8 apart.

    The true peak of each is at most 2 % higher: of two peaks closer than this, the lower
    may be chosen.
    """
    w = wavefront
    airy_um = 1e3 / wavefront.cutoff_per_mm
    size = 128 + 16 * int(
        np.ceil(steepness(w) / np.pi)
    )  # a slope of pi throws light lambda N away
    psf = np.zeros((size, size))
    for share, light in w.lights:
        psf += share * Pupil(
            light.wavelength_um,
            w.reference_um,
            w.f_number,
            airy_um / 8,
            size,
            w.noll,
            w.rim,
        ).psf(w.waves)
    row, column = np.unravel_index(psf.argmax(), psf.shape)
    away_um = np.array([column - size // 2, row - size // 2]) * airy_um / 8
    # one wave RMS of tilt is four waves across the pupil, which throw light 4 lambda N away
    return np.asarray(-away_um / (4 * w.f_number * w.reference_um))
