"""Errors of numbers computed from a wavefront whose light has an unknown spectral width.

Photographs hardly determine the width, but images of points depend on it: in light of the
largest width that the photographs allow a Strehl ratio is lower by several of its standard
errors. The largest change up to that width counts as a known bias that is not corrected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from labkit.optics.known_bias import error_with_bias
from labkit.optics.wavefront import FittedWavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain


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
