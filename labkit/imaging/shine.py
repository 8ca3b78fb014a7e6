"""How brightly the places of a target shine: what flats show of the light, laid on the target before it is blurred."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.types import Bools, Floats

ORDER = 3  # of the polynomial: a panel's light changes little over a target


@dataclass(frozen=True, eq=False)
class Shine:
    """Smooth light over a frame: exp of a polynomial in row and column.

    shape: (rows, columns) of the frame; coefficients: (4, 4) of the powers of row and of column, both from -1 to 1 over the
    frame; those of more than the third order together are 0. Beyond the frame the light is that of its edge.
    """

    shape: tuple[int, int]
    coefficients: Floats

    @classmethod
    def seen(cls, illumination: Floats, used: Bools) -> "Shine":
        """Of light that is known where a mask (rows, columns) holds, noise of single pixels in it."""
        down, right = (_powers(at, n) for at, n in zip(np.nonzero(used), used.shape, strict=True))
        low = np.add.outer(np.arange(ORDER + 1), np.arange(ORDER + 1)) <= ORDER
        terms = np.array([down[i] * right[j] for i, j in np.argwhere(low)])
        coefficients = np.zeros(low.shape)
        coefficients[low] = np.linalg.lstsq(terms.T, np.log(illumination[used]), rcond=None)[0]
        return cls(used.shape, coefficients)

    def at(self, rows: Floats, columns: Floats) -> Floats:
        """(m, n) relative light at rows (m,) and columns (n,), pixels of the frame."""
        return np.asarray(np.exp(self._ln(rows, columns)))

    def slopes(self, rows: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """(m, n) by how much ln of the light grows there from row to row and from column to column."""
        down, right = (
            self._ln(rows + r, columns + c) - self._ln(rows - r, columns - c) for r, c in ((0.5, 0), (0, 0.5))
        )
        return down, right

    def _ln(self, rows: Floats, columns: Floats) -> Floats:
        down, right = (_powers(at, n) for at, n in zip((rows, columns), self.shape, strict=True))
        return np.asarray(down.T @ self.coefficients @ right)


def _powers(at: Floats | NDArray[np.intp], size: int) -> Floats:
    """(4, n) of places (n,) along an axis of a frame, from -1 to 1."""
    return np.asarray(np.clip(2 * at / max(size - 1, 1) - 1, -1, 1) ** np.arange(ORDER + 1)[:, None])
