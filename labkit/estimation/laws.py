"""Parameters of a session, prior knowledge of each, and how far observations may depart from the laws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from labkit.estimation.settings import SETTINGS

FOCAL_LENGTH = "focal length"
F_NUMBER = "f-number"
MAGNIFICATION = "pupil magnification"
RANGE_ZERO = "tape"  # a key of results.json, where a joint climb is compared
HOMING_LABEL = "homing"
STEPS_LABEL = "steps"
SIZE = "target size"
PIXEL_PITCH = "pixel pitch"
WORKING_F_NUMBER = "cone"
FOCUS = "best focus"
AXIAL_COLOUR = "axial colour"
LATERAL_COLOUR = "lateral colour"
WAVELENGTH = "wavelength"
PART = "part"
COMMON_MODE = "common mode"
WEAK_MODE = "weak common mode"
MODE = "mode"
FIELD_MODE = "mode over the field"
FIELD_CONE = "cone over the field"
FIELD_SCALE = "scale over the field"
FIELD_COLOUR = "colour over the field"
FIELD_TILT = "target's tilt over the field"

GEOMETRY = (
    FOCAL_LENGTH,
    F_NUMBER,
    MAGNIFICATION,
    RANGE_ZERO,
    HOMING_LABEL,
    STEPS_LABEL,
    SIZE,
    PIXEL_PITCH,
)
FIELD_KINDS = (FIELD_MODE, FIELD_CONE, FIELD_SCALE)
"""Terms of the field's expansion beyond its mean; `FIELD_COLOUR` is what each channel adds to those of the modes."""

OPEN = (
    FOCUS,
    AXIAL_COLOUR,
    LATERAL_COLOUR,
    PART,
    COMMON_MODE,
    WEAK_MODE,
    MODE,
    *FIELD_KINDS,
    FIELD_TILT,
)
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
    std, value : standard error and mean of the prior
    name : identity among parameters of one kind
    """

    kind: str
    std: float
    value: float = 0.0
    name: Name = ()

    @property
    def prior_std(self) -> float:
        """Standard error of the prior, above 0 for exact numbers too."""
        return max(self.std, SETTINGS.exact**2)


@dataclass(frozen=True, slots=True)
class Laws:
    """Tolerances of the laws: standard deviations by which observations may depart from the session's parameters.

    Attributes
    ----------
    mode_scatter : of each mode except defocus from range to range, waves RMS
    defocus_scatter : of each observation's defocus, waves RMS
    f_number_std : relative, of the working f-number that follows from the lens's conjugates, common to all observations
    f_number_scatter : relative, of each observation's working f-number
    size_scatter : relative, of each observation's size
    exact_light : whether all channels have the stated wavelengths but for rounding
    mistaken : column whose stated number is a mistake
    """

    mode_scatter: float = 0.0
    defocus_scatter: float = SETTINGS.defocus_floor_waves
    f_number_std: float = 0.0
    f_number_scatter: float = 0.0
    size_scatter: float = SETTINGS.size_floor
    exact_light: bool = False
    mistaken: Place | None = None

    @property
    def paraxial(self) -> bool:
        """Return whether working f-numbers and sizes follow from one lens that is focused as a whole."""
        return self.f_number_std == 0

    @property
    def shared(self) -> bool:
        """Return whether all modes except defocus are the same at all ranges."""
        return self.mode_scatter == 0

    @classmethod
    def looser(cls) -> Iterator[Laws]:
        """Yield laws with free working f-numbers and sizes, with modes that scatter from range to range, or with both.

        If the lens's modes differ, defocus still follows its law. If the model of the frames is incomplete, defocus scatters
        as the modes do.
        """
        free = cls(f_number_std=SETTINGS.loose, size_scatter=SETTINGS.loose)
        yield free
        for scatter in SETTINGS.mode_scatter_waves:
            yield cls(mode_scatter=scatter)
            yield replace(free, mode_scatter=scatter)
            yield replace(free, mode_scatter=scatter, defocus_scatter=scatter)

    @classmethod
    def loosest(cls) -> Laws:
        """Return laws with the largest tolerances."""
        most = SETTINGS.mode_scatter_waves[-1]
        return cls(most, most, SETTINGS.loose, SETTINGS.loose, SETTINGS.loose)

    def rough(self) -> Laws:
        """Return laws tolerant of every error that is too small for another optimum."""
        rough = SETTINGS.mode_scatter_waves[0]

        def rougher(scatter: float) -> float:
            return float(np.hypot(scatter, rough))

        return replace(
            self,
            mode_scatter=rougher(self.mode_scatter),
            defocus_scatter=rougher(self.defocus_scatter),
            f_number_scatter=rougher(self.f_number_scatter),
            size_scatter=rougher(self.size_scatter),
        )
