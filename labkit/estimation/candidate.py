"""An optimum of one observation's likelihood, as the session sees it: a Gaussian, how likely it is, how well it explains."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from labkit.estimation.lens_model import Reading
from labkit.estimation.settings import SETTINGS
from labkit.optics.zernike import twin_signs
from labkit.types import Floats


@dataclass(frozen=True)
class Measured:
    """What frames of one observation say about an optimum: a Gaussian.

    Attributes
    ----------
    noll : modes
    values : (values,) modes in waves RMS, numbers of the parts, ln of the cone's f-number, ln of the picture's scale (sensor
        over target, mm per mm, the mean of all directions)
    covariance : (values, values) of photons, read noise and calibration, without a prior on the f-number
    calibration : (values, values) part of it that the flats' errors make
    foreshortening : ln of the scale along the line on which a tilted target does not recede, less the mean's; and its error
    parts : labels of the parts' numbers
    model : (values, values) part of the covariance by residuals that are not noise alone, empty without
    """

    noll: tuple[int, ...]
    values: Floats
    covariance: Floats
    calibration: Floats
    foreshortening: tuple[float, float] = (0.0, 0.0)
    parts: tuple[str, ...] = ()
    model: Floats = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def waves(self) -> Floats:
        """(modes,) of the values."""
        return self.values[: len(self.noll)]

    @property
    def signs(self) -> Floats:
        """(values,) -1 for the even modes, which change sign in the twin, +1 for all else (thesis §3.6)."""
        signs = np.ones(len(self.values))
        signs[: len(self.noll)] = twin_signs(self.noll)
        return signs

    def labelled(self, parts: tuple[str, ...]) -> Measured:
        """The same with numbers of more parts, of which nothing was measured: some channels have light of a known width."""
        if parts == self.parts:
            return self
        modes, size = len(self.noll), len(self.noll) + len(parts) + 2
        at = [*range(modes), *(modes + parts.index(label) for label in self.parts), size - 2, size - 1]
        values = np.zeros(size)
        values[at] = self.values
        covariance = np.eye(size) * SETTINGS.unknown**2
        covariance[np.ix_(at, at)] = self.covariance
        calibration = np.zeros((size, size))
        calibration[np.ix_(at, at)] = self.calibration
        model = np.zeros((size, size)) if self.model.size else self.model
        if self.model.size:
            model[np.ix_(at, at)] = self.model
        return replace(self, values=values, covariance=covariance, calibration=calibration, model=model, parts=parts)

    def twin(self) -> Measured:
        """The same with the even modes reversed: the same pictures."""
        both = np.outer(self.signs, self.signs)
        return replace(
            self,
            values=self.values * self.signs,
            covariance=self.covariance * both,
            calibration=self.calibration * both,
            model=self.model * both if self.model.size else self.model,
        )


@dataclass(frozen=True)
class Candidate:
    """One optimum of an observation.

    Attributes
    ----------
    measured : Gaussian about it, its errors as its residuals have them
    log_likelihood : beside the observation's other candidates
    explained : whether what is left of the data is noise alone
    """

    measured: Measured
    log_likelihood: float = 0.0
    explained: bool = True


@dataclass(frozen=True)
class Observed:
    """An observation with its candidates, none before it is fitted."""

    reading: Reading
    candidates: tuple[Candidate, ...] = ()
