"""Detect a change of the lens during a session: fits follow one lens before a moment and another lens after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from labkit.estimation.candidate import Observed
from labkit.estimation.estimate import Estimate, LocalFit, reading_of
from labkit.estimation.select import Selection, select
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


def find_change(session: Estimate, stated: Stated) -> Change | None:
    """Find the moment at which the lens changed.

    Returns
    -------
    None if the fits agree without a change, or if no single change makes them agree
    """
    places = [
        k
        for k, fit in enumerate(session.fits)
        if fit.ranged and not fit.optimum.verdict.undetermined
    ]
    if session.lens is None or (session.lens.model.laws.paraxial and not session.outliers):
        return None
    order = sorted(places, key=lambda k: session.fits[k].observation.order)
    observed = {k: _observed(session, k) for k in places}
    stations = list(dict.fromkeys(observed[k].reading.station for k in order))
    k = parting([observed[k] for k in places], stations, stated)
    if k is None:
        return None
    before, after = (
        [place for place in places if observed[place].reading.station in part]
        for part in (stations[:k], stations[k:])
    )
    return Change(
        stations[k - 1],
        stations[k],
        _part(session, before, stated),
        _part(session, after, stated),
    )


def second_camp(session: Estimate, stated: Stated) -> bool:
    """Whether the outliers agree with each other: they follow a lens of their own, under all its laws."""
    observed = [_observed(session, k) for k in session.outliers]
    if len({one.reading.station for one in observed}) < 2:
        return False
    return _whole(observed, stated).lens.p_value >= SETTINGS.contradiction_chance


def parting(
    observed: Sequence[Observed], stations: Sequence[float], stated: Stated
) -> int | None:
    """Return the number of stations, in the order of their photographs, before a change; None if no change is detected."""
    if len(stations) < 3:
        return None
    whole = _whole(observed, stated).lens
    parted = [
        sum(
            _whole(
                [one for one in observed if one.reading.station in part], stated
            ).lens.chi2
            for part in (stations[:k], stations[k:])
        )
        for k in range(1, len(stations))
    ]
    least = min(parted)
    changed = whole.chi2 > SETTINGS.parted_chi2 * max(least, whole.degrees_of_freedom)
    return 1 + parted.index(least) if changed else None


def _whole(observed: Sequence[Observed], stated: Stated) -> Selection:
    """Select with all observations as members, under the strictest laws."""
    return select(observed, stated, everyone=True)


def _observed(session: Estimate, k: int) -> Observed:
    """Return the chosen optimum of a fit, with missing parts in its model."""
    return Observed(
        reading_of(session.fits[k].observation), (session.with_all_parts(k).candidate,)
    )


def _part(session: Estimate, places: Sequence[int], stated: Stated) -> Estimate:
    """Estimate a part of a session from some of its fits, with errors as for the whole session."""
    fits = [session.fits[k] for k in places]
    candidates = [
        Observed(reading_of(fit.observation), (fit.optimum.candidate,)) for fit in fits
    ]
    selection = _whole(candidates, stated)
    turned = [
        _turned(fit, int(choice))
        for fit, choice in zip(fits, selection.choice, strict=True)
    ]
    every = tuple(range(len(turned)))
    stations = {one.reading.station for one in candidates}
    return replace(
        session,
        fits=tuple(turned),
        lens=selection.lens,
        rows=every,
        members=every,
        outliers=(),
        refitted_members=(),
        signed=every if len(stations) > 1 else (),
        with_missing=tuple(session.with_missing[k] for k in places if session.with_missing),
        stated_camera=None,
    )


def _turned(fit: LocalFit, choice: int) -> LocalFit:
    return fit.with_optimum(fit.optimum.twin()) if choice % 2 else fit
