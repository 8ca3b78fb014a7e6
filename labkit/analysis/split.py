"""Was the lens touched half-way? A session whose fits follow one lens before a moment and another after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from labkit.analysis.lens_fit import LensFit, fit_lens
from labkit.analysis.lens_model import Member, Stated
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.twins import choose_twins, twin
from labkit.finding import Finding
from labkit.findings import found

LEAST_STOPS = 3
FEWER = 5.0  # by which chi2 must fall where the session is parted: a touched lens leaves hundreds of times its errors


@dataclass(frozen=True)
class Change:
    """Between which stops, mm in the order of their photographs, and the fits before and after it."""

    last_mm: float
    next_mm: float
    before: SessionFits
    after: SessionFits


def changes(change: Change | None) -> list[Finding]:
    """What a session that is fitted as one reports of its change, where there is one."""
    return [] if change is None else [found("lens-changed", last_mm=change.last_mm, next_mm=change.next_mm)]


def find_change(session: SessionFits, stated: Stated) -> Change | None:
    """The moment at which parting the session makes its fits agree; None where they agree as they are, or nowhere."""
    places = [k for k, f in enumerate(session.fits) if f.ranged and not f.fit.verdict.undetermined]
    fits = [session.fits[k] for k in places]
    if session.lens is None or (session.lens.model.paraxial and not session.strangers):
        return None
    first = sorted(fits, key=lambda f: f.task.observation.order)
    stops = list(dict.fromkeys(f.member.stop for f in first))
    k = parting([session.fullest(k).member for k in places], stops, stated)
    if k is None:
        return None
    before, after = ([p for p in places if session.fits[p].member.stop in part] for part in (stops[:k], stops[k:]))
    return Change(stops[k - 1], stops[k], *(_as_session(part, stated, session) for part in (before, after)))


def parting(members: Sequence[Member], stops: Sequence[float], stated: Stated) -> int | None:
    """How many of the stops, in the order of their photographs, come before a change of the lens; None where none is seen."""
    if len(stops) < LEAST_STOPS:
        return None
    whole = _lens(members, stated)[1]
    parted = [
        sum(_lens([m for m in members if m.stop in part], stated)[1].chi2 for part in (stops[:k], stops[k:]))
        for k in range(1, len(stops))
    ]
    least = min(parted)
    changed = whole.chi2 > FEWER * max(least, float(whole.freedom))
    return 1 + parted.index(least) if changed else None


def _lens(members: Sequence[Member], stated: Stated) -> tuple[list[int], LensFit]:
    """Signs of the members' right twins, and what they say of the lens, held to all its laws."""
    signs, _ = choose_twins(members, stated)
    return signs, fit_lens([twin(m, s) for m, s in zip(members, signs, strict=True)], stated)


def _as_session(places: Sequence[int], stated: Stated, whole: SessionFits) -> SessionFits:
    """A part of a session, its errors as the whole has them. places: of its fits."""
    fits = [whole.fits[k] for k in places]
    signs, _ = choose_twins([f.member for f in fits], stated)
    turned = [f if sign > 0 else replace(f, fit=f.fit.twin()) for f, sign in zip(fits, signs, strict=True)]
    lens = fit_lens([f.honest_member for f in turned], stated)
    with_missing = tuple(whole.with_missing[k] for k in places if whole.with_missing)
    members = tuple(range(len(turned)))
    return replace(
        whole,
        fits=tuple(turned),
        lens=lens,
        members=members,
        strangers=(),
        mended=(),
        with_missing=with_missing,
        without_found=None,
    )
