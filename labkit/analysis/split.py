"""Was the lens touched half-way? A session whose fits follow one lens before a moment and another after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from labkit.analysis.lens_fit import LensFit, fit_lens
from labkit.analysis.lens_model import Member, Stated
from labkit.analysis.twins import choose_twins, twin
from labkit.analysis.wavefronts import LocalFit, SessionFits

LEAST_STOPS = 3
FEWER = 5.0  # by which chi2 must fall where the session is parted: a touched lens leaves hundreds of times its errors


@dataclass(frozen=True)
class Change:
    """Between which stops, mm in the order of their photographs, and the fits before and after it."""

    last_mm: float
    next_mm: float
    before: SessionFits
    after: SessionFits

    def __str__(self) -> str:
        return (
            f"the lens or its focus was changed between {self.last_mm:g} and {self.next_mm:g} mm, as the photographs were "
            "taken: the ranges before and after it follow two lenses; `labkit fit --split` fits them apart"
        )


def find_change(session: SessionFits, stated: Stated) -> Change | None:
    """The moment at which parting the session makes its fits agree; None where they agree as they are, or nowhere."""
    fits = [f for f in session.fits if f.ranged and not f.fit.verdict.undetermined]
    stops = sorted(
        {f.member.stop for f in fits}, key=lambda stop: min(_order(f) for f in fits if f.member.stop == stop)
    )
    if session.lens is None or len(stops) < LEAST_STOPS or (session.lens.model.paraxial and not session.strangers):
        return None
    whole = _lens(fits, stated)[1]
    parted = []
    for k in range(1, len(stops)):
        parts = [[f for f in fits if f.member.stop in some] for some in (stops[:k], stops[k:])]
        parted.append((sum(_lens(part, stated)[1].chi2 for part in parts), k, parts))
    best, k, parts = min(parted, key=lambda entry: entry[0])
    if whole.chi2 < FEWER * max(best, float(whole.freedom)):
        return None
    before, after = (_as_session(part, stated) for part in parts)
    return Change(stops[k - 1], stops[k], before, after)


def _order(local: LocalFit) -> int:
    return local.task.observation.order


def _lens(fits: Sequence[LocalFit], stated: Stated) -> tuple[list[LocalFit], LensFit]:
    """The fits with their twins chosen, and what they say of the lens, held to all its laws."""
    members: list[Member] = [f.member for f in fits]
    signs, _ = choose_twins(members, stated)
    turned = [f if sign > 0 else replace(f, fit=f.fit.twin()) for f, sign in zip(fits, signs, strict=True)]
    return turned, fit_lens([twin(m, s) for m, s in zip(members, signs, strict=True)], stated)


def _as_session(fits: Sequence[LocalFit], stated: Stated) -> SessionFits:
    turned, lens = _lens(fits, stated)
    return SessionFits(tuple(turned), lens, tuple(range(len(turned))))
