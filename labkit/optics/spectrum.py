"""A channel's light: of several wavelengths, whose PSFs add up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from labkit.types import Floats

SPECTRUM_NODES = 7
"""Wavelengths that stand for a spectrum of samples: they have its first 13 moments. PSFs of light 40 nm broad (half maximum)
err by 0.0004 to 0.003 (L1) with 0 to 2 waves of defocus; with 5 nodes by 0.002 to 0.013, with 3 by 0.005 to 0.03."""

KURTOSIS = 2.0
"""Fourth moment over the squared variance where only a width is known: 1.8 of a box, 3 of a Gaussian."""

WIDEST_SPECTRUM = 0.08
"""Largest standard deviation, relative, of a spectrum fitted; 40 nm of 500."""


@dataclass(frozen=True)
class Spectrum:
    """Relative wavelengths (n,), 1 the channel's nominal wavelength, and their shares (n,) of the light, of sum
    1.

    Shares below 0 sharpen; they occur only in the course of an estimate.
    """

    nodes: tuple[float, ...] = (1.0,)
    weights: tuple[float, ...] = (1.0,)

    @classmethod
    def of_samples(
        cls, wavelengths_nm: Sequence[float], weights: Sequence[float], nominal_nm: float
    ) -> Spectrum:
        """Return the spectrum of samples, by the fewest nodes with their moments.

        G. Golub and J. Welsch, Math. Comp. 23, 221 (1969). Raises ValueError for weights
        below 0, or none above.
        """
        at = np.asarray(wavelengths_nm, float) / nominal_nm
        shares = np.asarray(weights, float)
        if not (shares.min() >= 0 < shares.sum()):
            raise ValueError(
                f"weights {[*map(float, shares)]} of a spectrum: none may be below 0, and some must be above"
            )
        at = at[shares > 0]
        shares = shares[shares > 0] / shares.sum()
        nodes, weights_ = _gauss(at, shares, min(SPECTRUM_NODES, np.unique(at).size))
        return cls(tuple(map(float, nodes)), tuple(map(float, weights_)))

    @classmethod
    def of_lines(cls, lines: Sequence[Sequence[float]], nominal_nm: float) -> Spectrum:
        """Return the spectrum of wavelengths, nm, and their shares, each as given."""
        nodes, weights = zip(
            *((float(nm) / nominal_nm, float(share)) for nm, share in lines), strict=True
        )
        return cls(nodes, weights)

    @classmethod
    def of_width(cls, variance: float) -> Spectrum:
        """Return a spectrum symmetric about the nominal wavelength.

        variance: relative to the square of the wavelength; values beyond WIDEST^2 count as
        WIDEST^2. A negative variance sharpens as much as light of the positive variance
        blurs.
        """
        variance = min(max(variance, -(WIDEST_SPECTRUM**2)), WIDEST_SPECTRUM**2)
        offset = float(np.sqrt(KURTOSIS * abs(variance)))
        if not offset:
            return cls()
        side = float(np.sign(variance)) / (2 * KURTOSIS)
        return cls((1 - offset, 1.0, 1 + offset), (side, 1 - 2 * side, side))

    @property
    def mean(self) -> float:
        """Mean wavelength, relative."""
        return sum(share * node for share, node in self.shares)

    @property
    def variance(self) -> float:
        """Variance of the wavelengths, relative to the square of the nominal wavelength."""
        mean = self.mean
        return sum(share * (node - mean) ** 2 for share, node in self.shares)

    def with_variance(self, variance: float) -> Spectrum:
        """Return a spectrum of the same form and mean and of another variance; light of one wavelength has no form, and becomes
        symmetric."""
        if not self.variance:
            return Spectrum.of_width(variance)
        mean, factor = self.mean, float(np.sqrt(max(variance, 0.0) / self.variance))
        nodes = tuple(mean + factor * (node - mean) for node in self.nodes)
        return Spectrum(nodes, self.weights)

    @property
    def shares(self) -> list[tuple[float, float]]:
        """(weight, node) of each."""
        return list(zip(self.weights, self.nodes, strict=True))

    @property
    def physical(self) -> Spectrum:
        """Light that exists: a single wavelength for a spectrum that would sharpen."""
        return self if min(self.weights) >= 0 else Spectrum()

    def lines(self, nominal_nm: float) -> list[list[float]]:
        """Return [nm, share] of each wavelength."""
        return [[node * nominal_nm, share] for share, node in self.shares]


def _gauss(at: Floats, shares: Floats, count: int) -> tuple[Floats, Floats]:
    """Return nodes and weights (count,) with the first moments of a discrete distribution, by Lanczos'
    recurrence.
    """
    diagonal = np.zeros(count)
    beside = np.zeros(count)
    before = np.zeros_like(shares)
    here = np.sqrt(shares)
    for k in range(count):
        diagonal[k] = here @ (at * here)
        after = (at - diagonal[k]) * here - (beside[k - 1] if k else 0.0) * before
        beside[k] = np.linalg.norm(after)
        if k + 1 < count:
            before = here
            here = after / beside[k]
    nodes, vectors = scipy.linalg.eigh_tridiagonal(diagonal, beside[: count - 1])
    return np.asarray(nodes, float), np.asarray(vectors[0] ** 2, float)


ONE_WAVELENGTH = Spectrum()
