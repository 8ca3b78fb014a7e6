"""Was the lens touched half-way? A session whose fits follow one lens before a moment and another after it."""

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
    last_mm, next_mm : stations between which it happened, in the order of their photographs
    before, after : the session in two parts
    """

    last_mm: float
    next_mm: float
    before: Estimate
    after: Estimate


def find_change(session: Estimate, stated: Stated) -> Change | None:
    """Find the moment at which parting the session makes its fits agree.

    None where they agree as they are, or nowhere.
    """
    places = [k for k, fit in enumerate(session.fits) if fit.ranged and not fit.optimum.verdict.undetermined]
    if session.lens is None or (session.lens.model.laws.paraxial and not session.outliers):
        return None
    order = sorted(places, key=lambda k: session.fits[k].observation.order)
    observed = {k: _observed(session, k) for k in places}
    stations = list(dict.fromkeys(observed[k].reading.station for k in order))
    k = parting([observed[k] for k in places], stations, stated)
    if k is None:
        return None
    before, after = (
        [place for place in places if observed[place].reading.station in part] for part in (stations[:k], stations[k:])
    )
    return Change(stations[k - 1], stations[k], _part(session, before, stated), _part(session, after, stated))


def parting(observed: Sequence[Observed], stations: Sequence[float], stated: Stated) -> int | None:
    """How many stations, in the order of their photographs, come before a change of the lens; None where none is seen."""
    if len(stations) < 3:
        return None
    whole = _whole(observed, stated).lens
    parted = [
        sum(
            _whole([one for one in observed if one.reading.station in part], stated).lens.chi2
            for part in (stations[:k], stations[k:])
        )
        for k in range(1, len(stations))
    ]
    least = min(parted)
    changed = whole.chi2 > SETTINGS.parted_chi2 * max(least, whole.freedom)
    return 1 + parted.index(least) if changed else None


def _whole(observed: Sequence[Observed], stated: Stated) -> Selection:
    """The lens of observations that all belong, held to all its laws."""
    return select(observed, stated, everyone=True)


def _observed(session: Estimate, k: int) -> Observed:
    """The chosen optimum of a fit, with what its model lacks."""
    return Observed(reading_of(session.fits[k].observation), (session.with_all_parts(k).candidate,))


def _part(session: Estimate, places: Sequence[int], stated: Stated) -> Estimate:
    """A part of a session, its errors as the whole has them. places: of its fits."""
    fits = [session.fits[k] for k in places]
    candidates = [Observed(reading_of(fit.observation), (fit.optimum.candidate,)) for fit in fits]
    selection = _whole(candidates, stated)
    turned = [_turned(fit, int(choice)) for fit, choice in zip(fits, selection.choice, strict=True)]
    every = tuple(range(len(turned)))
    return replace(
        session,
        fits=tuple(turned),
        lens=selection.lens,
        rows=every,
        members=every,
        outliers=(),
        refitted_members=(),
        with_missing=tuple(session.with_missing[k] for k in places if session.with_missing),
        stated_camera=None,
    )


def _turned(fit: LocalFit, choice: int) -> LocalFit:
    return fit.with_optimum(fit.optimum.twin()) if choice % 2 else fit
