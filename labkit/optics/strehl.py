"""The Strehl ratio of a fitted wavefront: how high its image of a point rises beside a perfect lens's."""

import numpy as np

from labkit.optics.mtf import steepness
from labkit.optics.psf import Pupil
from labkit.optics.wavefront import FittedWavefront, modes_at
from labkit.types import Complexes, Floats
from labkit.uncertain import Uncertain

TILTS = (2, 3)
FLAT = 0.01  # of a perfect peak's curvature: along directions flatter than that a peak has no place
STEPS = 30


def strehl(wavefront: FittedWavefront) -> Uncertain:
    """The PSF's maximum over that of the same pupil without aberration.

    Maximum over all places of the image, wherever tip and tilt put it: they belong to the target's pose, and are left out if
    given. Born and Wolf, Principles of Optics, 7th ed., §9.1.3; V. N. Mahajan, J. Opt. Soc. Am. 73, 860 (1983).

    The standard error is the root of the mean squared departure to second order, for normal errors C of the coefficients
    with gradient g and Hessian H: g'Cg + tr(HCHC)/2 + tr(HC)^2/4. For a nearly perfect lens g vanishes and the rest remains;
    its last term is the square of a bias, as errors of the modes only lower the ratio.
    """
    rest = wavefront.without(TILTS)
    if not rest.noll:
        return Uncertain(1.0, 0.0)
    free = len(TILTS)
    waves = np.concatenate([_brightest_tilts(rest), rest.waves])
    weights, modes = _over_pupil((*TILTS, *rest.noll), waves, rest)
    curvature = 2 * rest.radians_per_wave**2
    for _ in range(STEPS):
        value, slope, bend = _peak(waves, weights, modes, rest.radians_per_wave)
        values, axes = np.linalg.eigh(bend[:free, :free])
        step = axes @ ((axes.T @ slope[:free]) / np.maximum(np.abs(values), FLAT * curvature))
        waves[:free] += step
        if np.abs(step).max() < 1e-9:
            break
    fixed = values < -FLAT * curvature * value
    moved = axes[:, fixed].T @ bend[:free, free:]
    hessian = bend[free:, free:] - moved.T @ (moved / values[fixed][:, None])
    return Uncertain(value, np.sqrt(_mean_square(rest, slope[free:], hessian)))


def _mean_square(wavefront: FittedWavefront, slope: Floats, hessian: Floats) -> float:
    first = float(wavefront.variance(slope))
    if not np.isfinite(wavefront.covariance).all():
        return first
    product = hessian @ wavefront.covariance
    return first + float(np.sum(product * product.T)) / 2 + float(np.trace(product)) ** 2 / 4


def _peak(waves: Floats, weights: Floats, modes: Floats, factor: float) -> tuple[float, Floats, Floats]:
    """|mean of exp(i phase)|^2 with its gradient (modes,) and Hessian (modes, modes) by the waves."""
    field: Complexes = weights * np.exp(1j * factor * (waves @ modes))
    total, by_mode = field.sum(), 1j * factor * (modes @ field)
    by_two = -(factor**2) * ((modes * field) @ modes.T)
    slope = 2 * (np.conj(total) * by_mode).real
    bend = 2 * (np.outer(np.conj(by_mode), by_mode) + np.conj(total) * by_two).real
    return float(np.abs(total) ** 2), slope, bend


def _over_pupil(noll: tuple[int, ...], waves: Floats, wavefront: FittedWavefront) -> tuple[Floats, Floats]:
    """(points,) weights, with sum 1, of a quadrature over the pupil that resolves a wavefront; (modes, points) the modes."""
    tilt = wavefront.radians_per_wave * 2 * float(np.linalg.norm(waves[: len(TILTS)]))
    steep = steepness(wavefront) + tilt
    node, weight = np.polynomial.legendre.leggauss(16 + int(np.ceil(0.35 * steep)))
    angles = 48 + 2 * int(np.ceil(0.7 * steep))
    rho, theta = np.meshgrid((node + 1) / 2, 2 * np.pi * np.arange(angles) / angles, indexing="ij")
    weights = np.broadcast_to((weight * (node + 1) / 2 / angles)[:, None], rho.shape).ravel()
    return weights, modes_at(noll, (rho * np.cos(theta)).ravel(), (rho * np.sin(theta)).ravel())


def _brightest_tilts(wavefront: FittedWavefront) -> Floats:
    """The tilts, waves RMS of Noll 2 and 3, that bring the brightest of samples an eighth of lambda N apart to the centre.

    The true peak of each is at most 2 % higher: of two peaks as equal as that, the lower may be taken.
    """
    w, airy_um = wavefront, wavefront.wavelength_um * wavefront.f_number
    size = 128 + 16 * int(np.ceil(steepness(w) / np.pi))  # a slope of pi throws light lambda N away
    psf = Pupil(w.wavelength_um, w.reference_um, w.f_number, airy_um / 8, size, w.noll).psf(w.waves)
    row, column = np.unravel_index(psf.argmax(), psf.shape)
    away_airy = np.array([column - size // 2, row - size // 2]) / 8
    # one wave RMS of tilt is four waves across the pupil, which throw light 4 lambda N away
    return np.asarray(-away_airy / 4 * w.wavelength_um / w.reference_um)
