"""The camera that a session calls for: parts that its plan does not state are taken in, and out again, in all fits alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

from labkit.analysis.diagnosis import ALIKE, BLURS, called_for, commoner, idle, lacks, numbers, together, worth
from labkit.analysis.fits_under_way import FitsUnderWay, same
from labkit.analysis.local_fits import LocalFit, optics_of, wanted_parts
from labkit.analysis.session_fits import SessionFits
from labkit.imaging.optics import Optics
from labkit.inference.fit import canonical
from labkit.inference.search import CALLED_FOR
from labkit.results.model import PartTried

SHARE = 0.25  # of what is unexplained that a part must explain, if no fit is explained with it: else it stands for another lack
TELLING = 3  # fits by which two parts that blur alike are told apart


@dataclass
class CameraModel:
    """What was tried. missing: what fits call for that their model does not have; asked: the fits that said so, with_missing:
    the same with it."""

    under_way: FitsUnderWay
    tried: list[PartTried] = field(default_factory=list)
    missing: tuple[str, ...] = ()
    asked: dict[int, LocalFit] = field(default_factory=dict)
    with_missing: dict[int, LocalFit] = field(default_factory=dict)

    @property
    def fits(self) -> dict[int, LocalFit]:
        """So far."""
        return self.under_way.fits

    def complete(self) -> None:
        """Take in what parts of the camera the fits so far call for together, one after another."""
        places = self._to_ask()
        if not places or same(self.asked, {k: self.fits[k] for k in places}):
            return
        self._made_alike()
        if not self.tried:  # the searches' own
            found = worth([self.fits[k].fit.measured for k in places])
            self._drop_idle(places)
            self.tried += [PartTried(name, gain, self._has(name, places)) for name, gain in found.items()]
        better = True
        while better:
            self.asked, self.with_missing = {k: self.fits[k] for k in places}, {}
            summed = together([self.fits[k].fit.calls for k in places], [self.fits[k].channel for k in places])
            name = called_for(summed)
            better = name is not None and self._better_with(name, places)
            kept = better and name is not None and self._has(name, places)
            taken = self._commoner(name, places) if kept and name is not None else []
            self.tried += [PartTried(each, call.gain, each in taken) for each, call in summed.items()]
            self.missing = () if better or name is None else (name,)
            if taken:
                self._compared_again(taken, places)

    def _compared_again(self, taken: Sequence[str], places: Sequence[int]) -> None:
        """Parts that were there before some were taken in are held against more common ones once more: what lacked misled."""
        kept = [*taken, *wanted_parts(self.under_way.plan)]
        for name in BLURS[1:]:
            others = self._commoner(name, places) if name not in kept and self._has(name, places) else [name]
            if others != [name]:
                gains = worth([self.fits[k].fit.measured for k in places])
                self.tried = [replace(one, adopted=one.adopted and one.name != name) for one in self.tried]
                self.tried += [PartTried(other, gains.get(other, 0.0), True) for other in others]

    def _to_ask(self) -> list[int]:
        """All, once they are there; until then those that are explained, if any are."""
        if len(self.fits) == len(self.under_way.observations):
            return [*self.fits]
        return [k for k, f in self.fits.items() if f.fit.verdict.accepted] or [*self.fits]

    def _made_alike(self) -> None:
        """Where some fits have parts and others not, the others are made again with them."""
        richest = max((f.fit.optics for f in self.fits.values()), key=lambda optics: len(optics.shared))
        names = [part.name for part in richest.shared]
        poorer = [k for k, f in self.fits.items() if [part.name for part in f.fit.optics.shared] != names]
        self._again(poorer, {k: self.fits[k].fit.optics.sharing(richest) for k in poorer})

    def _better_with(self, name: str, places: Sequence[int]) -> bool:
        """Make all fits again with a part; whether some gain by it. Parts that have nothing left to do are taken out.

        So is the part itself, where it has only led to a better optimum at which it does nothing: then that is the gain.
        """
        before = {k: self.fits[k] for k in self.fits}

        def gained() -> float:
            return sum(self.fits[k].fit.objective - before[k].fit.objective for k in places)

        self._again(list(before), {k: f.fit.optics.with_part(name) for k, f in before.items()})
        explained = any(self.fits[k].fit.verdict.accepted for k in places)
        least = max(CALLED_FOR, 0.0 if explained else SHARE * sum(before[k].unexplained for k in places))
        if gained() >= least:
            self._drop_idle(places, (name,))
            if not self._drop_idle(places) or gained() >= least:
                return True
        self.under_way.fits, self.with_missing = before, self.fits
        return False

    def _commoner(self, name: str, places: Sequence[int]) -> list[str]:
        """The part that was taken in, or more common ones that blur like it and explain as much: then they take its place.

        Slopes where a part begins hardly tell a wide filter from a smear. The fits that tell most of the part decide. Two may
        take the place of one that has as many numbers, and must explain more.
        """
        telling = sorted(places, key=lambda k: -worth([self.fits[k].fit.measured]).get(name, 0.0))[:TELLING]
        reached, before = sum(self.fits[k].fit.objective for k in telling), dict(self.fits)
        others = commoner(name, self.fits[places[0]].fit.optics)
        all_of_them = [others] if len(others) > 1 and numbers(others) <= numbers([name]) else []
        for instead in [*([other] for other in others), *all_of_them]:
            optics = {k: reduce(Optics.with_part, instead, f.fit.optics.without([name])) for k, f in before.items()}
            self._again(telling, optics)
            if sum(self.fits[k].fit.objective for k in telling) > reached - ALIKE * (len(instead) == 1):
                self._again([k for k in before if k not in telling], optics)
                return instead
            self.under_way.fits = dict(before)
        return [name]

    def _drop_idle(self, places: Sequence[int], kept: Sequence[str] = ()) -> bool:
        """Take parts out of all fits that do nothing in these, but for some and the plan's own; whether there were any."""
        kept = [*kept, *wanted_parts(self.under_way.plan)]
        out = [part for part in idle([self.fits[k].fit.measured for k in places]) if part not in kept]
        if out:
            self._again(list(self.fits), {k: f.fit.optics.without(out) for k, f in self.fits.items()})
        return bool(out)

    def _has(self, name: str, places: Sequence[int]) -> bool:
        """Whether these fits have a part."""
        return name not in lacks(self.fits[k].fit.optics for k in places)

    def _again(self, places: Sequence[int], optics: dict[int, Optics], climb: bool = False) -> None:
        """Make fits again, each from its own end, with other parts of the camera.

        climb: only that, with no search after it nor a question what is missing then.
        """
        tasks = [
            replace(self.fits[k].task, optics=optics[k], starts=(self.fits[k].fit.waves,), alike=(), missing=())
            for k in places
        ]
        if climb:
            tasks = [replace(task, patience_s=0.0, asked=False) for task in tasks]
        for index, fit in self.under_way.done(tasks, "fitting with other parts of the camera"):
            self.fits[places[index]] = LocalFit(tasks[index], canonical(fit))

    def taken_out(self, session: SessionFits) -> SessionFits:
        """The session with no part that its plan does not state, each fit climbed from where it is right.

        Its search is the one with the parts: without them many starts end anywhere.
        """
        whole, optics = dict(self.fits), dict[int, Optics]()
        for k, f in whole.items():
            stated = optics_of(self.under_way.plan, f.channel).lacking
            found = [name for name in stated if name not in f.fit.optics.lacking]
            if found:
                optics[k] = f.fit.optics.without(found)
                self.missing = tuple(dict.fromkeys((*self.missing, *found)))
        if not optics:
            return session
        self.with_missing, order = {k: self._fullest(k) for k in whole}, sorted(whole)
        self._again(list(optics), optics, climb=True)
        for k in optics:
            if (plain := self.fits.pop(k)) is not whole[k]:  # else memory was too short for it
                search = {of: getattr(whole[k].fit, of) for of in ("starts", "others", "settled", "cut_short")}
                self.fits[k] = replace(plain, fit=replace(plain.fit, **search))
        self.under_way.vouched = frozenset(order[k] for k in session.members)
        self.asked = dict(self.fits)
        self.tried = [replace(one, adopted=one.adopted and one.name not in self.missing) for one in self.tried]
        return replace(self.under_way.joined(), mended=session.mended, lost=tuple(self.under_way.left_out()))

    def with_what_was_tried(self, session: SessionFits) -> SessionFits:
        """The session, and what it says of parts that its model lacks: of fits that are as they were when they were asked."""
        fullest = [(f, self._fullest(k)) for k, f in sorted(self.fits.items())]
        with_missing = tuple(None if with_it is f else with_it for f, with_it in fullest)
        return replace(session, tried=tuple(self.tried), missing=self.missing, with_missing=with_missing)

    def _fullest(self, k: int) -> LocalFit:
        """Fit k, with what its model lacks where it was asked."""
        fit = self.fits[k]
        return self.with_missing.get(k, fit) if self.asked.get(k) is fit else fit
