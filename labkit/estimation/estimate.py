"""What the fits of a session come to: a wavefront for every observation, and the lens that they have in common."""

from __future__ import annotations

from dataclasses import dataclass, replace

from labkit.estimation.candidate import Observed
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.lens_model import DEFOCUS, Reading
from labkit.estimation.local import Found, Optimum
from labkit.estimation.observation import Observation
from labkit.imaging.optics import Optics
from labkit.results.model import PartTried


@dataclass(frozen=True)
class LocalFit:
    """An observation with its chosen optimum.

    Attributes
    ----------
    observation : its frames
    optimum : the chosen one, with the session's sign
    found : what the searches for it met
    """

    observation: Observation
    optimum: Optimum
    found: Found

    @property
    def channel(self) -> str:
        """Of the observation."""
        return self.observation.channel

    @property
    def optics(self) -> Optics:
        """Of the optimum."""
        return self.optimum.optics

    @property
    def label(self) -> str:
        """Channel and range, in words."""
        return self.observation.key.label

    @property
    def ranged(self) -> bool:
        """Whether it bears on the lens."""
        return is_ranged(self.observation, self.optimum.noll)

    def with_optimum(self, optimum: Optimum) -> LocalFit:
        """The same at another optimum."""
        return replace(self, optimum=optimum)


@dataclass(frozen=True)
class Estimate:
    """All fits of a session, in the order of its observations.

    Attributes
    ----------
    fits : of those observations that have one
    lens : in common; None where no ranges, or no defocus, are there to determine one
    rows : place of each fit among the observations of `lens`, None where it bears on none
    members : fits that the lens is made of; the others are outliers
    outliers : fits that do not belong to the session
    refitted_members : fits that were made again from what the others predict, and then belonged
    open_channels : channels whose signs the ranges leave open
    tried : camera parts that the fits were asked about
    missing : camera parts that the fits show and their model lacks
    with_missing : fits with the missing parts, None where there is none
    stated_camera : the session without the parts that its plan does not state, where some were found
    lost : why observations have no fit, in words
    """

    fits: tuple[LocalFit, ...]
    lens: LensFit | None = None
    rows: tuple[int | None, ...] = ()
    members: tuple[int, ...] = ()
    outliers: tuple[int, ...] = ()
    refitted_members: tuple[int, ...] = ()
    open_channels: tuple[str, ...] = ()
    tried: tuple[PartTried, ...] = ()
    missing: tuple[str, ...] = ()
    with_missing: tuple[Optimum | None, ...] = ()
    stated_camera: Estimate | None = None
    lost: tuple[str, ...] = ()

    @property
    def trusted(self) -> tuple[int, ...]:
        """The members, or all fits where there is no lens to belong to."""
        return self.members or tuple(range(len(self.fits)))

    def with_stated_camera(self, k: int) -> LocalFit | None:
        """Fit k without the parts that were found; None where none was, or memory was too short for some."""
        plain = self.stated_camera
        return None if plain is None or len(plain.fits) != len(self.fits) else plain.fits[k]

    def with_all_parts(self, k: int) -> Optimum:
        """Optimum of fit k with what its model lacks, where there is one."""
        with_missing = self.with_missing[k] if self.with_missing else None
        return self.fits[k].optimum if with_missing is None else with_missing


def is_ranged(observation: Observation, noll: tuple[int, ...]) -> bool:
    """Whether an observation bears on the lens: its range is known, and defocus is fitted."""
    return observation.measured_range_mm is not None and DEFOCUS in noll


def reading_of(observation: Observation) -> Reading:
    """Where the rail stood for an observation of known range."""
    assert observation.measured_range_mm is not None
    station = observation.measured_range_mm if observation.range_mm is None else observation.range_mm
    return Reading(observation.key, observation.measured_range_mm, station, observation.homings)


def observed(observation: Observation, found: Found | None) -> Observed:
    """An observation as the selection takes it."""
    optima = () if found is None else found.optima
    usable = [optimum for optimum in optima if not optimum.verdict.undetermined]
    return Observed(reading_of(observation), tuple(optimum.candidate for optimum in usable))
