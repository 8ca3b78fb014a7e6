"""Refits of a session's observations with other camera parts and modes, each from an optimum with a similar choice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from labkit.estimation.camera import Parts, kind, promised, promised_gain
from labkit.estimation.climb import State
from labkit.estimation.expansion import with_modes
from labkit.estimation.local import Guesses, Optimum
from labkit.estimation.searches import Searches
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import nominal_f_number, optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, CatsEye
from labkit.optics.other_circle import over_other_circle
from labkit.optics.wavefront import DEFOCUS
from labkit.plan import Plan
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.types import Floats

_Begin = tuple[float, Optimum]
"""An optimum, and the log-likelihood that it promises with other parts."""

DOING = "fitting with other parts or modes"
"""What the progress says of refits."""


@dataclass
class Refits:
    """Refits observations, and keeps every refit.

    Attributes
    ----------
    search : runs searches
    plan : the session's plan
    made : by choice of parts and modes, the refitted optima by observation
    begun : likewise, the optima from which these were refitted
    tried : choice, observation and log-likelihood of every optimum from which a refit was begun
    """

    search: Searches
    plan: Plan
    made: dict[Parts, dict[int, Optimum]] = field(default_factory=dict)
    begun: dict[Parts, dict[int, Optimum]] = field(default_factory=dict)
    tried: set[tuple[Parts, int, float]] = field(default_factory=set)

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
        kept, begun = self.made.setdefault(choice, {}), self.begun.setdefault(choice, {})
        if parts == choice:  # the present optima are fits with it
            likelier = {k: one for k, one in ends.items() if _likelier(one, kept.get(k))}
            kept.update(likelier)
            begun.update(likelier)
        every = {k: self._begin(k, ends[k], parts, choice) for k in ends}
        begin = {k: one for k, one in every.items() if one}
        self._refit_again({k: begin[k] for k in begin if k in kept}, choice, score)
        new = {k: one for k, (_, one) in begin.items() if k not in kept}
        self.tried.update((choice, k, one.log_likelihood) for k, one in new.items())
        if kept:
            kept.update(self._found(self._following(kept, begun, new, choice, score)))
        else:
            kept.update(self._in_a_new_way(new, choice, score))
        begun.update(new)
        return {k: kept[k] for k in ends if k in kept}

    def _refit_again(self, begin: Mapping[int, _Begin], choice: Parts, score: bool) -> None:
        """Refit observations again, in a new way, if other optima promise clearly more than the refits reached.

        Fits have the parts in common, so all of them decide together.
        """
        kept = self.made[choice]
        left = {k: one for k, (_, one) in begin.items()}
        more = sum(promise - kept[k].log_likelihood for k, (promise, _) in begin.items())
        if more < SETTINGS.clear_gain:
            return
        self.tried.update((choice, k, one.log_likelihood) for k, one in left.items())
        way = self._in_a_new_way(left, choice, score)
        before = {k: kept[k] for k in way}
        if _joint_plausibility(way) > _joint_plausibility(before):
            kept.update(way)
            self.begun[choice].update({k: left[k] for k in way})

    def add(self, others: Refits) -> None:
        """Add refits with choices that were not refitted before."""
        self.made |= others.made
        self.begun |= others.begun

    def _in_a_new_way(
        self, left: Mapping[int, Optimum], choice: Parts, score: bool
    ) -> dict[int, Optimum]:
        """Refit observations with a choice, whatever its other refits.

        Fits have the parts in common: where new ones may begin in several ways, the observation that shows the pupil best
        tries all ways, and the others go on in each.
        """
        tries = {k: self._starts(k, one, choice) for k, one in left.items()}
        several = [k for k in tries if len(tries[k]) > 1]
        if not several:
            return self._found({k: self._wanted(one, score) for k, (one,) in tries.items()})
        first = max(several, key=lambda k: self._shows_the_pupil(k, left[k]))
        rest = {k: one for k, one in left.items() if k != first}
        wanted = [(first, *self._wanted(one, score)) for one in tries[first]]
        ways = [{first: way.best} for way in self.search.each(wanted, DOING) if way]
        self._follow(ways, left, rest, choice, score)
        return self._most_plausible(ways, choice)

    def _follow(
        self,
        ways: Sequence[dict[int, Optimum]],
        begun: Mapping[int, Optimum],
        left: Mapping[int, Optimum],
        choice: Parts,
        score: bool,
    ) -> None:
        """Add to each way the refits of observations that follow it, of all ways at once: workers share them."""
        wanted = [
            (way, k, one)
            for way in ways
            for k, one in self._following(way, begun, left, choice, score).items()
        ]
        ends = self.search.each([(k, *one) for _, k, one in wanted], DOING)
        for (way, k, _), found in zip(wanted, ends, strict=True):
            if found:
                way[k] = found.best

    def _following(
        self,
        fitted: Mapping[int, Optimum],
        begun: Mapping[int, Optimum],
        left: Mapping[int, Optimum],
        choice: Parts,
        score: bool,
    ) -> dict[int, tuple[Optics, Guesses]]:
        """Return searches of observations with the pupil of the fit that shows it best, or from its wavefront.

        Parameters
        ----------
        fitted : refits with the choice
        begun : the optima from which these were refitted
        left : optima to begin from
        """
        first = max(fitted, key=lambda k: self._shows_the_pupil(k, fitted[k]))
        end, before = fitted[first], begun[first]
        starts = {
            k: self._start_like(k, one, end, before, choice) for k, one in left.items()
        }
        beside = {
            k: _moved(end, before, one, starts[k][0])
            for k, one in left.items()
            if not end.optics.rim.is_round
        }
        return {k: self._wanted(one, score, beside.get(k)) for k, one in starts.items()}

    def _starts(self, k: int, begin: Optimum, choice: Parts) -> list[tuple[Optics, State]]:
        """Return the starts of an observation's refit with a choice of parts, from an optimum with a similar choice.

        A wrong f-number may have made up for new parts whose start is far from zero: then a start has the stated one too.

        Parameters
        ----------
        k : the observation
        begin : its optimum
        choice : parts and modes
        """
        before = begin.optics.parts
        new = choice - {part.name for part in before}
        sides = _sides(self._optics(k, begin, choice), new)
        ways = [way for one in sides for way in one.starts(before)]
        starts = [_with_the_light(begin, one) for one in ways]
        stated = nominal_f_number(self.plan, self.search.ranges_mm).value
        off = abs(np.log(begin.optics.f_number / stated))
        if off < SETTINGS.loose or not _far(new):
            return starts
        return starts + [_at_f_number(*one, stated) for one in starts]

    def _start_like(
        self, k: int, begin: Optimum, end: Optimum, begun: Optimum, choice: Parts
    ) -> tuple[Optics, State]:
        """Return the start of an observation's refit that changes its optimum's pupil as that of another one was changed.

        Parameters
        ----------
        k : the observation
        begin : its optimum
        end, begun : the other's optimum after and before its refit
        choice : parts and modes
        """
        new = choice - {part.name for part in begin.optics.parts}
        optics = self._optics(k, begin, choice)
        if not any(name in KNOWN and KNOWN[name].of_rim for name in new):
            return _with_the_light(begin, optics.begun())
        start = _with_the_light(begin, optics.with_rim_of(end.optics).begun())
        wider = end.optics.f_number / begun.optics.f_number
        # both optima may have other parts, and so other unit circles
        wider *= np.sqrt(begun.optics.rim.area / begin.optics.rim.area)
        return _at_f_number(*start, begin.optics.f_number * float(wider))

    def _optics(self, k: int, begin: Optimum, choice: Parts) -> Optics:
        """Return the optics of an observation with a choice of parts and the numbers of an optimum."""
        observation = self.search.observations[k]
        optics = optics_of(self.plan, observation.channel, observation.tile_place)
        return optics.with_parts(choice).with_named(
            begin.optics.camera_labels, begin.optics.camera_parameters
        )

    def _most_plausible(
        self, ways: Sequence[dict[int, Optimum]], choice: Parts
    ) -> dict[int, Optimum]:
        """Return the most plausible refits with a choice, by observation; if several explain alike, those that call for more.

        As long as a part is missing, a wrong way may explain as much as the right one, which gains more by the part.
        """
        channels = [one.channel for one in self.search.observations]

        def hoped(ends: Mapping[int, Optimum]) -> float:
            fits = [(channels[k], one) for k, one in ends.items()]
            return _joint_plausibility(ends) + promised_gain(fits, choice)

        least = max(map(_joint_plausibility, ways), default=0.0) - SETTINGS.clear_gain
        alike = [ends for ends in ways if _joint_plausibility(ends) > least]
        return max(alike, key=hoped, default={})

    def _shows_the_pupil(self, k: int, end: Optimum) -> tuple[float, float]:
        """Return ranks of how well a photograph shows the pupil: in a corner of the frame, and far from focus."""
        height = float(np.hypot(*self.search.observations[k].place))
        return height, abs(float(end.waves[0]))

    def _found(self, wanted: Mapping[int, tuple[Optics, Guesses]]) -> dict[int, Optimum]:
        """Climb, and return the optima of the observations that are not lost."""
        return {k: found.best for k, found in self.search(wanted, DOING).items()}

    def _wanted(
        self,
        start: tuple[Optics, State],
        score: bool,
        beside: tuple[Optics, Floats] | None = None,
    ) -> tuple[Optics, Guesses]:
        """Return optics and guess of a climb from a start, or from optics and modes beside."""
        optics, state = start
        guess = Guesses(
            SETTINGS.shared_f_number_std, state=state, beside=beside, deep=False
        )
        return optics, with_tests(guess, optics, self.plan) if score else guess

    def _begin(self, k: int, end: Optimum, parts: Parts, choice: Parts) -> _Begin | None:
        """Return the optimum from which an observation is refitted, if any is left, of fits that differ by few parts.

        Fits that differ by one part, or by a part in place of another, are alike: the likelier one may have found an optimum
        that others missed. Modes begin at zero, and lose nothing; a part whose start is far from zero does, so fits that have
        it come first. So do fits that show where a cut lies, for a cut that is not known has its starts on all sides, and fits
        that promise more than an earlier refit reached. Of these too the likeliest is taken: far ones promise too much.
        """
        fitted = [(names, made[k]) for names, made in self.made.items() if k in made]
        left = [
            (names, one)
            for names, one in [*fitted, (parts, end)]
            if names != choice and (choice, k, one.log_likelihood) not in self.tried
        ]
        if not left:
            return None
        least = max(1, min(_steps(names, choice) for names, _ in left))
        kept = self.made[choice].get(k)
        reached = kept.log_likelihood if kept else -np.inf
        alike = [
            (names, promised(one, names, choice), one)
            for names, one in left
            if _steps(names, choice) <= least
        ]
        _, promise, optimum = max(
            alike,
            key=lambda one: (
                -len(_far(choice - one[0])),
                _cut(one[0]) or not _cut(choice),
                one[1] > reached,
                one[2].log_likelihood,
            ),
        )
        return promise, optimum


def _likelier(one: Optimum, other: Optimum | None) -> bool:
    """Return whether an optimum is likelier than another one, if there is one."""
    return other is None or one.log_likelihood > other.log_likelihood


def _steps(before: Parts, choice: Parts) -> int:
    """Return the number of parts by which two choices differ; one in place of another, and all modes, count once."""
    apart = [(one - MODE_GROUPS.keys()) for one in (before - choice, choice - before)]
    return max(map(len, apart)) + (not (before ^ choice) <= apart[0] | apart[1])


def _far(parts: Parts) -> Parts:
    """Return the parts whose start is far from zero."""
    return Parts(name for name in parts if name in KNOWN and KNOWN[name].far)


def _cut(parts: Parts) -> bool:
    """Return whether there is a part that cuts the pupil on one side."""
    return any(kind(name) == CatsEye.kind for name in parts)


def _sides(optics: Optics, new: Parts) -> list[Optics]:
    """Return the optics with parts on either side, if new parts are odd and may have made up for the wrong one."""
    odd = [name for name in new if name in KNOWN and min(KNOWN[name].twin_signs) < 0]
    if not odd:
        return [optics]
    sides = product(*((part,) if part.name in new else part.sides for part in optics.parts))
    return [replace(optics, parts=parts) for parts in sides]


def _moved(
    end: Optimum, begun: Optimum, other: Optimum, optics: Optics
) -> tuple[Optics, Floats]:
    """Return optics and modes of a refitted observation at another's range: f-number and defocus differ as before the refit.

    Parameters
    ----------
    end, begun : its optimum after and before the refit
    other : the other's optimum, not yet refitted
    optics : the other's
    """
    waves, before = end.waves.copy(), begun.optics.f_number
    if end.noll[0] == DEFOCUS:
        waves[0] += (other.waves[0] - begun.waves[0]) * (before / end.optics.f_number) ** 2
    optics = optics.with_named(end.optics.camera_labels, end.optics.camera_parameters)
    farther = other.optics.f_number / before
    return replace(optics, f_number=end.optics.f_number * farther), waves


def _joint_plausibility(ends: Mapping[int, Optimum]) -> float:
    """Return the plausibility of several observations' optima."""
    return sum(map(_plausibility, ends.values()))


def _plausibility(end: Optimum) -> float:
    """Return the log-likelihood of an optimum with its modes' Gaussian prior, whose variance is the likeliest.

    A pupil cut on the wrong side can nearly be made up for by a wavefront several times as large.
    """
    modes = end.waves[1:]
    size = float(np.linalg.norm(modes)) if modes.size else 1.0
    return end.log_likelihood - modes.size * float(np.log(size))


def _with_the_light(begin: Optimum, optics: Optics) -> tuple[Optics, State]:
    """Return optics and state whose pupil is as large as an optimum's, and whose wavefront and picture are the same.

    The unit circle of a cat's eye is the full pupil's, whose centre is not that of the clear part.
    """
    state = with_modes(begin.state, begin.optics, optics)
    before, after = begin.optics.rim, optics.rim
    wider = float(np.sqrt(before.area / after.area))
    if wider == 1:
        return optics, state
    optics = replace(optics, f_number=optics.f_number / wider)
    waves, tilts = over_other_circle(optics.noll, state.waves, before, after)
    poses = tuple(optics.tilted(pose, tilts) for pose in state.poses)
    return optics, replace(state, waves=waves, poses=poses)


def _at_f_number(optics: Optics, state: State, f_number: float) -> tuple[Optics, State]:
    """Return optics with another f-number and a state whose rays meet the sensor in the same places."""
    wider = optics.f_number / f_number
    return replace(optics, f_number=f_number), replace(state, waves=state.waves * wider)


def with_tests(guess: Guesses, optics: Optics, plan: Plan) -> Guesses:
    """Return a guess that requests score tests for all that the optics lack and the plan leaves open.

    Tests for modes and for the pupil's rim take longer than tests for other parts. Predicted fits are tested for them only if
    they are not explained.
    """
    modes = tuple(n for n in plan.fit.mode_groups if MODE_GROUPS[n].last not in optics.noll)
    rims = tuple(name for name in optics.lacking if KNOWN[name].of_rim)
    parts = tuple(name for name in optics.lacking if name not in rims)
    if guess.starts or guess.modes:
        return replace(guess, score=parts, score_unexplained=(*rims, *modes))
    return replace(guess, score=(*parts, *rims, *modes))
