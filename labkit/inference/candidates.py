"""Where else an optimum may lie: perturbations of a wavefront that change its PSF least, thesis (4.39).

On every shell of one RMS those are the ones with the highest Strehl ratio. They do not depend on the wavefront that is
perturbed, so they are computed once, by `benchmarks/make_candidates.py`, and shipped.
"""

from functools import cache
from importlib import resources

import numpy as np
from scipy.optimize import minimize

from labkit.arrays import positive, real_array
from labkit.optics.zernike import noll_to_nm, twin_signs, zernike
from labkit.types import Floats

NOLL = tuple(range(4, 16))
RADII, ANGLES = 16, 48  # of the quadrature over the disc: exact for polynomials far beyond those that matter, and round
TURNS = 8  # rotations of each perturbation that are tried


@cache
def _samples() -> tuple[Floats, Floats]:
    """(samples,) weights over the disc, summing to one, and (modes, samples) modes there."""
    nodes, weights = np.polynomial.legendre.leggauss(RADII)
    rho, theta = np.meshgrid(np.sqrt((nodes + 1) / 2), 2 * np.pi * np.arange(ANGLES) / ANGLES, indexing="ij")
    share = np.repeat(weights / 2 / ANGLES, ANGLES)
    return share, np.stack([zernike(j, rho, theta).ravel() for j in NOLL])


def _over_noll(name: str, waves: Floats) -> Floats:
    return real_array(name, waves, (len(NOLL),), "waves RMS of Noll 4 to 15")


def rotated(waves: Floats, angle: float) -> Floats:
    """The same wavefront (12,) turned about the axis by an angle in radians."""
    waves = _over_noll("waves", waves)
    turned = waves.copy()
    for k, j in enumerate(NOLL):
        n, m = noll_to_nm(j)
        if m > 0:
            other = next(i for i, q in enumerate(NOLL) if noll_to_nm(q) == (n, -m))
            cosine, sine = np.cos(m * angle), np.sin(m * angle)
            turned[k] = waves[k] * cosine - waves[other] * sine
            turned[other] = waves[k] * sine + waves[other] * cosine
    return turned


def strehl(waves: Floats) -> tuple[float, Floats]:
    """Strehl ratio of a wavefront (12,) over Noll 4 to 15, waves RMS, and its gradient (12,)."""
    waves = _over_noll("waves", waves)
    weights, modes = _samples()
    field = weights * np.exp(2j * np.pi * (waves @ modes))
    total = field.sum()
    gradient = 2 * (np.conj(total) * (modes @ field) * 2j * np.pi).real
    return float(np.abs(total) ** 2), np.asarray(gradient)


def highest_on_shell(start: Floats, rms: float) -> Floats:
    """A local maximum of the Strehl ratio on the sphere of one RMS, near a start; start: (12,), not zero."""
    start = _over_noll("start", start)
    positive("rms", rms, "waves")
    positive("length of start", float(np.linalg.norm(start)), "waves RMS")

    def lowered(direction: Floats) -> tuple[float, Floats]:
        length = np.linalg.norm(direction)
        place = direction * (rms / length)
        value, slope = strehl(place)
        tangent = slope - (slope @ place) / rms**2 * place
        return -value / rms**4, -tangent * (rms / length) / rms**4  # on a shell Strehl ratios differ by about rms^4

    end = minimize(
        lowered, start / np.linalg.norm(start), jac=True, method="L-BFGS-B", options={"gtol": 1e-7, "ftol": 1e-14}
    )
    return np.asarray(end.x * (rms / np.linalg.norm(end.x)))


def is_trivial(waves: Floats, other: Floats, tolerance: float) -> bool:
    """Whether a wavefront is another, its negative or a twin, turned by any angle, but for a tolerance (waves RMS)."""
    waves, other, even = _over_noll("waves", waves), _over_noll("other", other), twin_signs(NOLL)
    alike = [
        rotated(a, angle) for a in (other, -other, even * other, -even * other) for angle in np.arange(180) * np.pi / 90
    ]
    return bool(np.min(np.linalg.norm(waves - np.array(alike), axis=1)) < tolerance)


@cache
def shipped() -> tuple[Floats, Floats]:
    """(n,) RMS of the shells, waves, and (n, 12) the perturbations on them, none a trivial associate of another."""
    with resources.as_file(resources.files("labkit.inference") / "candidates.npz") as path, np.load(path) as data:
        return data["rms"].astype(float), data["waves"].astype(float)


def candidates(waves: Floats, rms: float = 0.2) -> Floats:
    """(m, 12) where to look next from a wavefront over Noll 4 to 15: it, perturbed on the shell nearest to an RMS.

    Each perturbation is taken with its trivial associates: negative, twins, and all of them turned TURNS times.
    Raises ValueError for a wavefront of another number of modes.
    """
    waves = _over_noll("waves", waves)
    positive("rms", rms, "waves")
    shells, perturbations = shipped()
    nearest, even = perturbations[shells == shells[np.argmin(np.abs(shells - rms))]], twin_signs(NOLL)
    signed = np.concatenate([nearest, -nearest, nearest * even, -nearest * even])
    turns = 2 * np.pi * np.arange(TURNS) / TURNS
    return np.asarray(waves + np.unique([rotated(p, turn).round(9) for p in signed for turn in turns], axis=0))
