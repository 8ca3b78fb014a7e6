"""How brightly the places of a target shine: what flats show of the light, laid on the target before it is blurred."""

from dataclasses import dataclass

import numpy as np

from labkit.types import Bools, Floats

ORDER = 3  # of the polynomial: a panel's light changes little over a target


@dataclass(frozen=True, eq=False)
class Shine:
    """Smooth light over a frame: exp of a polynomial in row and column.

    shape: (rows, columns) of the frame; coefficients: (10,), by the powers that `_powers` gives. Beyond the frame the light
    is that of its edge.
    """

    shape: tuple[int, int]
    coefficients: Floats

    @classmethod
    def seen(cls, illumination: Floats, used: Bools) -> "Shine":
        """Of light that is known where a mask (rows, columns) holds, noise of single pixels in it."""
        shape, (rows, columns) = used.shape, np.nonzero(used)
        powers = _powers(shape, rows.astype(np.float64), columns.astype(np.float64))
        coefficients = np.linalg.lstsq(powers.T, np.log(illumination[used]), rcond=None)[0]
        return cls(shape, np.asarray(coefficients, np.float64))

    def at(self, rows: Floats, columns: Floats) -> Floats:
        """Relative light at rows and columns, pixels of the frame, whose shapes broadcast."""
        return np.asarray(np.exp(np.tensordot(self.coefficients, _powers(self.shape, rows, columns), 1)))

    def slopes(self, rows: Floats, columns: Floats) -> tuple[Floats, Floats]:
        """By how much ln of the light grows there from row to row and from column to column."""
        up, down, right, left = (
            np.tensordot(self.coefficients, _powers(self.shape, rows + r, columns + c), 1)
            for r, c in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))
        )
        return up - down, right - left


def _powers(shape: tuple[int, int], rows: Floats, columns: Floats) -> Floats:
    """(10, ...) of places within a frame, from -1 to 1."""
    y, x = (np.clip(2 * at / max(n - 1, 1) - 1, -1, 1) for at, n in zip((rows, columns), shape, strict=True))
    return np.array([y**i * x**j for i in range(ORDER + 1) for j in range(ORDER + 1 - i)])
