"""Errors of numbers that are known to be biased, and stay as they are.

A standard error is taken for the width that holds the truth 68.3 times in 100. Beside a bias the root of both squares does not:
beside a large one it holds it 50 times. S. D. Phillips, K. R. Eberhardt, B. Parry, J. Res. NIST 102, 577 (1997).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from labkit.types import Floats

WITHIN = float(ndtr(1) - ndtr(-1))
"""Chance of a normal error within one standard error."""

FAR = 6.0
"""Standard errors of bias beyond which one end of the width is all that counts."""

ONE_SIDED = float(ndtri(WITHIN))
"""Standard errors beyond which a normal error lies on one side with a chance of WITHIN."""


def error_with_bias(std: Floats, bias: Floats) -> Floats:
    """Such that a normal error of a standard deviation, beside a bias, is as often within as a normal error within its own."""
    std, ratio = np.asarray(std, float), np.abs(bias) / np.maximum(std, np.finfo(float).tiny)
    near = np.minimum(ratio, FAR)
    low, high = np.ones_like(near), near + 1
    for _ in range(40):  # halvings
        middle = (low + high) / 2
        short = ndtr(middle - near) - ndtr(-middle - near) < WITHIN
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(ratio > FAR, np.abs(bias) + ONE_SIDED * std, high * std)


def covariance_with_bias(covariance: Floats, bias: Floats) -> Floats:
    """(n, n) whose diagonal is `error_with_bias` squared, all numbers (n,) biased together."""
    variance = np.diag(covariance)
    added = np.maximum(error_with_bias(np.sqrt(variance), bias) ** 2 - variance, 0.0)
    together = np.sign(bias) * np.sqrt(added)
    return np.asarray(covariance + np.outer(together, together))
