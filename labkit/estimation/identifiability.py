"""Identifiability: the Cramér-Rao bound of an information matrix, singular or not, and undetermined combinations in words."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from labkit.arrays import symmetric
from labkit.types import Floats

SINGULAR_SHARE = 2.0**-40
"""Smallest eigenvalue of an information matrix, scaled to a unit diagonal, that rounding does not explain."""


@dataclass(frozen=True)
class Bound:
    """The Cramér-Rao bound of a Fisher information.

    Attributes
    ----------
    names : (p,) of the parameters
    covariance : (p, p) least covariance of an unbiased estimate, over determined combinations only if some are undetermined
    undetermined : combinations that the data do not determine, in words
    """

    names: tuple[str, ...]
    covariance: Floats
    undetermined: tuple[str, ...] = ()

    @property
    def std(self) -> Floats:
        """(p,) least standard errors; infinite for a parameter in an undetermined combination."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def rms(self, first: int, last: int) -> float:
        """Return the root sum of squares of standard errors first to last-1: for modes, the RMS error of the wavefront."""
        return float(np.linalg.norm(self.std[first:last]))


def bound_of(information: Floats, names: Sequence[str]) -> Bound:
    """Return the Cramér-Rao bound of an information matrix, singular or not.

    Parameters
    ----------
    information : (p, p) in the parameters' units, inverse squared
    names : (p,) of the parameters

    Raises
    ------
    ValueError : the matrix is not symmetric and finite, or has another size
    """
    information = symmetric(
        "information", information, len(names), "of the parameters' units, inverse squared"
    )
    scale, values, vectors, least = _scaled(information)
    open_ = values < least
    inverse = (vectors[:, ~open_] / values[~open_]) @ vectors[:, ~open_].T
    covariance = inverse * np.outer(scale, scale)
    lost = np.flatnonzero(np.abs(vectors[:, open_]).max(axis=1, initial=0.0) > 1e-6)
    covariance[lost, lost] = np.inf
    words = tuple(
        _in_words(direction, scale, names) for direction in _plainest(vectors[:, open_])
    )
    return Bound(tuple(names), covariance, words)


def inverse(information: Floats) -> Floats:
    """Return the inverse (p, p) of an information matrix: entries are huge where the matrix is singular, never infinite."""
    scale, values, vectors, least = _scaled(information)
    return np.asarray((vectors / values.clip(least)) @ vectors.T * np.outer(scale, scale))


def _scaled(information: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Return the scale (p,) that makes the diagonal 1, the eigenvalues and eigenvectors then, and the least regular value."""
    diagonal = np.diag(information)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return (
        scale,
        values,
        vectors,
        SINGULAR_SHARE * len(values) * max(1.0, float(values[-1])),
    )


def worse_than(
    error: float, covariance: Floats, names: Sequence[str], root: Floats | None = None
) -> tuple[str, ...]:
    """Describe combinations of parameters whose standard errors exceed a limit.

    Parameters
    ----------
    error : the limit
    covariance : (p, p) of the parameters, in the limit's unit squared
    names : (p,) of the parameters
    root : (p, p) symmetric; a combination is as large as its product with it. None for the identity
    """
    covariance = symmetric(
        "covariance", covariance, len(names), "of the parameters' unit, squared"
    )
    size = np.eye(len(names)) if root is None else root
    values, vectors = np.linalg.eigh(size @ covariance @ size)
    open_ = covariance @ size @ vectors[:, values > error**2]
    return tuple(
        _in_words(d, np.ones(len(names)), names)
        for d in _plainest(open_ / np.linalg.norm(open_, axis=0))
    )


def _plainest(directions: Floats) -> Floats:
    """Rewrite the span of directions (p, k) as (k, p) combinations of few parameters, each with one parameter to itself."""
    if directions.shape[1] == 0:
        return directions.T
    pivots = scipy.linalg.qr(directions.T, mode="r", pivoting=True)[1][
        : directions.shape[1]
    ]
    return np.asarray(np.linalg.solve(directions[pivots].T, directions.T))


def _in_words(direction: Floats, scale: Floats, names: Sequence[str]) -> str:
    """Describe a direction (p,) in scaled parameters by the names, and in the units, of its largest components."""
    named = [
        int(i) for i in np.flatnonzero(np.abs(direction) > 0.1 * np.abs(direction).max())
    ]
    if len(named) == 1:
        return names[named[0]]
    parts = direction * scale
    parts = parts / parts[max(named, key=lambda i: abs(parts[i]))]
    return " ".join(f"{parts[i]:+.2g} {names[i]}" for i in named)
