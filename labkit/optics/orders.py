"""Zernike coefficients in the three usual orders, and conversions between them.

| order  | counted from | mode                   | sources
|
|--------|--------------|------------------------|----------------------------------------------------------------------------|
| Noll   | 1            | unit RMS over the disc | R. J. Noll, J. Opt. Soc. Am. 66, 207
(1976)                                |
| OSA    | 0            | unit RMS over the disc | ANSI Z80.28; L. N. Thibos et al., J.
Refract. Surg. 18, S652 (2002)        |
| Fringe | 1            | 1 at the disc's rim    | J. C. Wyant and K. Creath, Appl. Opt.
Optical Eng. 11, ch. 1, table (1992) |

In all three, modes of azimuthal order m go with cos(m theta) or sin(m theta); theta runs
from x towards y. Fringe continues beyond 36 by its own rule; the set of 37 of some programs
ends with R_12^0 instead, number 49 of this rule.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import isqrt, sqrt
from typing import Literal

import numpy as np

from labkit.optics.wavefront import FittedWavefront
from labkit.optics.zernike import nm_to_noll, noll_to_nm
from labkit.types import Floats

Order = Literal["noll", "osa", "fringe"]


def noll_to_osa(j: int) -> int:
    """Return the OSA/ANSI number, from 0, of a Noll mode. Raises ValueError for j < 1."""
    n, m = noll_to_nm(j)
    return (n * (n + 2) + m) // 2


def osa_to_noll(j: int) -> int:
    """Return the Noll mode of an OSA/ANSI number. Raises ValueError for j < 0."""
    if j < 0:
        raise ValueError(f"OSA index {j}: modes are counted from 0")
    n = (isqrt(8 * j + 1) - 1) // 2
    return nm_to_noll(n, 2 * j - n * (n + 2))


def noll_to_fringe(j: int) -> int:
    """Return the Fringe number, from 1, of a Noll mode. Raises ValueError for j < 1."""
    n, m = noll_to_nm(j)
    return ((n + abs(m)) // 2 + 1) ** 2 - 2 * abs(m) + (m < 0)


def fringe_to_noll(j: int) -> int:
    """Return the Noll mode of a Fringe number. Raises ValueError for j < 1."""
    if j < 1:
        raise ValueError(f"Fringe index {j}: modes are counted from 1")
    group = isqrt(j - 1)  # (n + |m|) / 2, the same for 2 group + 1 numbers in a row
    below = (group + 1) ** 2 - j  # 2 |m| for a cosine, 2 |m| - 1 for a sine
    m = (below + 1) // 2
    return nm_to_noll(2 * group - m, -m if below % 2 else m)


def rim_value(j: int) -> float:
    """Return the greatest value of Noll mode j on the disc's rim: Fringe's coefficient over the unit-RMS one."""
    n, m = noll_to_nm(j)
    return sqrt(n + 1) if m == 0 else sqrt(2 * (n + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """A wavefront's coefficients in an order.

    index: ascending. waves: (modes,) at the reference wavelength: RMS over the pupil for Noll and OSA, the greatest value on
    the rim for Fringe. covariance: (modes, modes) of waves.
    """

    order: Order
    index: tuple[int, ...]
    waves: Floats
    covariance: Floats

    @property
    def std(self) -> Floats:
        """(modes,) standard errors, in the units of waves."""
        return np.sqrt(np.diag(self.covariance))


def coefficients(wavefront: FittedWavefront, order: Order) -> Coefficients:
    """Return the coefficients of a wavefront in one of the orders. Raises ValueError for another order."""
    conversions: dict[str, Callable[[int], int]] = {
        "noll": int,
        "osa": noll_to_osa,
        "fringe": noll_to_fringe,
    }
    if order not in conversions:
        raise ValueError(f"order {order!r}: one of {', '.join(conversions)} is needed")
    index = [conversions[order](j) for j in wavefront.noll]
    factor = np.array([rim_value(j) if order == "fringe" else 1.0 for j in wavefront.noll])
    turn = np.argsort(index)
    scaled = wavefront.covariance * np.outer(factor, factor)
    return Coefficients(
        order,
        tuple(index[k] for k in turn),
        (wavefront.waves * factor)[turn],
        scaled[np.ix_(turn, turn)],
    )
