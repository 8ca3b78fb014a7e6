"""Where the lens puts the image: distortion and lateral colour, as results keep them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from labkit.types import Floats
from labkit.uncertain import Uncertain


@dataclass(frozen=True, eq=False)
class Distortion:
    """Radial distortion by the places of tiles: r becomes r (1 + k1 r² + k2 r⁴).

    Parameters
    ----------
    k1_per_mm2 : relative growth of the image for each mm² of image height squared
    k2_per_mm4 : of fifth order; None where the places do not ask for it
    centre_px : (2,) row and column of the distortion's centre, and covariance (2, 2); None for a
        lens without significant distortion
    residual_px : RMS of the coordinates of the tiles' middles about the model
    """

    k1_per_mm2: Uncertain
    k2_per_mm4: Uncertain | None
    centre_px: tuple[Floats, Floats] | None
    residual_px: float

    def as_json(self) -> dict[str, Any]:
        """Return the numbers with their errors; without None."""
        numbers: dict[str, Any] = {"k1_per_mm2": self.k1_per_mm2.as_json()}
        if self.k2_per_mm4 is not None:
            numbers["k2_per_mm4"] = self.k2_per_mm4.as_json()
        if self.centre_px is not None:
            numbers["centre_px"] = _pair(*self.centre_px)
        return numbers | {"residual_px": self.residual_px}


@dataclass(frozen=True, eq=False)
class LateralColour:
    """A channel's image against the reference channel's: larger by `scale`, and shifted.

    Parameters
    ----------
    scale : relative
    shift_um : (2,) on the sensor in the middle of the frame, down and right
    shift_covariance_um2 : (2, 2)
    """

    scale: Uncertain
    shift_um: Floats
    shift_covariance_um2: Floats

    def as_json(self) -> dict[str, Any]:
        """Return the numbers with their errors."""
        shift = _pair(self.shift_um, self.shift_covariance_um2)
        return {"scale": self.scale.as_json(), "shift_um": shift}


@dataclass(frozen=True, eq=False)
class ImageGeometry:
    """Distortion, and lateral colour of each channel but the reference."""

    distortion: Distortion
    lateral_colour: dict[str, LateralColour]

    def as_json(self) -> dict[str, Any]:
        """Return both as results.json keeps them."""
        colours = self.lateral_colour.items()
        return {
            "distortion": self.distortion.as_json(),
            "lateral_colour": {name: colour.as_json() for name, colour in colours},
        }


def _pair(value: Floats, covariance: Floats) -> dict[str, Any]:
    """Return two numbers with their covariance."""
    return {
        "value": np.asarray(value).tolist(),
        "covariance": np.asarray(covariance).tolist(),
    }
