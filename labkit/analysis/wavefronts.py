"""Observations to the wavefronts of one lens: each fit helped by those before it, all held against the session as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labkit.analysis.camera_model import CameraModel
from labkit.analysis.fits_under_way import FitsUnderWay
from labkit.analysis.lens_fit import LensFit, predict
from labkit.analysis.local_fits import (
    PATIENCE_S,
    SHARED_CONE_STD,
    LocalFit,
    Task,
    engraved_cone,
    most_like,
    optics_of,
)
from labkit.analysis.observe import Observation
from labkit.analysis.panel import as_shown
from labkit.analysis.session_fits import SessionFits
from labkit.execute import Run
from labkit.imaging.parts import LowPass
from labkit.inference.fit import canonical
from labkit.plan import Plan, leading_channel
from labkit.target import Target
from labkit.types import Progress

ANCHOR_S = 15.0  # for the first fits, of which one is enough: those of golden `open` take 8
RECONCILE_S = 4.0  # for a search that another fit's modes are given to: what they lead to shows at once
SAME_OPTIMUM = 5.0  # log-likelihoods that differ by less


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
    diagnose: whether parts of the camera that the fits call for stay in the model. They are taken out in the end either way,
    for optima are sought with what explains the frames: then the session without them only shows what they change. A fit whose
    process is killed costs no other one. Raises FitError where all are.
    """
    chain = _Chain(tuple(observations), plan, run, progress, target=target, patience_s=patience_s)
    camera = CameraModel(chain)
    anchors = chain.anchors()
    chain.fit(anchors, ANCHOR_S if len(anchors) > 1 else np.inf)
    chain.fit(chain.taken_back())
    chain.reconcile()
    camera.complete()
    chain.fit(chain.leaders())
    chain.fit([k for k in range(len(observations)) if k not in chain.fits])
    camera.complete()
    chain.reconcile()
    settled = chain.settled()
    whole, plain = camera.with_what_was_tried(settled), camera.taken_out(settled)
    progress(chain.made, chain.made, "what the fits make of the lens, and its images of points")
    if diagnose:
        return whole if plain is settled else replace(whole, without_found=plain)
    chain.refuse_none()
    return camera.with_what_was_tried(plain)


@dataclass(kw_only=True)
class _Chain(FitsUnderWay):
    """Each fit begun at what those made so far predict of it. patience_s: for one search."""

    target: Target
    patience_s: float

    def anchors(self) -> list[int]:
        """Green, or the first channel, at the nearest and the farthest range; one frame of it where ranges are unknown."""
        channels = [o.channel for o in self.observations]
        first = leading_channel(channels)
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
        known = self.joined()
        light = {channel.name: channel.wavelength_nm for channel in self.plan.channel}
        places = sorted(places, key=lambda k: light[self.observations[k].channel])
        tasks = [self._task(k, known) for k in places]
        tasks = [replace(task, patience_s=min(task.patience_s, patience_s)) for task in tasks]
        doing = "fitting" if self.fits else "searching from nothing"
        for index, fit in self.done(tasks, doing, new=len(tasks)):
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
        known = self.joined()
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
        for index, fit in self.done(tasks, "trying each with the modes of another"):
            if fit.objective > self.fits[places[index]].fit.objective + SAME_OPTIMUM:
                self.fits[places[index]] = LocalFit(tasks[index], canonical(fit))

    def settled(self) -> SessionFits:
        """The session's estimate; fits that do not belong to it are made once more, from what it predicts for them."""
        self.refuse_none()
        before, order = self.joined(), sorted(self.fits)
        again = {} if before.lens is None else self._tasks_again(before, before.lens)
        for index, fit in self.done(list(again.values()), "fitting again what the session doubts"):
            place = list(again)[index]
            made, old = LocalFit(again[place], canonical(fit)), self.fits[order[place]].fit
            if fit.objective > old.objective - SAME_OPTIMUM:
                self.fits[order[place]] = made
        after = self.joined() if again else before
        mended = tuple(k for k in again if k in after.members)
        return replace(after, mended=mended, lost=tuple(self.left_out()))

    def _task(self, k: int, known: SessionFits) -> Task:
        """From what is known of the lens: its cone, its modes, and where its focus lies."""
        observation = self.observations[k]
        ranges = [o.measured_range_mm for o in self.observations if o.measured_range_mm is not None]
        cone = engraved_cone(self.plan, ranges)
        optics = replace(optics_of(self.plan, observation.channel), f_number=cone.value)
        target = as_shown(self.plan, self.target, observation.channel)
        task = Task(optics, target, observation, cone.std / cone.value, patience_s=self.patience_s)
        task = replace(task, missing=(LowPass(),), asked=True, alone=len(set(ranges)) < 2)
        accepted = [f for f in known.fits if f.fit.verdict.accepted]
        nearest = most_like(observation, accepted)
        if nearest is None:
            return task
        # one range determines neither best focus nor the right twin
        law = len({f.member.stop for f in accepted if f.ranged}) > 1
        if law and known.lens is not None and observation.channel in known.lens.model.channels and task.ranged:
            predicted = predict(known.lens, task.as_member(nearest.fit.measured))
            return replace(task, optics=optics.sharing(nearest.fit.optics)).starting_at(predicted)
        seen = replace(optics.sharing(nearest.fit.optics), f_number=nearest.fit.f_number)
        return replace(task, optics=seen, f_number_std=SHARED_CONE_STD, alike=(nearest.fit.waves,))

    def _tasks_again(self, known: SessionFits, lens: LensFit) -> dict[int, Task]:
        """Of those that are no members, from what the members predict, where they do."""
        again = {}
        for k in range(len(known.fits)):
            local = known.fits[k]
            if k not in known.members and local.ranged and local.channel in lens.model.channels:
                again[k] = local.task.starting_at(predict(lens, local.member))
        return again
