"""Observations to the wavefronts of one lens: each fit helped by those before it, all held against the session as a whole."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from labkit.analysis.diagnosis import ALIKE, called_for, commoner, idle, lacks, numbers_of, together, worth
from labkit.analysis.lens_fit import LensFit, belongs, fit_session_lens, predict
from labkit.analysis.lens_model import Stated
from labkit.analysis.local_fits import (
    PATIENCE_S,
    SHARED_CONE_STD,
    LocalFit,
    Task,
    engraved_cone,
    fit_task,
    most_like,
    optics_of,
)
from labkit.analysis.observe import Observation
from labkit.analysis.panel import as_shown
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.stated_parts import wanted_parts
from labkit.analysis.twins import choose_twins
from labkit.errors import FitError, LostTasksError
from labkit.execute import Run
from labkit.imaging.model import Optics
from labkit.imaging.parts import LowPass, Part
from labkit.inference.fit import WavefrontFit, canonical
from labkit.inference.missing_parts import with_part, without_parts
from labkit.inference.search import CALLED_FOR
from labkit.plan import Plan
from labkit.results.model import PartTried
from labkit.target import Target
from labkit.types import Floats, Progress

ANCHOR_S = 15.0  # for the first fits, of which one is enough: those of golden `open` take 8
SHARE = 0.25  # of what is unexplained that a part must explain, if no fit is explained with it: else it stands for another lack
RECONCILE_S = 4.0  # for a search that another fit's modes are given to: what they lead to shows at once
MOST_WIDENING = 5.0  # of a lens that fits vouch for whose residuals were all rejected
SAME_OPTIMUM = 5.0  # log-likelihoods that differ by less
TELLING = 3  # fits by which two parts that blur alike are told apart
NAMED = 3  # of the fits that are under way


def fit_session(
    observations: Sequence[Observation],
    plan: Plan,
    target: Target,
    run: Run,
    progress: Progress,
    patience_s: float = PATIENCE_S,
    diagnose: bool = True,
) -> SessionFits:
    """Every observation fitted, and the session estimated from all.

    Green at both ends of the rail comes first, searched from nothing: far from focus an optimum is plain. One that does not
    show soon is sought again from the other. Of each other colour the clearest range begins with green's modes, and all the
    rest at what these predict. Those that the session finds not to belong are made again from what the others predict.
    diagnose: whether parts of the camera that the fits call for are taken into the model. A fit whose process is killed
    costs no other one. Raises FitError where all are.
    """
    chain = _Chain(tuple(observations), plan, target, run, progress, patience_s, diagnose)
    anchors = chain.anchors()
    chain.fit(anchors, ANCHOR_S if len(anchors) > 1 else np.inf)
    chain.fit(chain.taken_back())
    chain.reconcile()
    chain.complete_model()
    chain.fit(chain.leaders())
    chain.fit([k for k in range(len(observations)) if k not in chain.fits])
    chain.complete_model()
    chain.reconcile()
    return chain.settled()


@dataclass
class _Chain:
    """Fits made so far, and what they predict of the others."""

    observations: tuple[Observation, ...]
    plan: Plan
    target: Target
    run: Run
    progress: Progress
    patience_s: float
    diagnose: bool
    fits: dict[int, LocalFit] = field(default_factory=dict)
    tried: list[PartTried] = field(default_factory=list)
    missing: str | None = None
    missing_numbers: dict[str, Floats] = field(default_factory=dict)
    asked: dict[int, LocalFit] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    known: tuple[dict[int, LocalFit], SessionFits] = ({}, SessionFits(()))
    made: int = 0

    def anchors(self) -> list[int]:
        """Green, or the first channel, at the nearest and the farthest range; one frame of it where ranges are unknown."""
        channels = [o.channel for o in self.observations]
        first = "G" if "G" in channels else channels[0]
        of = [k for k, channel in enumerate(channels) if channel == first]
        ranges = {k: r for k in of if (r := self.observations[k].measured_range_mm) is not None}
        if not ranges:
            return of[:1]
        return list(dict.fromkeys([min(ranges, key=ranges.__getitem__), max(ranges, key=ranges.__getitem__)]))

    def fit(self, places: Sequence[int], patience_s: float = np.inf) -> None:
        """Fit these, all at once. patience_s: for a search, if it is less than the session's.

        The shortest wavelength comes first: its pictures are the finest, and no other core should wait for it in the end.
        """
        if not places:
            return
        known = self._joined()
        light = {channel.name: channel.wavelength_nm for channel in self.plan.channel}
        places = sorted(places, key=lambda k: light[self.observations[k].channel])
        tasks = [self._task(k, known) for k in places]
        tasks = [replace(task, patience_s=min(task.patience_s, patience_s)) for task in tasks]
        doing = "fitting" if self.fits else "searching from nothing"
        for index, fit in self._done(tasks, doing, new=len(tasks)):
            self.fits[places[index]] = LocalFit(tasks[index], canonical(fit))

    def taken_back(self) -> list[int]:
        """Fits whose search was cut short, which are forgotten."""
        places = [k for k, f in self.fits.items() if f.fit.cut_short]
        for k in places:
            del self.fits[k]
        return places

    def leaders(self) -> list[int]:
        """What is left of the first channel, and of each other the one at the range where defocus is largest: it tells where
        that channel's focus lies, and so what its other ranges begin at."""
        ranged = [f for f in self.fits.values() if f.ranged]
        if not ranged:
            return []
        clearest = max(ranged, key=lambda f: abs(f.fit.waves[0]))
        there = clearest.task.observation.measured_range_mm
        left = [k for k in range(len(self.observations)) if k not in self.fits]
        return [
            k
            for k in left
            if self.observations[k].channel == clearest.channel or self.observations[k].measured_range_mm == there
        ]

    def reconcile(self) -> None:
        """Where fits disagree on the modes, each is sought again with those of the clearest other: the likelihood decides.

        Far from focus an optimum is plain, near focus wrong ones lie close, and two fits cannot say which of them is wrong.
        """
        known = self._joined()
        if known.lens is None or known.lens.model.shared:
            return
        places = [sorted(self.fits)[k] for k in sorted(known.members)]
        clear = sorted(places, key=lambda k: -abs(self.fits[k].member.measured.waves[0]))
        tasks = []
        for k in places:
            others = [
                other for other in clear if other != k and self.fits[other].member.stop != self.fits[k].member.stop
            ]
            others.sort(key=lambda other: self.fits[other].channel != self.fits[k].channel)
            fit = self.fits[k].fit
            cone = replace(fit.optics, f_number=self.fits[others[0]].fit.f_number)
            alike = (self.fits[others[0]].fit.waves,)
            tasks.append(replace(self.fits[k].task, optics=cone, starts=(), alike=alike, patience_s=RECONCILE_S))
        for index, fit in self._done(tasks, "trying each with the modes of another"):
            if fit.objective > self.fits[places[index]].fit.objective + SAME_OPTIMUM:
                self.fits[places[index]] = LocalFit(tasks[index], canonical(fit))

    def complete_model(self) -> None:
        """Take in what parts of the camera the fits so far call for together, one after another."""
        places = self._to_ask()
        if not places or _same(self.asked, {k: self.fits[k] for k in places}):
            return
        self.missing = None
        self._made_alike()
        if not self.tried:  # the searches' own
            found = worth([self.fits[k].fit.measured for k in places])
            self._drop_idle(places)
            self.tried += [PartTried(name, gain, self._has(name, places)) for name, gain in found.items()]
        better = True
        while better:
            self.asked = {k: self.fits[k] for k in places}
            channels = [self.fits[k].channel for k in places]
            summed = together([self.fits[k].fit.calls for k in places], channels)
            name = called_for(summed)
            better = name is not None and self.diagnose and self._better_with(name, places)
            if better and name is not None and self._has(name, places):
                name = self._commoner(name, places)
            taken = [each for each in summed if better and each == name and self._has(each, places)]
            self.tried += [PartTried(each, call.gain, each in taken) for each, call in summed.items()]
            self.missing = None if better else name
            self.missing_numbers = (
                {} if self.missing is None else numbers_of(self.missing, summed[self.missing], channels)
            )

    def _to_ask(self) -> list[int]:
        """All, once they are there; until then, for diagnosis, those that are explained, if any are."""
        if len(self.fits) == len(self.observations):
            return [*self.fits]
        return [k for k, f in self.fits.items() if f.fit.verdict.accepted] or [*self.fits] if self.diagnose else []

    def _made_alike(self) -> None:
        """Where some fits have parts and others not, the others are made again with them."""
        richest = max((f.fit.optics for f in self.fits.values()), key=lambda optics: len(optics.parts))
        names = [part.name for part in richest.parts]
        poorer = [k for k, f in self.fits.items() if [part.name for part in f.fit.optics.parts] != names]
        self._again(poorer, {k: replace(self.fits[k].fit.optics, parts=richest.parts) for k in poorer})

    def _better_with(self, name: str, places: Sequence[int]) -> bool:
        """Make all fits again with a part; whether some gain by it. Parts that have nothing left to do are taken out.

        So is the part itself, where it has only led to a better optimum at which it does nothing: then that is the gain.
        """
        before = {k: self.fits[k] for k in self.fits}

        def gained() -> float:
            return sum(self.fits[k].fit.objective - before[k].fit.objective for k in places)

        self._again(list(before), {k: with_part(f.fit.optics, name) for k, f in before.items()})
        explained = any(self.fits[k].fit.verdict.accepted for k in places)
        least = max(CALLED_FOR, 0.0 if explained else SHARE * sum(before[k].unexplained for k in places))
        if gained() >= least:
            self._drop_idle(places, (name,))
            if not self._drop_idle(places) or gained() >= least:
                return True
        self.fits = before
        return False

    def _commoner(self, name: str, places: Sequence[int]) -> str:
        """The part that was taken in, or a more common one that blurs like it and explains as much: then it takes its place.

        Slopes where a part begins hardly tell a wide filter from a smear. The fits that tell most of the part decide.
        """
        telling = sorted(places, key=lambda k: -worth([self.fits[k].fit.measured]).get(name, 0.0))[:TELLING]
        least, before = sum(self.fits[k].fit.objective for k in telling) - ALIKE, dict(self.fits)
        for other in commoner(name, self.fits[places[0]].fit.optics):
            optics = {k: with_part(without_parts(f.fit.optics, [name]), other) for k, f in before.items()}
            self._again(telling, optics)
            if sum(self.fits[k].fit.objective for k in telling) > least:
                self._again([k for k in before if k not in telling], optics)
                return other
            self.fits = dict(before)
        return name

    def _drop_idle(self, places: Sequence[int], kept: Sequence[str] = ()) -> bool:
        """Take parts out of all fits that do nothing in these, but for some and the plan's own; whether there were any."""
        kept = [*kept, *wanted_parts(self.plan)]
        out = [part for part in idle([self.fits[k].fit.measured for k in places]) if part not in kept]
        if out:
            self._again(list(self.fits), {k: without_parts(f.fit.optics, out) for k, f in self.fits.items()})
        return bool(out)

    def _has(self, name: str, places: Sequence[int]) -> bool:
        """Whether these fits have a part."""
        return name not in lacks(self.fits[k].fit.optics for k in places)

    def _again(self, places: Sequence[int], optics: dict[int, Optics]) -> None:
        """Make fits again, each from its own end, with other parts of the camera."""
        tasks = [
            replace(self.fits[k].task, optics=optics[k], starts=(self.fits[k].fit.waves,), alike=(), missing=())
            for k in places
        ]
        before = [self.fits[k].fit for k in places]
        for index, fit in self._done(tasks, "fitting with other parts of the camera"):
            old = before[index]
            without = old.left if old.left_without is None else old.left_without
            found = fit.optics.shape_labels != optics_of(self.plan, tasks[index].observation.channel).shape_labels
            fit = replace(canonical(fit), left_without=without if found else None)
            self.fits[places[index]] = LocalFit(tasks[index], fit)

    def settled(self) -> SessionFits:
        """The session's estimate; fits that do not belong to it are made once more, from what it predicts for them."""
        if not self.fits:
            raise FitError(f"no wavefront could be fitted: {'; '.join(self._left_out())}")
        before, order = self._joined(), sorted(self.fits)
        again = {} if before.lens is None else self._tasks_again(before, before.lens)
        for index, fit in self._done(list(again.values()), "fitting again what the session doubts"):
            place = list(again)[index]
            made, old = LocalFit(again[place], canonical(fit)), self.fits[order[place]].fit
            if fit.objective > old.objective - SAME_OPTIMUM:
                self.fits[order[place]] = made
        after = self._joined() if again else before
        mended = tuple(k for k in again if k in after.members)
        lost = tuple(self._left_out())
        self.progress(self.made, self.made, "what the fits make of the lens, and its images of points")
        after = replace(after, missing=self.missing, missing_numbers=self.missing_numbers)
        return replace(after, mended=mended, tried=tuple(self.tried), lost=lost)

    def _done(self, tasks: Sequence[Task], doing: str, new: int = 0) -> Iterator[tuple[int, WavefrontFit]]:
        """Fits of tasks; those that memory was too short for are noted, and what was there before them stays.

        new: how many are observations without a fit; others are more work than was to do before.
        """
        under_way = {index: task.label for index, task in enumerate(tasks)}
        total = self.made + len(tasks) + len(self.observations) - len(self.fits) - new
        try:
            if tasks:
                self.progress(self.made, total, f"{doing}: {_some(under_way.values())}")
            for index, result in self.run(fit_task, tasks):
                self.made += 1
                del under_way[index]
                self.progress(self.made, total, f"{doing}: {_some(under_way.values())}" if under_way else doing)
                yield index, result
        except LostTasksError as error:
            self.lost |= {task.label: why for task, why in error.lost}

    def _left_out(self) -> list[str]:
        """Observations without a fit, in words."""
        fitted = {fit.task.label for fit in self.fits.values()}
        lost = [(label, why) for label, why in self.lost.items() if label not in fitted]
        return [f"{label} is left out: {why}; close other programs and fit again" for label, why in lost]

    def _joined(self) -> SessionFits:
        """What the fits so far say of the lens."""
        if not _same(self.known[0], self.fits):
            self.known = dict(self.fits), self._join()
        return self.known[1]

    def _join(self) -> SessionFits:
        """The same: twins are chosen, and those that disagree with the rest are left out.

        Fits whose residuals were rejected belong where the others predict them: then the model lacks something, and the
        optimum is right; their errors in the estimate say so. Where too few are accepted, all of them vouch for each other.
        """
        fits = {k: self.fits[k] for k in sorted(self.fits)}
        ranged = [k for k, f in fits.items() if f.ranged and not f.fit.verdict.undetermined]
        good = [k for k in ranged if fits[k].fit.verdict.accepted]
        if not ranged:
            return SessionFits(tuple(fits.values()))
        stated = Stated.of(self.plan)
        signs, open_ = choose_twins([fits[k].member for k in ranged], stated)
        for k, sign in zip(ranged, signs, strict=True):
            if sign < 0:
                fits[k] = replace(fits[k], fit=fits[k].fit.twin())
        members = good if len(good) > 1 else ranged
        out, lens = fit_session_lens([fits[k].honest_member for k in members], stated)
        kept = [k for i, k in enumerate(members) if i not in out]
        late = [k for k in ranged if k not in members and belongs(lens, fits[k].member)]
        if late:
            kept = sorted([*kept, *late])
            out, lens = fit_session_lens([fits[k].honest_member for k in kept], stated)
            kept = [k for i, k in enumerate(kept) if i not in out]
        if not good and (out or lens.widening > MOST_WIDENING):
            return SessionFits(tuple(fits.values()))
        order = list(fits)
        strangers = tuple(order.index(k) for k in ranged if k not in kept)
        return SessionFits(
            tuple(fits.values()), lens, tuple(map(order.index, kept)), strangers, open_channels=tuple(open_)
        )

    def _task(self, k: int, known: SessionFits) -> Task:
        """From what is known of the lens: its cone, its modes, and where its focus lies."""
        observation = self.observations[k]
        ranges = [o.measured_range_mm for o in self.observations if o.measured_range_mm is not None]
        cone = engraved_cone(self.plan, ranges)
        optics = replace(optics_of(self.plan, observation.channel), f_number=cone.value)
        target = as_shown(self.plan, self.target, observation.channel)
        task = Task(optics, target, observation, cone.std / cone.value, patience_s=self.patience_s)
        missing: tuple[Part, ...] = (LowPass(),) if self.diagnose else ()
        task = replace(task, missing=missing, asked=True, alone=len(set(ranges)) < 2)
        accepted = [f for f in known.fits if f.fit.verdict.accepted]
        nearest = most_like(observation, accepted)
        if nearest is None:
            return task
        # one range determines neither best focus nor the right twin
        law = len({f.member.stop for f in accepted if f.ranged}) > 1
        if law and known.lens is not None and observation.channel in known.lens.model.channels and task.ranged:
            predicted = predict(known.lens, task.as_member(nearest.fit.measured))
            alike = replace(optics, parts=nearest.fit.optics.parts)
            return replace(task, optics=alike).starting_at(predicted)
        seen = replace(optics, f_number=nearest.fit.f_number, parts=nearest.fit.optics.parts)
        return replace(task, optics=seen, f_number_std=SHARED_CONE_STD, alike=(nearest.fit.waves,))

    def _tasks_again(self, known: SessionFits, lens: LensFit) -> dict[int, Task]:
        """Of those that are no members, from what the members predict, where they do."""
        again = {}
        for k in range(len(known.fits)):
            local = known.fits[k]
            if k not in known.members and local.ranged and local.channel in lens.model.channels:
                again[k] = local.task.starting_at(predict(lens, local.member))
        return again


def _some(labels: Collection[str]) -> str:
    """The first few."""
    more = f" and {len(labels) - NAMED} more" if len(labels) > NAMED else ""
    return ", ".join(islice(labels, NAMED)) + more


def _same(fits: Mapping[int, LocalFit], others: Mapping[int, LocalFit]) -> bool:
    """Whether none was made again."""
    return fits.keys() == others.keys() and all(fits[k] is others[k] for k in fits)
