"""Standard errors of estimates with a known bias that is not corrected, such as by light of unknown width.

A standard error is read as the half-width of an interval with a coverage of 68.3 %. The root sum of squares of standard error
and bias does not keep this coverage: for a large bias the coverage is 50 %. S. D. Phillips, K. R. Eberhardt, B. Parry, J. Res.
NIST 102, 577 (1997).

Photographs hardly determine the spectral width of their light, but images of points depend on the width: in light of the
largest width that the photographs allow a Strehl ratio is lower by several of its standard errors. The largest change up to
that width counts as a known bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from scipy.special import chndtrix, erf

from labkit.optics.wavefront import FittedWavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

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


class Estimated(Protocol):
    """A dataclass of values with standard errors, of one shape."""

    @property
    def value(self) -> Floats | float: ...

    @property
    def std(self) -> Floats | float: ...


Measure = TypeVar("Measure", bound=Callable[..., Any])
N = TypeVar("N", bound=Estimated)


def in_any_light(measure: Measure) -> Measure:
    """Include, in a number's standard errors, its largest change in light that the photographs allow."""

    @wraps(measure)
    def measured(wavefront: FittedWavefront, *args: Any, **kwargs: Any) -> Any:
        number = measure(wavefront, *args, **kwargs)
        lights = wavefront.in_possible_lights
        return widened(number, *(measure(light, *args, **kwargs) for light in lights))

    return cast(Measure, measured)


def widened(number: N, *others: N) -> N:
    """Return a number with an error that includes its largest difference from others."""
    if not others:
        return number
    change = largest([other.value - number.value for other in others])
    std = error_with_bias(number.std, change)  # type: ignore[arg-type]
    return replace(number, std=float(std) if isinstance(number, Uncertain) else std)  # type: ignore[type-var]


def largest(changes: Sequence[Floats | float]) -> Floats:
    """Return the largest absolute value of each element of changes of one shape."""
    return np.asarray(np.max([np.abs(change) for change in changes], axis=0))
