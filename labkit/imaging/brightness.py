"""The brightness of a target from place to place: light measured by flats, applied before the blur."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labkit.types import Bools, Floats

POLYNOMIAL_ORDER = 3  # of the polynomial: a panel's light changes little over a target
SHARE_STD = (
    0.5  # of the light's unevenness, by how much it is not the target's own but the lens's
)


@dataclass(frozen=True, eq=False)
class Brightness:
    """Smooth light over a frame: exp of a polynomial in row and column.

    shape: (rows, columns) of the frame; coefficients: (4, 4) of the powers of row and of
    column, both from -1 to 1 over the frame; terms of total order above three are 0. Beyond
    the frame the light is that of its edge.
    """

    shape: tuple[int, int]
    coefficients: Floats

    @classmethod
    def fitted(cls, illumination: Floats, used: Bools) -> "Brightness":
        """Fit the light in the pixels of a mask (rows, columns), despite the noise of single pixels."""
        down, right = (
            _powers(at, n) for at, n in zip(np.nonzero(used), used.shape, strict=True)
        )
        low = (
            np.add.outer(np.arange(POLYNOMIAL_ORDER + 1), np.arange(POLYNOMIAL_ORDER + 1))
            <= POLYNOMIAL_ORDER
        )
        terms = np.array([down[i] * right[j] for i, j in np.argwhere(low)])
        coefficients = np.zeros(low.shape)
        coefficients[low] = np.linalg.lstsq(
            terms.T, np.log(illumination[used]), rcond=None
        )[0]
        return cls(used.shape, coefficients)

    def at(self, rows: Floats, columns: Floats) -> Floats:
        """Return (m, n) relative light at rows (m,) and columns (n,), pixels of the frame."""
        return np.asarray(np.exp(self._ln(rows, columns)))

    def growth_std(self, rows: Floats, columns: Floats) -> Floats:
        """Return (2, 2, m, n) standard errors of the growth of ln of the light from row to row and column to
        column.

        The first part is the share that may belong to the lens after all. The second is the
        target's part symmetric about the middle, which was attributed to the lens's
        fall-off: an even curvature of the light, invisible to any flat, which changes the
        size of a blurred image.
        """
        down, right = (
            self._ln(rows + r, columns + c) - self._ln(rows - r, columns - c)
            for r, c in ((0.5, 0), (0, 0.5))
        )
        away = (
            at - (n - 1) / 2
            for at, n in zip((rows[:, None], columns[None, :]), self.shape, strict=True)
        )
        bent = [np.broadcast_to(self._round_std * d, down.shape) for d in away]
        return np.array([[SHARE_STD * down, SHARE_STD * right], bent])

    @property
    def _round_std(self) -> float:
        """Standard error of the curvature of ln of the light, per pixel^2, equal along rows and columns.

        As in an isotropic random field, this curvature is as large as the other curvatures,
        which are measured: its variance, of (xx + yy) / 2, is twice that of (xx - yy) / 2
        and of xy.
        """
        rows, columns = (max(n - 1, 1) / 2 for n in self.shape)
        c = self.coefficients
        unlike = c[2, 0] / rows**2 - c[0, 2] / columns**2
        crossed = c[1, 1] / (rows * columns)
        return float(np.hypot(unlike, crossed))

    def _ln(self, rows: Floats, columns: Floats) -> Floats:
        down, right = (
            _powers(at, n) for at, n in zip((rows, columns), self.shape, strict=True)
        )
        return np.asarray(down.T @ self.coefficients @ right)


def _powers(at: Floats | NDArray[np.intp], size: int) -> Floats:
    """Return (4, n) powers of places (n,) along an axis of a frame, from -1 to 1."""
    return np.asarray(
        np.clip(2 * at / max(size - 1, 1) - 1, -1, 1)
        ** np.arange(POLYNOMIAL_ORDER + 1)[:, None]
    )
