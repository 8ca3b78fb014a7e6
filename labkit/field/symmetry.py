"""The field's terms by symmetry: a lens with an axis, its misalignment, and the rest.

Turn the place on the sensor and the pupil together by an angle. Each pair of a field's and a
pupil's mode, of azimuthal orders m and l, then turns as a vector with 0, 1, 2, ... periods:
cos(m φ - l θ) with m - l of them, cos(m φ + l θ) with m + l.

- A lens with an axis has no periods: W depends on H², H·ρ and ρ² alone (H. H. Hopkins, Wave
  Theory of Aberrations, 1950).
- To first order, decentres and tilts of elements, or of the sensor, are vectors: one period.
  They are the terms that nodal aberration theory shifts (K. P. Thompson, J. Opt. Soc. Am. A
  22, 1389 (2005)): sensor tilt, constant coma, linear astigmatism.
- The rest has two periods and more, such as constant astigmatism: surfaces that are no
  surfaces of revolution, and squares of misalignments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2

from labkit.optics.field import FieldModel
from labkit.optics.wavefront import DEFOCUS
from labkit.optics.zernike import nm_to_noll, noll_to_nm
from labkit.types import Floats
from labkit.uncertain import Uncertain

Part = Literal["symmetric", "misaligned", "rest"]

BY_SYMMETRY: tuple[Part, ...] = ("symmetric", "misaligned", "rest")

NEGLIGIBLE = 1e-9
"""Eigenvalues of a covariance, relative to the largest, that are zero but for rounding."""


def part_matrix(field: Sequence[int], noll: Sequence[int], part: Part) -> Floats:
    """Return the projection (n, n) of the coefficients (field, modes), ravelled, of a channel on a part.

    The three parts add up to one, and are orthogonal where both modes of each azimuthal
    order are there.
    """
    terms = [(k, j) for k in field for j in noll]
    if part == "rest":
        known = (part_matrix(field, noll, other) for other in BY_SYMMETRY[:2])
        return np.asarray(np.eye(len(terms)) - sum(known))
    periods = 0 if part == "symmetric" else 1
    matrix = np.zeros((len(terms), len(terms)))
    for row, (k, j) in enumerate(terms):
        (n_field, m), (n_pupil, l) = noll_to_nm(k), noll_to_nm(j)  # noqa: E741
        even = (m < 0) == (l < 0)  # in a mirror through the axis
        if part == "symmetric" and not even:
            continue
        slow = abs(abs(m) - abs(l)) == periods
        fast = abs(m) + abs(l) == periods
        matrix[row, row] = (slow + fast) / 2
        other = (nm_to_noll(n_field, -m), nm_to_noll(n_pupil, -l))
        if m and l and other in terms:
            sign = 1.0 if even else -1.0
            matrix[row, terms.index(other)] = sign * (slow - fast) / 2
    return matrix


@dataclass(frozen=True, slots=True)
class Share:
    """A part of a channel's wavefront, as RMS over pupil and field.

    Parameters
    ----------
    rms : waves RMS, without the squares of the errors
    p_value : probability of coefficients as large if there is nothing of this part
    """

    rms: Uncertain
    p_value: float


def share(
    model: FieldModel,
    channel: str,
    part: Part,
    without: Sequence[int] = (DEFOCUS,),
) -> Share:
    """Return the share of a part in a channel's wavefront.

    without : the pupil's modes to leave out. Defocus shows the sensor more than the lens.
    """
    matrix = part_matrix(model.field, model.noll, part)
    kept = [j not in without for _ in model.field for j in model.noll]
    matrix = matrix[kept]
    own = model.channels.index(channel)
    waves = matrix @ model.waves[own].ravel()
    start = own * matrix.shape[1]
    block = slice(start, start + matrix.shape[1])
    covariance = matrix @ model.covariance[block, block] @ matrix.T
    square = float(waves @ waves)
    known = float(np.trace(covariance))
    variance = 4 * waves @ covariance @ waves + 2 * np.sum(covariance**2)
    rms = np.sqrt(max(square - known, 0.0))
    std = np.sqrt(variance) / (2 * max(rms, variance**0.25)) if variance > 0 else 0.0
    return Share(Uncertain(rms, std, "waves"), _p_value(waves, covariance))


def _p_value(waves: Floats, covariance: Floats) -> float:
    """Return the probability of coefficients as far from zero in their errors; nan without errors."""
    size, along = np.linalg.eigh(covariance)
    counted = size > NEGLIGIBLE * max(size[-1], 0.0) if size.size else size > 0
    if not counted.any():
        return float("nan")
    pulls = (along.T @ waves)[counted] / np.sqrt(size[counted])
    return float(chi2.sf(pulls @ pulls, counted.sum()))
