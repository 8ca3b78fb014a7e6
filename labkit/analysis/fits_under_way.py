"""Fits of a session as they are made: run, counted, and what they come to so far."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

from labkit.analysis.lens_fit import FEW, belongs, fit_session_lens
from labkit.analysis.lens_model import Stated
from labkit.analysis.local_fits import LocalFit, Task, fit_task
from labkit.analysis.observe import Observation
from labkit.analysis.session_fits import SessionFits
from labkit.analysis.twins import choose_twins
from labkit.errors import FitError, LostTasksError
from labkit.execute import Run
from labkit.inference.fit import WavefrontFit
from labkit.plan import Plan
from labkit.types import Progress

MOST_WIDENING = 5.0  # of a lens that fits vouch for whose residuals were all rejected
NAMED = 3  # of the fits that are under way


@dataclass
class FitsUnderWay:
    """A session's fits by the places of their observations. lost: by label, why an observation has none; made: so far, again
    or for the first time; vouched: places of fits that are known to be right, whatever their residuals."""

    observations: tuple[Observation, ...]
    plan: Plan
    run: Run
    progress: Progress
    fits: dict[int, LocalFit] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    made: int = 0
    vouched: frozenset[int] = frozenset()
    _joined: tuple[dict[int, LocalFit], SessionFits] = ({}, SessionFits(()))

    def done(self, tasks: Sequence[Task], doing: str, new: int = 0) -> Iterator[tuple[int, WavefrontFit]]:
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

    def left_out(self) -> list[str]:
        """Observations without a fit, in words."""
        fitted = {fit.task.label for fit in self.fits.values()}
        lost = [(label, why) for label, why in self.lost.items() if label not in fitted]
        return [f"{label} is left out: {why}; close other programs and fit again" for label, why in lost]

    def refuse_none(self) -> None:
        """Raise FitError where there is no fit."""
        if not self.fits:
            raise FitError(f"no wavefront could be fitted: {'; '.join(self.left_out())}")

    def joined(self) -> SessionFits:
        """What the fits so far say of the lens."""
        if not same(self._joined[0], self.fits):
            self._joined = dict(self.fits), _join(self.fits, self.vouched, Stated.of(self.plan))
        return self._joined[1]


def same(fits: Mapping[int, LocalFit], others: Mapping[int, LocalFit]) -> bool:
    """Whether none was made again."""
    return fits.keys() == others.keys() and all(fits[k] is others[k] for k in fits)


def _join(every: Mapping[int, LocalFit], vouched: Container[int], stated: Stated) -> SessionFits:
    """What fits come to: twins are chosen, and those that disagree with the rest are left out.

    Fits whose residuals were rejected belong where the others predict them: then the model lacks something, and the
    optimum is right; their errors in the estimate say so. Where too few are accepted, they vouch for each other, all but a few.
    """
    fits = {k: every[k] for k in sorted(every)}
    ranged = [k for k, f in fits.items() if f.ranged and not f.fit.verdict.undetermined]
    good = [k for k in ranged if fits[k].fit.verdict.accepted or k in vouched]
    if not ranged:
        return SessionFits(tuple(fits.values()))
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
    if not good and (len(out) > FEW * len(ranged) or lens.widening > MOST_WIDENING):
        return SessionFits(tuple(fits.values()))
    order = list(fits)
    strangers = tuple(order.index(k) for k in ranged if k not in kept)
    return SessionFits(tuple(fits.values()), lens, tuple(map(order.index, kept)), strangers, open_channels=tuple(open_))


def _some(labels: Collection[str]) -> str:
    """The first few."""
    more = f" and {len(labels) - NAMED} more" if len(labels) > NAMED else ""
    return ", ".join(islice(labels, NAMED)) + more
