"""Independent normal counts whose variance follows their mean (thesis 3.2-3.28), the basis of every likelihood in labkit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labkit.types import Floats


@dataclass(frozen=True, eq=False)
class NormalCounts:
    """The distribution of counts with the black level removed: independent, normal, the variance a function of the mean.

    Attributes
    ----------
    mean : counts, any shape; all other arrays have the same shape
    gain : counts per electron
    read_variance : counts^2
    relative_std : standard deviation of the illumination, relative
    rounding : variance of rounding, counts^2, where it differs from pixel to pixel

    Notes
    -----
    Thesis (3.2): variance = gain max(mean, 0) + read_variance + (relative_std mean)^2 + rounding. A mean below 0, as a PSF's
    rings can make it, has no photon noise.
    """

    mean: Floats
    gain: float
    read_variance: float
    relative_std: Floats | float = 0.0
    rounding: Floats | float = 0.0

    @cached_property
    def variance(self) -> Floats:
        """Variance of the counts, counts^2."""
        spread = self.relative_std * self.mean
        photons = self.gain * np.maximum(self.mean, 0.0)
        return np.asarray(photons + self.read_variance + spread**2 + self.rounding)

    @cached_property
    def bend(self) -> Floats:
        """Derivative of the variance with respect to the mean, counts."""
        return np.asarray(
            self.gain * (self.mean > 0) + 2 * self.relative_std**2 * self.mean
        )

    @cached_property
    def of_variance(self) -> Floats:
        """(2, ...) derivatives of the variance with respect to the logarithms of gain and read variance, counts^2."""
        return np.stack(
            [
                self.gain * np.maximum(self.mean, 0.0),
                np.full_like(self.mean, self.read_variance),
            ]
        )

    def chi2(self, counts: Floats) -> float:
        """Return the sum of squared residuals over their variance."""
        return float(np.sum((counts - self.mean) ** 2 / self.variance))

    def log_likelihood(self, counts: Floats) -> float:
        """Return the log-likelihood, thesis (3.5), without its constant."""
        return float(
            -0.5 * np.sum((counts - self.mean) ** 2 / self.variance + np.log(self.variance))
        )

    def pulls(self, counts: Floats) -> tuple[Floats, Floats]:
        """Return derivatives of each pixel's log-likelihood by its mean and by its variance, thesis (3.9).

        The derivative by the mean includes the variance's dependence on the mean.
        """
        normalised = (counts - self.mean) / self.variance
        rise = 0.5 * (normalised**2 - 1 / self.variance)
        return normalised + self.bend * rise, rise

    def weights(self) -> tuple[Floats, Floats, Floats]:
        """Return weights of products of derivatives in the Fisher information of each pixel, thesis (3.15), (3.19).

        Returns
        -------
        weights for mean times mean, mean times variance, variance times variance
        """
        square = 0.5 / self.variance**2
        cross = self.bend * square
        return 1 / self.variance + self.bend * cross, cross, square


@dataclass(frozen=True, eq=False, kw_only=True)
class Slopes(NormalCounts):
    """Counts with the derivatives of their mean with respect to parameters.

    Attributes
    ----------
    of_mean : (parameters, pixels), counts per unit of the parameter; the logarithms of gain and read variance, which do not
        affect the mean, follow these parameters
    """

    of_mean: Floats

    def gradient(self, counts: Floats) -> Floats:
        """Return the gradient (parameters + 2,) of the log-likelihood, thesis (3.9)."""
        by_mean, by_variance = self.pulls(counts)
        return np.concatenate([self.of_mean @ by_mean, self.of_variance @ by_variance])

    def information(self) -> Floats:
        """Return the Fisher information (parameters + 2, parameters + 2), thesis (3.15), (3.19)."""
        both, cross, square = self.weights()
        across = self.of_mean @ (self.of_variance * cross).T
        weighted = self.of_mean * np.sqrt(both)
        own = (self.of_variance * square) @ self.of_variance.T
        return np.block([[weighted @ weighted.T, across], [across.T, own]])
