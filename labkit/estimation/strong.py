"""Search for strong wavefronts: stations that contradict each other are searched anew, several at once and with all modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from labkit.errors import LostTasksError
from labkit.estimation.camera import Parts, cost, idle
from labkit.estimation.local import Found, Guesses, Optimum
from labkit.estimation.refits import Refits, with_tests
from labkit.estimation.searches import Searches
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import nominal_f_number, optics_of
from labkit.estimation.together import Ends, TogetherTask, search_together
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, CatsEye
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
    refits : the session's refits, to which those of the new optima are added
    plan : the session's plan
    """

    search: Searches
    refits: Refits
    plan: Plan

    def __call__(
        self, found: Mapping[int, Found], parts: Parts
    ) -> tuple[Parts, dict[int, Found]] | None:
        """Search anew if the optima of two stations are not explained and contradict each other.

        Many modes nearly explain what an obstruction does, at wrong optima. So the search is made with each such part before it
        is made with all modes; what the part does not explain may then be modes, which go on without a part that hardly does
        anything. Where neither is enough, a cat's eye is tried with the part: it moves the clear part, and so the middle of the
        obstruction. An end without the part does not count: the choice of parts fits an eye alone, with all modes.

        Parameters
        ----------
        found : by observation, optima of the first searches
        parts : parts and modes in the model of these optima

        Returns
        -------
        parts and modes in the new model, and the new optima by observation; None if they gain less than they cost, or if
        neither residuals nor another station confirm any of them: then something else is missing than modes
        """
        best = {k: one.best for k, one in found.items()}
        if not _unexplained(list(best.values())) or (
            _agree(list(best.values()), SETTINGS.contrary_waves) and self._in_step(best)
        ):
            return None
        modes = parts | set(self.plan.fit.mode_groups)
        lacking = best[min(best)].optics.lacking
        begun = [parts | {name} for name in lacking if KNOWN[name].far]
        cut = [way | {CatsEye.name} for way in begun]
        choice, reached, again = parts, dict[int, Found](), self._refits_of_a_way()
        for way in [*begun, modes, *cut]:
            least = {
                k: one.log_likelihood + cost(way) - cost(parts) for k, one in best.items()
            }
            ends = self._ends(self._stations(found), way, least)
            left = idle([one.best for one in ends.values()], way - parts)
            if way in cut and left:
                continue
            whole = modes | (way - left)
            refits = self._refits_of_a_way()
            if whole != way:
                ends = _refitted(refits, ends, way, whole)
            if _height(ends) - cost(whole) > _height(reached) - cost(choice):
                choice, reached, again = whole, ends, refits
            if _explained(reached):
                break
        gain = sum(
            reached[k].best.log_likelihood - best[k].log_likelihood
            for k in best
            if k in reached
        )
        if gain <= cost(choice) - cost(parts) or not _confirmed(reached):
            return None
        self.refits.add(again)
        return choice, reached

    def _refits_of_a_way(self) -> Refits:
        """Return refits that begin from one way's optima only: many modes nearly explain a pupil, at wrong optima."""
        return Refits(self.search, self.plan)

    def _ends(
        self, stations: list[int], choice: Parts, least: Mapping[int, float]
    ) -> dict[int, Found]:
        """Return the optima of stations with a choice of parts and modes, from nothing.

        Parameters
        ----------
        stations : observations
        choice : parts and modes
        least : by observation, a log-likelihood that a right optimum exceeds
        """
        f_number = nominal_f_number(self.plan, self._ranges_mm(stations).tolist())
        f_number_std = f_number.std / f_number.value
        reached = dict[int, Found]()
        for optics, waves in self._together(stations, choice, f_number.value):
            starts = dict(zip(stations, waves, strict=True))
            # far from focus a right wavefront is clearly the likelier one
            far = max(starts, key=lambda k: abs(starts[k][0]))
            ends = self._searched({far: starts.pop(far)}, optics, f_number_std)
            known = reached[far].best.log_likelihood if reached else least.get(far, -np.inf)
            if _height(ends) <= known:
                continue
            there = ends[far].best.optics
            begun = optics.with_named(there.camera_labels, there.camera_parameters)
            ends |= self._searched(starts, begun, SETTINGS.shared_f_number_std)
            if _height(ends) > _height(reached):
                reached = ends
            optima = [one.best for one in reached.values()]
            if _explained(reached) or _agree(optima, SETTINGS.sure_waves):
                break
        return reached

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

    def _ranges_mm(self, stations: Sequence[int]) -> Floats:
        """Return the ranges (stations,)."""
        observations = self.search.observations
        return np.array([observations[k].measured_range_mm or 0.0 for k in stations])

    def _defocus(self, stations: Sequence[int], optics: Optics) -> Floats:
        """Return the defocus (stations,) of stations relative to the first, by the stated lens, waves RMS."""
        lens = ThinLens(self.plan.lens.focal_length_mm, self.plan.lens.f_number)
        ranges_mm = self._ranges_mm(stations)
        return np.asarray(
            defocus_waves(lens, ranges_mm, ranges_mm[0], optics.reference_um * 1e3)
        )

    def _in_step(self, best: Mapping[int, Optimum]) -> bool:
        """Return whether the defocus of optima, or of their twins, differs as the stated lens says."""
        first, *others = best.values()
        _, *steps = self._defocus(list(best), first.optics)
        return all(
            min(
                abs(end * other.waves[0] - begin * first.waves[0] - step)
                for begin in (1, -1)
                for end in (1, -1)
            )
            < SETTINGS.contrary_waves + 2 * SETTINGS.loose * abs(step)
            for other, step in zip(others, steps, strict=True)
        )

    def _together(self, stations: list[int], choice: Parts, f_number: float) -> Ends:
        """Return the ends of a search over several stations with a choice; none if it was lost for lack of memory."""
        stated = optics_of(self.plan, self.search.observations[stations[0]].channel)
        stated = replace(stated, f_number=f_number)
        optics = stated.with_parts(choice - {CatsEye.name}).begun()
        defocus = self._defocus(stations, optics)
        task = TogetherTask(
            optics,
            tuple(stated.with_parts(choice).starts()),
            self.search.shown[self.search.observations[stations[0]].channel],
            tuple(self.search.views[k] for k in stations),
            tuple(defocus.tolist()),
        )
        try:
            ((_, ends),) = self.search.run(search_together, [task])
        except LostTasksError:
            return ()
        return ends

    def _searched(
        self, starts: Mapping[int, Floats], optics: Optics, f_number_std: float
    ) -> dict[int, Found]:
        """Climb over each station alone, from its wavefront (modes,) by the common search."""
        blind = Guesses(f_number_std, deep=False, alone=False)
        blind = with_tests(blind, optics, self.plan)
        wanted = {k: (optics, replace(blind, starts=(one,))) for k, one in starts.items()}
        return self.search(wanted, "fitting strong wavefronts")


def _refitted(
    refits: Refits, ends: Mapping[int, Found], parts: Parts, choice: Parts
) -> dict[int, Found]:
    """Return the optima of stations refitted with a choice of parts and modes; none if the refit of a station was lost."""
    again = refits({k: one.best for k, one in ends.items()}, parts, choice)
    if again.keys() != ends.keys():
        return {}
    return {k: replace(ends[k], optima=(one,)) for k, one in again.items()}


def _unexplained(optima: list[Optimum]) -> bool:
    """Return whether optima are of several stations, and none is explained."""
    return (
        len(optima) > 1
        and optima[0].noll[0] == DEFOCUS
        and not any(one.verdict.accepted for one in optima)
    )


def _agree(optima: list[Optimum], within_waves: float) -> bool:
    """Return whether optima, or their twins, have the same modes but for defocus, to an RMS difference."""
    first, *others = optima
    return all(
        min(
            float(np.linalg.norm((twin.waves - first.waves)[1:]))
            for twin in (other, other.twin())
        )
        < within_waves
        for other in others
    )


def _explained(reached: Mapping[int, Found]) -> bool:
    """Return whether most optima are explained: what the others lack may be a part of the camera, and no wrong optimum."""
    return 2 * sum(one.best.verdict.accepted for one in reached.values()) > len(reached)


def _confirmed(reached: Mapping[int, Found]) -> bool:
    """Return whether an optimum is explained, or two agree."""
    optima = [one.best for one in reached.values()]
    agree = any(_agree([*two], SETTINGS.sure_waves) for two in combinations(optima, 2))
    return agree or any(one.verdict.accepted for one in optima)


def _height(found: Mapping[int, Found]) -> float:
    """Return the log-likelihood of optima; -inf without any."""
    return sum(one.best.log_likelihood for one in found.values()) if found else -np.inf
