"""Detect a change of the lens during a session: fits follow one lens before a moment and another lens after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from labkit.estimation.candidate import Observed
from labkit.estimation.estimate import Estimate, reading_of
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.select import select
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import Stated


@dataclass(frozen=True)
class Change:
    """A change of the lens.

    Attributes
    ----------
    last_mm, next_mm : stations before and after the change, in the order of their photographs
    before, after : estimates of the two parts of the session
    """

    last_mm: float
    next_mm: float
    before: Estimate
    after: Estimate


def find_change(session: Estimate) -> Change | None:
    """Find the moment at which the lens changed.

    Returns
    -------
    None if the fits agree without a change, or if no single change makes them agree
    """
    lens = session.lens
    if lens is None or (lens.model.laws.paraxial and not session.outliers):
        return None
    observed = {
        k: _observed(session, k)
        for k, fit in enumerate(session.fits)
        if fit.ranged and not fit.optimum.verdict.undetermined
    }
    order = sorted(observed, key=lambda k: session.fits[k].observation.order)
    stations = list(dict.fromkeys(observed[k].reading.station for k in order))
    k = parting([*observed.values()], stations, lens.model.stated)
    if k is None:
        return None
    before, after = (
        _part(session, [i for i in observed if observed[i].reading.station in part], lens)
        for part in (stations[:k], stations[k:])
    )
    return Change(stations[k - 1], stations[k], before, after)


def second_camp(session: Estimate) -> bool:
    """Return whether the outliers agree with each other: they follow a lens of their own, under all its laws."""
    observed = [_observed(session, k) for k in session.outliers]
    if session.lens is None or len({one.reading.station for one in observed}) < 2:
        return False
    lens = select(observed, session.lens.model.stated, everyone=True).lens
    return lens.p_value >= SETTINGS.contradiction_chance


def parting(
    observed: Sequence[Observed], stations: Sequence[float], stated: Stated
) -> int | None:
    """Return the number of stations, in the order of their photographs, before a change; None if no change is detected."""

    def lens_at(part: Sequence[float]) -> LensFit:
        here = [one for one in observed if one.reading.station in part]
        return select(here, stated, everyone=True).lens

    if len(stations) < 3:
        return None
    whole = lens_at(stations)
    parted = [
        lens_at(stations[:k]).chi2 + lens_at(stations[k:]).chi2
        for k in range(1, len(stations))
    ]
    least = min(parted)
    changed = whole.chi2 > SETTINGS.parted_chi2 * max(least, whole.degrees_of_freedom)
    return 1 + parted.index(least) if changed else None


def _observed(session: Estimate, k: int) -> Observed:
    """Return the chosen optimum of a fit, with missing parts in its model."""
    reading = reading_of(session.fits[k].observation)
    return Observed(reading, (session.with_all_parts(k).candidate,))


def _part(session: Estimate, places: Sequence[int], whole: LensFit) -> Estimate:
    """Estimate a part of a session from some of its fits, with errors as for the whole session."""
    fits = [session.fits[k] for k in places]
    candidates = [
        Observed(reading_of(fit.observation), (fit.optimum.candidate,)) for fit in fits
    ]
    selection = select(candidates, whole.model.stated, everyone=True)
    signed = [
        replace(fit, optimum=fit.optimum.twin()) if choice % 2 else fit
        for fit, choice in zip(fits, selection.choice, strict=True)
    ]
    every = tuple(range(len(signed)))
    stations = {one.reading.station for one in candidates}
    return replace(
        session,
        fits=tuple(signed),
        lens=selection.lens,
        members=every,
        outliers=(),
        refitted_members=(),
        signed=every if len(stations) > 1 else (),
        with_missing=tuple(session.with_missing[k] for k in places if session.with_missing),
        stated_camera=None,
    )
