"""An optimum of one observation's likelihood, summarised for the session as a Gaussian measurement."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.estimation.settings import SETTINGS
from labkit.imaging.parts import KNOWN
from labkit.key import Key
from labkit.optics.zernike import twin_signs
from labkit.types import Floats


@dataclass(frozen=True, slots=True)
class Reading:
    """The rail's position for one observation.

    Attributes
    ----------
    key : identity of the observation
    range_mm : range by the rail's scale
    station : identity of the rail position; all observations at a station share one range error
    homings : for each photograph, how often the rail had been homed
    place : (y, x) of a tile's middle from the frame's centre, over half the frame's diagonal
    """

    key: Key
    range_mm: float
    station: float
    homings: tuple[int, ...] = ()
    place: tuple[float, float] = (0.0, 0.0)


def _twin_sign(label: str) -> float:
    """Return the factor of a part's number in the twin."""
    name, number = label.split(".")
    part = KNOWN.get(name)
    return 1.0 if part is None else part.twin_signs[part.labels.index(number)]


def value_signs(noll: tuple[int, ...], parts: tuple[str, ...]) -> Floats:
    """Return -1 for even modes and for odd numbers of the rim, which change sign in the twin (thesis §3.6), +1 for all else.

    noll, parts: as in `Measured`, whose (values,) these are
    """
    of_parts = [_twin_sign(label) for label in parts]
    return np.array([*twin_signs(noll), *of_parts, 1.0, 1.0])


@dataclass(frozen=True)
class Measured:
    """A Gaussian measurement: the likelihood of one observation's frames about an optimum.

    Attributes
    ----------
    noll : Noll's numbers of the modes
    values : (values,) modes in waves RMS, numbers of the parts, ln of the working f-number, ln of the picture's scale
        (sensor over target, mm per mm, averaged over all directions)
    covariance : (values, values) due to photons, read noise and calibration, without a prior on the f-number
    calibration : (values, values) part of the covariance due to errors of the flat frames
    foreshortening : ln of the scale along the tilt axis of the target less ln of the mean scale; and its standard error
    parts : labels of the parts' numbers
    stretch : by how much the target's picture is longer in one direction than across, see `Pose.log_stretch`
    model : (values, values) part of the covariance due to residuals that are not noise alone; (1, 1), 0 if they are noise
    """

    noll: tuple[int, ...]
    values: Floats
    covariance: Floats
    calibration: Floats
    foreshortening: tuple[float, float] = (0.0, 0.0)
    parts: tuple[str, ...] = ()
    stretch: tuple[float, float] = (0.0, 0.0)
    model: Floats = field(default_factory=lambda: np.zeros((1, 1)))

    @property
    def waves(self) -> Floats:
        """(modes,) wavefront in waves RMS."""
        return self.values[: len(self.noll)]

    @property
    def signs(self) -> Floats:
        """(values,) factors of the values in the twin, see `value_signs`."""
        return value_signs(self.noll, self.parts)

    def labelled(self, parts: tuple[str, ...]) -> Measured:
        """Add unmeasured numbers of further parts: channels with a known spectrum, for example, do not measure its width."""
        if parts == self.parts:
            return self
        modes = len(self.noll)
        size = len(self.noll) + len(parts) + 2
        known = [modes + parts.index(label) for label in self.parts]
        at = [*range(modes), *known, size - 2, size - 1]
        values = np.zeros(size)
        values[at] = self.values

        def widened(part: Floats, unknown: float = 0.0) -> Floats:
            whole = unknown**2 * np.eye(size)
            whole[np.ix_(at, at)] = part
            return whole

        return replace(
            self,
            values=values,
            covariance=widened(self.covariance, SETTINGS.unknown),
            calibration=widened(self.calibration),
            model=widened(self.model),
            parts=parts,
        )

    def twin(self) -> Measured:
        """Reverse the even modes: the twin makes the same pictures."""
        signs = self.signs
        both = np.outer(signs, signs)
        return replace(
            self,
            values=self.values * signs,
            covariance=self.covariance * both,
            calibration=self.calibration * both,
            model=self.model * both,
        )


@dataclass(frozen=True)
class Candidate:
    """One optimum of an observation.

    Attributes
    ----------
    measured : the Gaussian about the optimum; sandwich errors if the residuals are not noise alone
    log_likelihood : comparable with the observation's other candidates
    explained : whether the residuals are noise alone
    """

    measured: Measured
    log_likelihood: float = 0.0
    explained: bool = True

    def twin(self) -> Candidate:
        """Reverse the even modes: the twin is as likely."""
        return replace(self, measured=self.measured.twin())


def mostly_unexplained(explained: Iterable[bool]) -> bool:
    """Return whether the residuals of most fits are not noise alone: the model is then incomplete for all."""
    every = list(explained)
    return 2 * every.count(False) > len(every)


@dataclass(frozen=True)
class Observed:
    """An observation with its candidates; there is none before the first fit."""

    reading: Reading
    candidates: tuple[Candidate, ...] = ()

    def candidate(self, choice: int) -> Candidate:
        """Return candidate k for a choice 2 k, its twin for 2 k + 1."""
        place, twin = divmod(choice, 2)
        return self.candidates[place].twin() if twin else self.candidates[place]


def poor_model(observed: Iterable[Observed]) -> bool:
    """Return whether the model is incomplete for all: the residuals of most observations are not noise alone."""
    return mostly_unexplained(
        any(c.explained for c in one.candidates) for one in observed if one.candidates
    )
