"""What the fits of a session come to."""

from __future__ import annotations

from dataclasses import dataclass

from labkit.analysis.lens_fit import LensFit
from labkit.analysis.local_fits import LocalFit
from labkit.results.model import PartTried


@dataclass(frozen=True)
class SessionFits:
    """All fits of a session, in the order of its observations, and the lens that they have in common.

    lens: None where no ranges, or no defocus, are there to determine one. members: which fits it is made of; the others were
    rejected, or do not belong to it, the strangers. mended: fits that were made again, because the session found them not to
    belong, and then did. open_channels: whose signs the ranges leave open. tried: parts of the camera that the fits were asked
    about; missing: those that the fits call for and that their model lacks, with_missing: fits with them, None where there is
    none. without_found: the same session without the parts that its plan does not state, where some were taken in. lost:
    observations that have no fit, in words.
    """

    fits: tuple[LocalFit, ...]
    lens: LensFit | None = None
    members: tuple[int, ...] = ()
    strangers: tuple[int, ...] = ()
    mended: tuple[int, ...] = ()
    open_channels: tuple[str, ...] = ()
    tried: tuple[PartTried, ...] = ()
    missing: tuple[str, ...] = ()
    with_missing: tuple[LocalFit | None, ...] = ()
    without_found: SessionFits | None = None
    lost: tuple[str, ...] = ()

    @property
    def trusted(self) -> tuple[int, ...]:
        """The members, or all fits where there is no lens to belong to."""
        return self.members or tuple(range(len(self.fits)))

    def unaided(self, k: int) -> LocalFit | None:
        """Fit k without the parts that were found; None where none was, or memory was too short for some."""
        plain = self.without_found
        return None if plain is None or len(plain.fits) != len(self.fits) else plain.fits[k]

    def fullest(self, k: int) -> LocalFit:
        """Fit k with what its model lacks, where there is one."""
        with_missing = self.with_missing[k] if self.with_missing else None
        return self.fits[k] if with_missing is None else with_missing
