"""What an information matrix determines, and what it leaves open, in words: the Cramér-Rao bound, singular or not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from labkit.arrays import symmetric
from labkit.types import Floats

SINGULAR = 2.0**-40
"""Smallest eigenvalue of an information, scaled to a unit diagonal, that rounding does not explain."""


@dataclass(frozen=True)
class Bound:
    """What a Fisher information allows.

    names: (p,) of the parameters; covariance: (p, p) of any unbiased estimate, of the determined combinations where some
    are not; undetermined: those that the data leave open, in words; none where all is determined.
    """

    names: tuple[str, ...]
    covariance: Floats
    undetermined: tuple[str, ...] = ()

    @property
    def std(self) -> Floats:
        """(p,) infinite for a parameter that has part in an undetermined combination."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def rms(self, first: int, last: int) -> float:
        """Root of the trace over a range of parameters: of the wavefront, where these are its modes."""
        return float(np.linalg.norm(self.std[first:last]))


def bound_of(information: Floats, names: Sequence[str]) -> Bound:
    """The Cramér-Rao bound of an information matrix (p, p), singular or not.

    Raises ValueError for a matrix that is not square, symmetric and finite, or other than names.
    """
    information = symmetric("information", information, len(names), "of the parameters' units, inverse squared")
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    open_ = values < SINGULAR * len(names) * max(1.0, values[-1])
    inverse = (vectors[:, ~open_] / values[~open_]) @ vectors[:, ~open_].T
    covariance = inverse * np.outer(scale, scale)
    lost = np.flatnonzero(np.abs(vectors[:, open_]).max(axis=1, initial=0.0) > 1e-6)
    covariance[lost, lost] = np.inf
    words = tuple(_in_words(direction, scale, names) for direction in _plainest(vectors[:, open_]))
    return Bound(tuple(names), covariance, words)


def inverse(information: Floats) -> Floats:
    """Covariance (p, p) of an information: entries huge where it is singular, never infinite."""
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    least = SINGULAR * len(values) * max(1.0, values[-1])
    return np.asarray((vectors / values.clip(least)) @ vectors.T * np.outer(scale, scale))


def worse_than(error: float, covariance: Floats, names: Sequence[str]) -> tuple[str, ...]:
    """Combinations of parameters of one unit whose standard error exceeds an error, in words."""
    covariance = symmetric("covariance", covariance, len(names), "of the parameters' unit, squared")
    values, vectors = np.linalg.eigh(covariance)
    return tuple(_in_words(d, np.ones(len(names)), names) for d in _plainest(vectors[:, values > error**2]))


def _plainest(directions: Floats) -> Floats:
    """(k, p) the span of directions (p, k) by combinations of few parameters: each has one parameter to itself."""
    if directions.shape[1] == 0:
        return directions.T
    pivots = scipy.linalg.qr(directions.T, mode="r", pivoting=True)[1][: directions.shape[1]]
    return np.asarray(np.linalg.solve(directions[pivots].T, directions.T))


def _in_words(direction: Floats, scale: Floats, names: Sequence[str]) -> str:
    """A direction that changes nothing in the data: scaled, to name its parameters; then in their units."""
    named = [int(i) for i in np.flatnonzero(np.abs(direction) > 0.1 * np.abs(direction).max())]
    if len(named) == 1:
        return names[named[0]]
    parts = direction * scale
    parts = parts / parts[max(named, key=lambda i: abs(parts[i]))]
    return " ".join(f"{parts[i]:+.2g} {names[i]}" for i in named)
