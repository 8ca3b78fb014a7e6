"""The pupil's rim over the frame: away from the middle, the edge of another lens element cuts the pupil to a cat's eye."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labkit.optics.rim import ROUND, Circle, Rim

Place = tuple[float, float]
"""(y, x) of a point of the frame from its middle, over half its diagonal."""

FRAME_MIDDLE: Place = (0.0, 0.0)


@dataclass(frozen=True)
class Vignetting:
    """A circle that cuts the pupil, and whose shift changes linearly over the frame.

    Lengths are in units of the full pupil's radius.

    Attributes
    ----------
    along : shift of its centre in the frame's corners, along the image height
    right, down : shift in the middle of the frame, which a centred lens does not have
    size : radius
    """

    along: float = 0.0
    right: float = 0.0
    down: float = 0.0
    size: float = 1.0

    def circle(self, place: Place) -> Circle:
        """Return the circle as seen from a place."""
        right, down = self.right + self.along * place[1], self.down + self.along * place[0]
        shift = float(np.hypot(right, down))
        return Circle(shift, self.size, float(np.arctan2(down, right)))

    def onto(self, rim: Rim, place: Place) -> Rim:
        """Return the rim of the pupil as seen from a place."""
        circle = self.circle(place)
        if circle.size - circle.shift >= 1:
            return rim
        return replace(rim, cuts=(*rim.cuts, Circle(), circle))


@dataclass(frozen=True)
class FieldRim:
    """The rim at every place of the frame.

    Attributes
    ----------
    middle : what all places have in common
    vignetting : the circle that cuts the pupil off the middle; None without one
    uneven : second and third harmonic of the radius along the image height in the frame's corners, relative: these grow with
        the square and the cube of the height
    """

    middle: Rim = ROUND
    vignetting: Vignetting | None = None
    uneven: tuple[float, float] = (0.0, 0.0)

    def at(self, place: Place) -> Rim:
        """Return the rim as seen from a place."""
        rim = self.middle
        if any(self.uneven):
            rim = replace(rim, uneven=harmonics(*self.uneven, place))
        return rim if self.vignetting is None else self.vignetting.onto(rim, place)


ROUND_EVERYWHERE = FieldRim()


def harmonics(second: float, third: float, place: Place) -> tuple[float, ...]:
    """Return the (4,) harmonics at a place, as of `labkit.optics.rim.Rim`, of an unevenness as of `FieldRim`."""
    height = complex(place[1], place[0])
    along = second * height**2, third * height**3
    return along[0].real, along[0].imag, along[1].real, along[1].imag
