"""Refits of observations from their optima, with other camera parts and other groups of modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.estimation.camera import Parts
from labkit.estimation.climb import State
from labkit.estimation.expansion import with_modes
from labkit.estimation.local import Guesses, Optimum
from labkit.estimation.searches import Searches
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.mode_groups import MODE_GROUPS
from labkit.optics.zernike import stretched
from labkit.plan import Plan


@dataclass
class Refits:
    """Refits observations, and keeps every refit.

    Attributes
    ----------
    search : runs searches
    plan : the session's plan
    made : by choice of parts and modes, the refitted optima by observation
    """

    search: Searches
    plan: Plan
    made: dict[Parts, dict[int, Optimum]] = field(default_factory=dict)

    def __call__(
        self,
        ends: Mapping[int, Optimum],
        parts: Parts,
        choice: Parts,
        *,
        score: bool = True,
    ) -> dict[int, Optimum]:
        """Refit observations with a choice of parts and modes.

        Parameters
        ----------
        ends : by observation, the present optimum
        parts : parts and modes in the model of the present optima
        choice : parts and modes to fit
        score : whether to test for parts and modes that the choice lacks
        """
        wanted = {}
        for k, end in ends.items():
            begin = self._most_similar(k, end, parts, choice)
            optics = optics_of(self.plan, self.search.observations[k].channel)
            optics = (
                optics.with_parts(choice)
                .begun(begin.optics.parts)
                .with_named(begin.optics.camera_labels, begin.optics.camera_parameters)
            )
            optics, state = _with_the_light(begin, optics)
            guess = Guesses(SETTINGS.shared_f_number_std, state=state, deep=False)
            wanted[k] = optics, with_tests(guess, optics, self.plan) if score else guess
        if not wanted:
            return {}
        found = self.search(wanted, "fitting with other parts or modes")
        refitted = {k: one.best for k, one in found.items()}
        self.made.setdefault(choice, {}).update(refitted)
        return refitted

    def _most_similar(self, k: int, end: Optimum, parts: Parts, choice: Parts) -> Optimum:
        """Return the likeliest optimum of an observation among fits that differ from a choice by few parts and modes.

        Fits that differ by one part, or by a part in place of another, are alike: the likelier one may have found an optimum
        that others missed.
        """
        fitted = [(names, made[k]) for names, made in self.made.items() if k in made]
        fitted.append((parts, end))
        away = [max(len(names - choice), len(choice - names)) for names, _ in fitted]
        alike = [
            one
            for (_, one), distance in zip(fitted, away, strict=True)
            if distance <= max(1, min(away))
        ]
        return max(alike, key=lambda one: one.log_likelihood)


def _with_the_light(begin: Optimum, optics: Optics) -> tuple[Optics, State]:
    """Return optics and state whose pupil is as large as an optimum's, and whose wavefront is the same.

    The unit circle of a pupil that is cut to a cat's eye is the full pupil's.
    """
    state = with_modes(begin.state, begin.optics, optics)
    wider = float(np.sqrt(begin.optics.rim.area / optics.rim.area))
    if wider == 1:
        return optics, state
    waves = stretched(optics.noll, state.waves, wider)
    return replace(optics, f_number=optics.f_number / wider), replace(state, waves=waves)


def with_tests(guess: Guesses, optics: Optics, plan: Plan) -> Guesses:
    """Return a guess that requests score tests for all that the optics lack and the plan leaves open.

    Tests for modes and for the pupil's rim take longer than those for other parts. Predicted fits are tested for them only if
    they are not explained.
    """
    modes = tuple(n for n in plan.fit.mode_groups if MODE_GROUPS[n].last not in optics.noll)
    rims = tuple(name for name in optics.lacking if KNOWN[name].of_rim)
    parts = tuple(name for name in optics.lacking if name not in rims)
    if guess.starts or guess.modes:
        return replace(guess, score=parts, score_unexplained=(*rims, *modes))
    return replace(guess, score=(*parts, *rims, *modes))
