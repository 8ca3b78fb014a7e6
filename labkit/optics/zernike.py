"""Zernike polynomials in Noll's order (R. J. Noll, J. Opt. Soc. Am. 66, 207, 1976)."""

from collections.abc import Sequence
from functools import cache
from math import comb, sqrt

import numpy as np

from labkit.arrays import real_array
from labkit.types import Floats

MODE_NAMES = {
    4: "defocus",
    5: "oblique astigmatism",
    6: "vertical astigmatism",
    7: "vertical coma",
    8: "horizontal coma",
    9: "vertical trefoil",
    10: "oblique trefoil",
    11: "spherical",
    12: "vertical 2nd astigmatism",
    13: "oblique 2nd astigmatism",
    14: "vertical quadrafoil",
    15: "oblique quadrafoil",
}


def mode_name(j: int) -> str:
    """Return the usual name of a Noll mode, or its number."""
    return MODE_NAMES.get(j, f"mode {j}")


@cache
def noll_to_nm(j: int) -> tuple[int, int]:
    """Return radial order n and signed azimuthal order m of Noll mode j; m < 0 stands for the sine.

    Raises ValueError for j < 1.
    """
    if j < 1:
        raise ValueError(f"Noll index {j}: modes are counted from 1")
    n = 0
    while (n + 1) * (n + 2) // 2 < j:
        n += 1
    place = j - n * (n + 1) // 2 - 1  # 0-based place within radial order n
    m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
    return n, m if j % 2 == 0 else -m


def nm_to_noll(n: int, m: int) -> int:
    """Return the Noll mode of radial order n and signed azimuthal order m.

    Raises ValueError for an impossible pair.
    """
    if abs(m) > n or (n - m) % 2:
        raise ValueError(
            f"no Zernike polynomial has radial order {n} and azimuthal order {m}"
        )
    first = n * (n + 1) // 2 + 1
    return next(j for j in range(first, first + n + 1) if noll_to_nm(j) == (n, m))


def is_even(j: int) -> bool:
    """Return whether Noll mode j has even radial order: Z(-w) = Z(w). Such modes change sign in the twin."""
    return noll_to_nm(j)[0] % 2 == 0


def twin_signs(noll: Sequence[int]) -> Floats:
    """Return (modes,) signs of the twin's coefficients: -1 for even modes, +1 for odd ones."""
    return np.array([-1.0 if is_even(j) else 1.0 for j in noll])


def radial(n: int, m: int, rho: Floats) -> Floats:
    """Return the radial polynomial R_n^m; thesis (2.40), corrected: (n-k)! in the numerator."""
    return np.asarray(rho ** abs(m) * _radial_part(n, abs(m), rho**2))


def _radial_part(n: int, m: int, squared: Floats) -> Floats:
    """Return R_n^m over the m-th power of the radius, a polynomial in the squared radius, by Horner's rule."""
    half = (n - m) // 2
    total = np.zeros_like(squared)
    for k in range(half + 1):
        total *= squared
        total += (-1) ** k * comb(n - k, k) * comb(n - 2 * k, half - k)
    return total


def zernike(j: int, rho: Floats, theta: Floats) -> Floats:
    """Return Noll mode j on the unit disc, unit RMS.

    rho, theta: (...,) pupil polar coordinates, rho in 0..1. Returns (...,), unitless.
    Raises ValueError for j < 1, and for coordinates of two shapes or not finite. Thesis
    (2.39)-(2.41), (2.40) corrected.
    """
    n, m = noll_to_nm(j)
    rho = real_array("rho", rho, None, "pupil radii")
    theta = real_array("theta", theta, rho.shape, "radians")
    if m == 0:
        return sqrt(n + 1) * radial(n, 0, rho)
    angular = np.cos(m * theta) if m > 0 else np.sin(-m * theta)
    return sqrt(2 * (n + 1)) * radial(n, m, rho) * angular


def modes_at(noll: Sequence[int], x: Floats, y: Floats) -> Floats:
    """Return (modes, ...) Zernike modes at points of the pupil, whose radius is 1.

    rho^m cos(m theta) and rho^m sin(m theta) are the real and the imaginary part of (x +
    iy)^m.
    """
    orders = [noll_to_nm(j) for j in noll]
    squared, place = x**2 + y**2, x + 1j * y
    powers = [np.ones_like(place)]
    for _ in range(max((abs(m) for _, m in orders), default=0)):
        powers.append(powers[-1] * place)
    modes = np.empty((len(orders), *np.shape(place)))
    parts = dict[tuple[int, int], Floats]()
    for k, (n, signed) in enumerate(orders):
        m = abs(signed)
        if (n, m) not in parts:
            norm = sqrt(n + 1) if m == 0 else sqrt(2 * (n + 1))
            parts[n, m] = norm * _radial_part(n, m, squared)
        turned = powers[m].real if signed >= 0 else powers[m].imag
        modes[k] = parts[n, m] * turned
    return modes


@cache
def cartesian(j: int) -> Floats:
    """Return Noll mode j as a polynomial in x and y: (n + 1, n + 1), entry [p, q] the coefficient of x^p y^q;
    read only.
    """
    n, signed = noll_to_nm(j)
    m = abs(signed)
    odd = int(signed < 0)
    table = np.zeros((n + 1, n + 1))
    for k in range((n - m) // 2 + 1):
        half = (n - m) // 2 - k
        factor = (-1) ** k * comb(n - k, k) * comb(n - 2 * k, half)
        for q in range(half + 1):
            for r in range(odd, m + 1, 2):
                part = comb(half, q) * comb(m, r) * (-1) ** ((r - odd) // 2)
                table[2 * q + m - r, 2 * (half - q) + r] += factor * part
    table *= sqrt(n + 1) if m == 0 else sqrt(2 * (n + 1))
    table.flags.writeable = False
    return table
