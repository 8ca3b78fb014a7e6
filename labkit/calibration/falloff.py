"""What of a flat's light is the lens's: the fall-off, round about the middle of the frame. The rest is the target's own.

The two act apart, for a target's own light is blurred with it, and a lens's fall-off multiplies what is blurred already.
"""

from dataclasses import dataclass

import numpy as np

from labkit.raw.mosaic import Cut
from labkit.types import Floats, Floats32

SAMPLES = 100  # along each side of the frame: light is smooth


@dataclass(frozen=True, slots=True)
class Falloff:
    """ln of the lens's share of the light: a r^2 + b r^4, r from 0 in the middle to 1 in the corners of a frame.

    shape: (rows, columns) of the frame in pixels; powers: (a, b).
    """

    shape: tuple[int, int]
    powers: tuple[float, float]

    @classmethod
    def of(cls, illumination: Floats32, shape: tuple[int, int]) -> "Falloff":
        """Of a frame's relative illumination, NaN where it is unlit, by least squares.

        illumination: spread evenly over the frame, such as (rows, columns), or (rows, 3 columns) of a picture in colours.
        """
        places = [
            np.unique(np.linspace(0, n - 1, SAMPLES).round().astype(int))
            for n in illumination.shape
        ]
        rows, columns = (
            at // (n // side)
            for at, n, side in zip(places, illumination.shape, shape, strict=True)
        )
        seen, r2 = (
            illumination[np.ix_(*places)].astype(np.float64),
            _square(shape, rows, columns),
        )
        lit = seen > 0
        terms = np.stack([np.ones(lit.sum()), r2[lit], r2[lit] ** 2], axis=1)
        _, a, b = np.linalg.lstsq(terms, np.log(seen[lit]), rcond=None)[0]
        return cls(shape, (float(a), float(b)))

    def at(self, cut: Cut) -> Floats:
        """(rows, columns) relative light, 1 in the middle, of a cut of the frame."""
        rows, columns = (
            np.arange(n, dtype=np.float64)[part]
            for n, part in zip(self.shape, cut, strict=True)
        )
        r2 = _square(self.shape, rows, columns)
        return np.asarray(np.exp(self.powers[0] * r2 + self.powers[1] * r2**2))


def _square(shape: tuple[int, int], rows: Floats, columns: Floats) -> Floats:
    """r^2 of rows and columns of a frame, each by each."""
    middle = [(n - 1) / 2 for n in shape]
    away = (rows[:, None] - middle[0]) ** 2 + (columns[None, :] - middle[1]) ** 2
    return np.asarray(away / max(sum(m**2 for m in middle), 1.0))
