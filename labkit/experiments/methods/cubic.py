"""Keys' cubic interpolation on a torus, its derivatives and its adjoint: the operator Q of thesis (2.34).

R. G. Keys, *Cubic convolution interpolation for digital image processing*, IEEE Trans. ASSP 29, 1981, with a = -1/2, the one
value that reproduces quadratics (OpenCV's INTER_CUBIC has -3/4).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.arrays import real_array
from labkit.types import Floats

TAPS = np.array([-1, 0, 1, 2])
KEYS_KERNEL = np.array([[0.0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]]) / 2
"""[tap, power]: the weight of a sample, a polynomial of the point's distance, 0 to 1, past the sample before it."""

HIGHEST_DERIVATIVE = 2


@dataclass(frozen=True)
class Cubic:
    """Interpolation at points between the samples of an image on a torus.

    The first derivatives of the interpolated image are continuous, the second ones jump at the samples.

    Parameters
    ----------
    shape : (rows, columns) of the image
    row, col : (points,), samples; points outside the image wrap around

    Raises
    ------
    ValueError
        for an empty image, and for arrays of other shapes or not finite
    """

    shape: tuple[int, int]
    row: Floats
    col: Floats

    def __post_init__(self) -> None:
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise ValueError(
                f"shape: (rows, columns) of at least one sample each are needed, not {self.shape}"
            )
        object.__setattr__(self, "row", real_array("row", self.row, (None,), "samples"))
        object.__setattr__(
            self, "col", real_array("col", self.col, self.row.shape, "samples")
        )

    def apply(self, image: Floats, by_row: int = 0, by_col: int = 0) -> Floats:
        """Return interpolated values, or their derivatives.

        Parameters
        ----------
        image : (rows, columns)
        by_row, by_col : orders of the derivative, 0 to 2

        Returns
        -------
        (points,), per sample to the power of each order
        """
        image = real_array("image", image, self.shape, "radiance")
        return np.asarray(
            sum(weight * image.flat[index] for index, weight in self._terms(by_row, by_col))
        )

    def adjoint(self, values: Floats, by_row: int = 0, by_col: int = 0) -> Floats:
        """Return the transpose of `apply`: values (points,) to an image (rows, columns)."""
        values = real_array("values", values, self.row.shape, "radiance")
        size = self.shape[0] * self.shape[1]
        terms = self._terms(by_row, by_col)
        return np.asarray(
            sum(np.bincount(index, weight * values, size) for index, weight in terms)
        ).reshape(self.shape)

    def _terms(self, by_row: int, by_col: int) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        """Yield flat indices and weights, (points,) each, of the 16 neighbours in turn."""
        row_index, row_weight = _taps(self.row, self.shape[0], by_row)
        col_index, col_weight = _taps(self.col, self.shape[1], by_col)
        for i, wi in zip(row_index, row_weight, strict=True):
            for j, wj in zip(col_index, col_weight, strict=True):
                yield i * self.shape[1] + j, wi * wj


def _taps(at: Floats, side: int, order: int) -> tuple[NDArray[np.intp], Floats]:
    """Return indices and weights of the four neighbours along one axis, (4, points) each."""
    if not 0 <= order <= HIGHEST_DERIVATIVE:
        raise ValueError(
            f"a derivative of order {order}: allowed are 0 to {HIGHEST_DERIVATIVE}"
        )
    before = np.floor(at)
    polynomial = np.polynomial.polynomial.polyder(KEYS_KERNEL, order, axis=1)
    weight = np.polynomial.polynomial.polyval(at - before, polynomial.T)
    return (before.astype(np.intp) + TAPS[:, None]) % side, np.asarray(
        weight, dtype=np.float64
    )
