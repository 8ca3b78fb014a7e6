"""The estimate of a session: a wavefront for every observation, and one lens for all."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.estimation.candidate import Observed, Reading, mostly_unexplained
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.local import Found, Optimum
from labkit.estimation.observation import Observation
from labkit.imaging.optics import Optics
from labkit.optics.wavefront import DEFOCUS
from labkit.results.model import PartTried


@dataclass(frozen=True)
class LocalFit:
    """An observation with its chosen optimum.

    Attributes
    ----------
    observation : the frames
    optimum : the chosen optimum, with the session's sign
    found : all optima of the searches
    """

    observation: Observation
    optimum: Optimum
    found: Found

    @property
    def channel(self) -> str:
        """Channel of the observation."""
        return self.observation.channel

    @property
    def optics(self) -> Optics:
        """Optics at the optimum."""
        return self.optimum.optics

    @property
    def label(self) -> str:
        """Channel and range, in words."""
        return self.observation.key.label

    @property
    def ranged(self) -> bool:
        """Return whether the fit contributes to the lens."""
        return is_ranged(self.observation, self.optimum.noll)


@dataclass(frozen=True)
class Estimate:
    """All fits of a session, in the order of its observations.

    Attributes
    ----------
    fits : a fit for each observation but the lost ones
    lens : the common lens; None if ranges are unknown or defocus is not fitted
    members : places of the fits from which the lens is estimated
    outliers : places of fits that contradict the lens
    refitted_members : places of members that were outliers until they were refitted from the session's prediction
    signed : places of the fits whose sign the session determines; of all others the twin is as likely
    tried : camera parts that the fits were tested for
    missing : camera parts that the fits show and the model lacks
    with_missing : optima with the missing parts, None where not fitted
    stated_camera : the session without the camera parts that the plan does not state; None if no part was added
    lost : for each observation without a fit, a sentence with the reason
    """

    fits: tuple[LocalFit, ...]
    lens: LensFit | None = None
    members: tuple[int, ...] = ()
    outliers: tuple[int, ...] = ()
    refitted_members: tuple[int, ...] = ()
    signed: tuple[int, ...] = ()
    tried: tuple[PartTried, ...] = ()
    missing: tuple[str, ...] = ()
    with_missing: tuple[Optimum | None, ...] = ()
    stated_camera: Estimate | None = None
    lost: tuple[str, ...] = ()

    @property
    def trusted(self) -> tuple[int, ...]:
        """The members, or all fits if there is no lens."""
        return self.members or tuple(range(len(self.fits)))

    @property
    def incomplete(self) -> bool:
        """Return whether the model is incomplete for all photographs: residuals of most fits are not noise alone."""
        return mostly_unexplained(fit.optimum.verdict.accepted for fit in self.fits)

    def row(self, k: int) -> int:
        """Return the place of fit k, which contributes to the lens, among the lens's observations."""
        assert self.lens is not None
        return self.lens.model.rows[self.fits[k].observation.key]

    def with_stated_camera(self, k: int) -> LocalFit | None:
        """Return fit k without the parts added; None if no part was, or if memory was too short for some fits."""
        plain = self.stated_camera
        return None if plain is None or len(plain.fits) != len(self.fits) else plain.fits[k]

    def with_all_parts(self, k: int) -> Optimum:
        """Return the optimum of fit k with the missing parts in its model, or the chosen optimum if no part is missing."""
        with_missing = self.with_missing[k] if self.with_missing else None
        return self.fits[k].optimum if with_missing is None else with_missing


def is_ranged(observation: Observation, noll: tuple[int, ...]) -> bool:
    """Return whether an observation contributes to the lens: its range is known, and defocus is fitted."""
    return observation.measured_range_mm is not None and DEFOCUS in noll


def reading_of(observation: Observation) -> Reading:
    """Return the rail's position for an observation of known range."""
    assert observation.measured_range_mm is not None
    station = (
        observation.measured_range_mm
        if observation.range_mm is None
        else observation.range_mm
    )
    return Reading(
        observation.key,
        observation.measured_range_mm,
        station,
        observation.homings,
        observation.place,
    )


def observed(observation: Observation, found: Found | None) -> Observed:
    """Return an observation with its candidates for the selection: optima that determine all modes."""
    optima = found.determined if found else []
    return Observed(reading_of(observation), tuple(one.candidate for one in optima))
