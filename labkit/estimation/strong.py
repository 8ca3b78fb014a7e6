"""Search for strong wavefronts: stations that contradict each other are searched anew, several at once and with all modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from labkit.errors import LostTasksError
from labkit.estimation.camera import Parts, cost
from labkit.estimation.local import Found, Guesses, Optimum
from labkit.estimation.refits import with_tests
from labkit.estimation.searches import Searches
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import nominal_f_number, optics_of
from labkit.estimation.together import TogetherTask, climb_together
from labkit.imaging.optics import Optics
from labkit.optics.lens import ThinLens, defocus_waves
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan
from labkit.types import Floats


@dataclass(frozen=True)
class StrongSearch:
    """Searches several stations of one channel at once, with as many modes as the plan allows.

    Attributes
    ----------
    search : runs searches
    plan : the session's plan
    """

    search: Searches
    plan: Plan

    def __call__(
        self, found: Mapping[int, Found], parts: Parts
    ) -> tuple[Parts, dict[int, Found]] | None:
        """Search anew if the optima of two stations are not explained and contradict each other.

        Parameters
        ----------
        found : by observation, optima of the first searches
        parts : parts and modes in the model of these optima

        Returns
        -------
        parts and modes in the new model, and the new optima by observation; None if they gain less than they cost
        """
        best = {k: one.best for k, one in found.items()}
        if not _contradictory(list(best.values())):
            return None
        choice = parts | set(self.plan.fit.mode_groups)
        reached = dict[int, Found]()
        for rank in range(SETTINGS.tried):
            ends = self._searched(self._stations(found), choice, rank)
            rise = _height(ends) - _height(reached)
            if rise > 0:
                reached = ends
            optima = [one.best for one in reached.values()]
            returned = abs(rise) < SETTINGS.same_optimum * len(ends)
            explained = all(one.verdict.accepted for one in optima)
            if returned or explained or _agree(optima, SETTINGS.sure_waves):
                break
        gain = sum(
            reached[k].best.log_likelihood - best[k].log_likelihood
            for k in best
            if k in reached
        )
        if gain <= cost(choice) - cost(parts):
            return None
        return choice, reached

    def _stations(self, found: Mapping[int, Found]) -> list[int]:
        """Return observations of the searched channel: the nearest, the farthest, and those evenly between."""
        observations = self.search.observations
        channel = observations[min(found)].channel
        by_range = {
            r: k
            for k, one in enumerate(observations)
            if one.channel == channel and (r := one.measured_range_mm) is not None
        }
        ordered = [by_range[r] for r in sorted(by_range)]
        places = np.linspace(
            0, len(ordered) - 1, min(SETTINGS.stations, len(ordered))
        ).round()
        return [ordered[int(place)] for place in places]

    def _searched(self, stations: list[int], choice: Parts, rank: int) -> dict[int, Found]:
        """Climb over several stations at once, then over each alone from there."""
        observations = self.search.observations
        ranges = np.array([observations[k].measured_range_mm or 0.0 for k in stations])
        channel = observations[stations[0]].channel
        optics = optics_of(self.plan, channel).with_parts(choice).begun()
        f_number = nominal_f_number(self.plan, ranges.tolist())
        optics = replace(optics, f_number=f_number.value)
        waves = self._together(stations, optics, ranges, rank)
        if waves is None:
            return {}
        blind = with_tests(
            Guesses(f_number.std / f_number.value, deep=False, alone=False),
            optics,
            self.plan,
        )
        wanted = {
            k: (optics, replace(blind, starts=(one,)))
            for k, one in zip(stations, waves, strict=True)
        }
        return self.search(wanted, "fitting strong wavefronts")

    def _together(
        self, stations: list[int], optics: Optics, ranges_mm: Floats, rank: int
    ) -> tuple[Floats, ...] | None:
        """Return the end of a climb over several stations; None if it was lost for lack of memory."""
        lens = ThinLens(self.plan.lens.focal_length_mm, self.plan.lens.f_number)
        defocus = defocus_waves(lens, ranges_mm, ranges_mm[0], optics.reference_um * 1e3)
        channel = self.search.observations[stations[0]].channel
        task = TogetherTask(
            optics,
            self.search.shown[channel],
            tuple(self.search.views[k] for k in stations),
            tuple(defocus.tolist()),
            rank,
        )
        try:
            ((_, end),) = self.search.run(climb_together, [task])
        except LostTasksError:
            return None
        return end.waves


def _contradictory(optima: list[Optimum]) -> bool:
    """Whether optima of several stations, none of them explained, have other modes, their twins too."""
    return (
        len(optima) > 1
        and optima[0].noll[0] == DEFOCUS
        and not any(one.verdict.accepted for one in optima)
        and not _agree(optima, SETTINGS.contrary_waves)
    )


def _agree(optima: list[Optimum], within_waves: float) -> bool:
    """Whether optima, or their twins, have the same modes but for defocus, to an RMS difference."""
    first, *others = optima
    return all(
        min(
            float(np.linalg.norm((twin.waves - first.waves)[1:]))
            for twin in (other, other.twin())
        )
        < within_waves
        for other in others
    )


def _height(found: Mapping[int, Found]) -> float:
    """Return the log-likelihood of optima; -inf without any."""
    return sum(one.best.log_likelihood for one in found.values()) if found else -np.inf
