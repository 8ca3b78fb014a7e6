"""How far observations may depart from the laws of one lens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from labkit.estimation.columns import Place
from labkit.estimation.settings import SETTINGS


@dataclass(frozen=True, slots=True)
class Laws:
    """Tolerances of the laws: standard deviations by which observations may depart from the session's parameters.

    Attributes
    ----------
    mode_scatter : of each mode except defocus from range to range, waves RMS
    defocus_scatter : of each observation's defocus, waves RMS
    cone_std : relative, of the working f-number that follows from the lens's conjugates, common to all observations
    cone_scatter : relative, of each observation's working f-number
    size_scatter : relative, of each observation's size
    mistaken : column whose stated number is a mistake
    """

    mode_scatter: float = 0.0
    defocus_scatter: float = SETTINGS.defocus_floor_waves
    cone_std: float = 0.0
    cone_scatter: float = 0.0
    size_scatter: float = SETTINGS.size_floor
    mistaken: Place | None = None

    @property
    def paraxial(self) -> bool:
        """Whether working f-numbers and sizes follow from one lens that is focused as a whole."""
        return self.cone_std == 0

    @property
    def shared(self) -> bool:
        """Whether all modes except defocus are the same at all ranges."""
        return self.mode_scatter == 0

    @classmethod
    def looser(cls) -> Iterator[Laws]:
        """Yield laws with free working f-numbers and sizes, with modes that scatter from range to range, or with both.

        If the lens's modes differ, defocus still follows its law. If the model of the frames is incomplete, defocus scatters
        as the modes do.
        """
        free = cls(cone_std=SETTINGS.loose, size_scatter=SETTINGS.loose)
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
        return replace(
            self,
            mode_scatter=float(np.hypot(self.mode_scatter, SETTINGS.rough)),
            defocus_scatter=float(np.hypot(self.defocus_scatter, SETTINGS.rough)),
            cone_scatter=float(np.hypot(self.cone_scatter, SETTINGS.rough)),
            size_scatter=float(np.hypot(self.size_scatter, SETTINGS.rough)),
        )
