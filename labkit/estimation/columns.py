"""Parameters of a session: their kinds, and what is known of each before the session."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.estimation.settings import SETTINGS

FOCAL_LENGTH = "focal length"
F_NUMBER = "f-number"
MAGNIFICATION = "pupil magnification"
RANGE_ZERO = "tape"  # a key of results.json, where a joint climb is compared
HOMING = "homing"
STEPS = "steps"
SIZE = "target size"
PITCH = "pixel pitch"
CONE = "cone"
FOCUS = "best focus"
AXIAL_COLOUR = "axial colour"
LATERAL_COLOUR = "lateral colour"
WAVELENGTH = "wavelength"
PART = "part"
COMMON_MODE = "common mode"
MODE = "mode"

GEOMETRY = (FOCAL_LENGTH, F_NUMBER, MAGNIFICATION, RANGE_ZERO, HOMING, STEPS, SIZE, PITCH)
OPEN = (FOCUS, AXIAL_COLOUR, LATERAL_COLOUR, PART, COMMON_MODE, MODE)
"""Columns that are unknown before the session: their prior is not a measurement."""

Name = tuple[str | float, ...]
Place = tuple[str, Name]
"""Kind and name of a column."""


@dataclass(frozen=True, slots=True)
class Column:
    """A parameter of the session.

    Attributes
    ----------
    kind : kind of the parameter
    name : identity among parameters of one kind
    value, std : mean and standard error of the prior
    scale : a significant step of the parameter
    """

    kind: str
    name: Name
    value: float
    std: float
    scale: float

    @property
    def prior_std(self) -> float:
        """Standard error of the prior, above 0."""
        return max(self.std, SETTINGS.exact * self.scale)
