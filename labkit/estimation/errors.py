"""Errors of numbers that are known to be biased, and stay as they are.

A standard error is taken for the width that holds the truth 68.3 times in 100. Beside a bias the root of both squares does not:
beside a large one it holds it 50 times. S. D. Phillips, K. R. Eberhardt, B. Parry, J. Res. NIST 102, 577 (1997).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chndtrix, erf

from labkit.types import Floats

WITHIN = float(erf(0.5**0.5))
"""Chance of a normal error within one standard error."""


def error_with_bias(std: Floats, bias: Floats) -> Floats:
    """Standard error that holds the truth as often as that of a normal error does, of an estimate with a known bias.

    A squared normal error with a bias follows the noncentral chi-squared distribution; beyond a hundred standard errors
    of bias the width grows as the bias does.
    """
    std, bias = np.asarray(std, float), np.abs(bias)
    ratio = np.minimum(bias / np.maximum(std, np.finfo(float).tiny), 100.0)
    return np.asarray(std * (np.sqrt(chndtrix(WITHIN, 1, ratio**2)) - ratio) + np.maximum(bias, ratio * std))


def covariance_with_bias(covariance: Floats, bias: Floats) -> Floats:
    """(n, n) whose diagonal is `error_with_bias` squared, all numbers (n,) biased together."""
    variance = np.diag(covariance)
    added = np.maximum(error_with_bias(np.sqrt(variance), bias) ** 2 - variance, 0.0)
    together = np.sign(bias) * np.sqrt(added)
    return np.asarray(covariance + np.outer(together, together))
