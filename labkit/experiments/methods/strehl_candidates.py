"""Candidates for another start of the search: perturbations of a wavefront that change its PSF least, thesis
(4.39).

Of all perturbations of one RMS, a shell, they have the highest Strehl ratio. They do not
depend on the perturbed wavefront: `benchmarks/make_strehl_candidates.py` computes them
once, and the package holds its result.
"""

from functools import cache
from importlib import resources

import numpy as np
from scipy.optimize import minimize

from labkit.arrays import positive, real_array
from labkit.optics.zernike import noll_to_nm, twin_signs, zernike
from labkit.types import Floats

CANDIDATE_NOLL = tuple(range(4, 16))
QUADRATURE_RADII, QUADRATURE_ANGLES = (
    16,
    48,
)  # of the quadrature over the disc: exact for polynomials far above the degree of these modes
ROTATIONS = 8  # of each perturbation, evenly spaced
ALIKE_ROTATIONS = 180  # that a comparison of two wavefronts tries: 2 degrees apart


@cache
def _quadrature() -> tuple[Floats, Floats]:
    """Return (samples,) weights over the disc, of unit sum, and (modes, samples) modes there."""
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_RADII)
    angles = 2 * np.pi * np.arange(QUADRATURE_ANGLES) / QUADRATURE_ANGLES
    rho, theta = np.meshgrid(np.sqrt((nodes + 1) / 2), angles, indexing="ij")
    share = np.repeat(weights / 2 / QUADRATURE_ANGLES, QUADRATURE_ANGLES)
    return share, np.stack([zernike(j, rho, theta).ravel() for j in CANDIDATE_NOLL])


def _over_noll(name: str, waves: Floats) -> Floats:
    return real_array(name, waves, (len(CANDIDATE_NOLL),), "waves RMS of Noll 4 to 15")


def rotated(waves: Floats, angle_rad: float) -> Floats:
    """Rotate a wavefront (12,), waves RMS over Noll 4 to 15, about the axis."""
    waves = _over_noll("waves", waves)
    result = waves.copy()
    for k, j in enumerate(CANDIDATE_NOLL):
        n, m = noll_to_nm(j)
        if m > 0:
            sine = next(i for i, q in enumerate(CANDIDATE_NOLL) if noll_to_nm(q) == (n, -m))
            c = np.cos(m * angle_rad)
            s = np.sin(m * angle_rad)
            result[k] = waves[k] * c - waves[sine] * s
            result[sine] = waves[k] * s + waves[sine] * c
    return result


def strehl(waves: Floats) -> tuple[float, Floats]:
    """Return the Strehl ratio of a wavefront (12,), waves RMS over Noll 4 to 15, and its gradient (12,) per
    wave.
    """
    waves = _over_noll("waves", waves)
    weights, modes = _quadrature()
    field = weights * np.exp(2j * np.pi * (waves @ modes))
    total = field.sum()
    gradient = 2 * (np.conj(total) * (modes @ field) * 2j * np.pi).real
    return float(np.abs(total) ** 2), np.asarray(gradient)


def highest_on_shell(start: Floats, rms: float) -> Floats:
    """Return a local maximum of the Strehl ratio among wavefronts of one RMS.

    Parameters
    ----------
    start : (12,), a direction, not zero
    rms : of the shell, waves

    Returns
    -------
    (12,), waves RMS over Noll 4 to 15

    Raises
    ------
    ValueError
        for a start of another shape, not finite or zero, and for an RMS that is not
        positive
    """
    start = _over_noll("start", start)
    positive("rms", rms, "waves")
    positive("length of start", float(np.linalg.norm(start)), "waves RMS")

    def lowered(direction: Floats) -> tuple[float, Floats]:
        length = np.linalg.norm(direction)
        place = direction * (rms / length)
        value, slope = strehl(place)
        tangent = slope - (slope @ place) / rms**2 * place
        return -value / rms**4, -tangent * (
            rms / length
        ) / rms**4  # on a shell Strehl ratios differ by about rms^4

    first = start / np.linalg.norm(start)
    end = minimize(
        lowered, first, jac=True, method="L-BFGS-B", options={"gtol": 1e-7, "ftol": 1e-14}
    )
    return np.asarray(end.x * (rms / np.linalg.norm(end.x)))


def _associates(waves: Floats) -> Floats:
    """Return (4, ..., 12) wavefronts (..., 12), their negatives, twins and twins' negatives."""
    twin = waves * twin_signs(CANDIDATE_NOLL)
    return np.stack([waves, -waves, twin, -twin])


def is_trivial(waves: Floats, other: Floats, tolerance: float) -> bool:
    """Return whether a wavefront is a trivial associate of another: its negative or twin, at any rotation.

    Parameters
    ----------
    waves, other : (12,), waves RMS over Noll 4 to 15
    tolerance : on their distance, waves RMS

    Raises
    ------
    ValueError
        for other shapes, or not finite
    """
    waves = _over_noll("waves", waves)
    other = _over_noll("other", other)
    angles = 2 * np.pi * np.arange(ALIKE_ROTATIONS) / ALIKE_ROTATIONS
    alike = [
        rotated(associate, angle) for associate in _associates(other) for angle in angles
    ]
    return bool(np.min(np.linalg.norm(waves - np.array(alike), axis=1)) < tolerance)


@cache
def shipped_perturbations() -> tuple[Floats, Floats]:
    """Return (n,) RMS of the shells, waves, and (n, 12) perturbations, none a trivial associate of another."""
    folder = resources.files("labkit.experiments.methods")
    with resources.as_file(folder / "strehl_candidates.npz") as path, np.load(path) as data:
        return data["rms"].astype(float), data["waves"].astype(float)


def strehl_candidates(waves: Floats, rms: float = 0.2) -> Floats:
    """Perturb a wavefront by the perturbations of highest Strehl ratio, their trivial associates and rotations.

    Parameters
    ----------
    waves : (12,), waves RMS over Noll 4 to 15
    rms : of the perturbations, waves; the nearest shell is taken

    Returns
    -------
    (m, 12), starts for the search

    Raises
    ------
    ValueError
        for a wavefront of another shape, or not finite
    """
    waves = _over_noll("waves", waves)
    positive("rms", rms, "waves")
    shells, perturbations = shipped_perturbations()
    nearest = perturbations[shells == shells[np.argmin(np.abs(shells - rms))]]
    angles = 2 * np.pi * np.arange(ROTATIONS) / ROTATIONS
    turned = [
        rotated(p, angle)
        for p in _associates(nearest).reshape(-1, len(CANDIDATE_NOLL))
        for angle in angles
    ]
    return np.asarray(waves + np.unique(np.round(turned, 9), axis=0))
