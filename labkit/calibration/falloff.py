"""Separate the lens's fall-off, symmetric about the middle of the frame, from the target's illumination.

The two act differently: the lens blurs the target's light together with its illumination,
while the fall-off multiplies the blurred image.
"""

from dataclasses import dataclass

import numpy as np

from labkit.photographs.photograph import Cut
from labkit.types import Floats, Floats32

FALLOFF_SAMPLES = 100  # along each side of the frame: light is smooth


@dataclass(frozen=True, slots=True)
class Falloff:
    """ln of the lens's share of the light: a r^2 + b r^4, r from 0 in the middle to 1 in the corners of a frame.

    shape: (rows, columns) of the frame in pixels; powers: (a, b).
    """

    shape: tuple[int, int]
    powers: tuple[float, float]

    @classmethod
    def of(cls, illumination: Floats32, shape: tuple[int, int]) -> "Falloff":
        """Fit the fall-off to a frame's relative illumination, NaN where unlit, by least squares.

        illumination: evenly spread over the frame, such as (rows, columns), or (rows, 3
        columns) of a picture in colours
        """
        places = [
            np.unique(np.linspace(0, n - 1, FALLOFF_SAMPLES).round().astype(int))
            for n in illumination.shape
        ]
        rows, columns = (
            at // (n // side)
            for at, n, side in zip(places, illumination.shape, shape, strict=True)
        )
        seen = illumination[np.ix_(*places)].astype(np.float64)
        r2 = _square(shape, rows, columns)
        lit = seen > 0
        terms = np.stack([np.ones(lit.sum()), r2[lit], r2[lit] ** 2], axis=1)
        _, a, b = np.linalg.lstsq(terms, np.log(seen[lit]), rcond=None)[0]
        return cls(shape, (float(a), float(b)))

    def at(self, cut: Cut) -> Floats:
        """Return the (rows, columns) relative light of a cut of the frame, 1 in the middle of the frame."""
        rows, columns = (
            np.arange(n, dtype=np.float64)[part]
            for n, part in zip(self.shape, cut, strict=True)
        )
        r2 = _square(self.shape, rows, columns)
        return np.asarray(np.exp(self.powers[0] * r2 + self.powers[1] * r2**2))


def _square(shape: tuple[int, int], rows: Floats, columns: Floats) -> Floats:
    """Return r^2 for all pairs of the rows and columns of a frame."""
    middle = [(n - 1) / 2 for n in shape]
    away = (rows[:, None] - middle[0]) ** 2 + (columns[None, :] - middle[1]) ** 2
    return np.asarray(away / max(sum(m**2 for m in middle), 1.0))
