"""Standard errors of estimates with a known bias that is not corrected.

A standard error is read as the half-width of an interval with a coverage of 68.3 %. The root sum of squares of standard error
and bias does not keep this coverage: for a large bias the coverage is 50 %. S. D. Phillips, K. R. Eberhardt, B. Parry, J. Res.
NIST 102, 577 (1997).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chndtrix, erf

from labkit.types import Floats

WITHIN = float(erf(0.5**0.5))
"""Chance of a normal error within one standard error."""


def error_with_bias(std: Floats, bias: Floats) -> Floats:
    """Return the half-width with the coverage of one standard error, for estimates with a known bias.

    A squared normal error with a bias follows the noncentral chi-squared distribution. For
    a bias beyond a hundred standard errors the width grows with the bias.

    Parameters
    ----------
    std, bias : standard errors and biases, of the same shape and unit
    """
    std = np.asarray(std, float)
    bias = np.abs(bias)
    ratio = np.minimum(bias / np.maximum(std, np.finfo(float).tiny), 100.0)
    return np.asarray(
        std * (np.sqrt(chndtrix(WITHIN, 1, ratio**2)) - ratio)
        + np.maximum(bias, ratio * std)
    )


def covariance_with_bias(covariance: Floats, bias: Floats) -> Floats:
    """Add a known bias (n,) to a covariance (n, n): the diagonal becomes `error_with_bias` squared.

    The biases of all n estimates are fully correlated.
    """
    variance = np.diag(covariance)
    added = np.maximum(error_with_bias(np.sqrt(variance), bias) ** 2 - variance, 0.0)
    together = np.sign(bias) * np.sqrt(added)
    return np.asarray(covariance + np.outer(together, together))
