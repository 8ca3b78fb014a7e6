"""Select camera parts and modes, shown by a session and absent from its plan: forward selection by summed score tests.

A score test at every optimum gives the log-likelihood that each absent part would gain (C. R. Rao, Proc. Camb. Phil. Soc.
44, 50 (1948)). The sums over a session name the part to try. The most significant fits are refitted with it, and the
penalised likelihood decides. Parts with similar blur are tried in place of each other, the more common part first.
Every choice is fitted from an optimum with a similar choice.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from itertools import chain

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from labkit.estimation.candidate import Measured
from labkit.estimation.local import Optimum
from labkit.estimation.scores import ScoreTest
from labkit.estimation.settings import SETTINGS
from labkit.imaging.parts import KNOWN, Blades
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.results.model import PartTried
from labkit.types import Floats, Indices

ALIKE_BLURS = ("low_pass_filter", "diffusion", "smear", "low_pass_filter_turned")
"""Parts with the same blur to first order, the most common first."""

TESTED_IN_PLACE = {"uneven_rim": "cats_eye", "uneven_field": "vignetting"}
"""Parts looked for in place of others, whose likelihood is not regular where they are absent."""

Parts = frozenset[str]
Refit = Callable[[Sequence[int], Parts], Mapping[int, Optimum]]


def cost(parts: Parts) -> float:
    """Return the penalty of a choice of parts and modes, in log-likelihood.

    By chance n numbers gain more than their penalty once in `1 / SETTINGS.part_chance` sessions: twice the gain is
    distributed as chi-squared with n degrees of freedom. A rarer blur must gain clearly more than the commonest blur.
    """
    rarer, modes = parts & set(ALIKE_BLURS[1:]), parts & MODE_GROUPS.keys()
    common = [*(parts - rarer - modes), *ALIKE_BLURS[:1] * len(rarer)]
    penalties = sum(chance_gain(numbers(name)) for name in common)
    return penalties + SETTINGS.clear_gain * len(rarer) + _cost_of_modes(modes)


def _cost_of_modes(groups: Parts) -> float:
    """Return the penalty of groups of modes: together they count as one, but each further group must gain clearly.

    A lens that has some of these modes has the next ones too, about as strong.
    """
    sizes = np.cumsum([numbers(name) for name in MODE_GROUPS if name in groups])
    costs = np.array([chance_gain(n) for n in sizes])
    further = np.maximum(np.diff(costs), SETTINGS.clear_gain)
    return float(costs[:1].sum() + further.sum())


def numbers(name: str) -> int:
    """Return how many numbers a part or a group of modes has."""
    return len(MODE_GROUPS[name].noll if name in MODE_GROUPS else KNOWN[name].labels)


def chance_gain(numbers: int) -> float:
    """Return the log-likelihood gained by absent numbers by chance once in `1 / SETTINGS.part_chance` sessions."""
    return 0.5 * float(chdtri(numbers, SETTINGS.part_chance))


def summed_score_tests(fits: Sequence[tuple[str, Optimum]]) -> dict[str, ScoreTest]:
    """Sum the score tests of a session, by name of the part or group of modes.

    Parameters
    ----------
    fits : channel and optimum of each fit. Parts of the light are tested for each channel and joined into one test. Modes and
        parts of the rim are summed over the fits tested for them, other parts only if all fits were.
    """
    tests = [one.scores for _, one in fits]
    names = [
        name
        for name in dict.fromkeys(chain(*tests))
        if name in MODE_GROUPS or KNOWN[name].of_rim or all(name in of for of in tests)
    ]
    whole = {
        name: reduce(ScoreTest.__add__, (of[name] for of in tests if name in of))
        for name in names
    }
    for name in [name for name in names if name in KNOWN and KNOWN[name].per_channel]:
        by_channel = dict[str, ScoreTest]()
        for channel, one in fits:
            test = one.scores[name]
            by_channel[channel] = (
                by_channel[channel] + test if channel in by_channel else test
            )
        apart = list(by_channel.values())
        whole[name] = ScoreTest(
            np.concatenate([c.slope for c in apart]),
            block_diag(*(c.information for c in apart)),
            apart[0].one_sided,
        )
    return whole


def _places(measured: Measured, names: Collection[str]) -> Indices:
    """Return the places of the numbers of parts and groups of modes among a fit's values, as far as it has them."""
    wanted = {j for name in names if name in MODE_GROUPS for j in MODE_GROUPS[name].noll}
    modes = np.isin(measured.noll, [*wanted])
    parts = [label.split(".")[0] in names for label in measured.parts]
    return np.flatnonzero([*modes, *parts])


def _present(measured: Measured) -> list[str]:
    """Return the parts of a fit's model, and the group of its highest modes."""
    parts = dict.fromkeys(label.split(".")[0] for label in measured.parts)
    groups = [n for n in MODE_GROUPS if MODE_GROUPS[n].last in measured.noll]
    return [name for name in parts if name in KNOWN] + groups[-1:]


def wald_losses(fits: Sequence[Measured]) -> dict[str, float]:
    """Return the log-likelihood lost without each part, and without the highest modes, common to all fits (Wald test)."""
    present = dict.fromkeys(chain.from_iterable(map(_present, fits)))
    return {name: _loss(*_mean(_apart(fits, [name]))) for name in present}


def promised(end: Optimum, parts: Parts, choice: Parts) -> float:
    """Return the log-likelihood that an optimum promises for another choice of parts and modes.

    Score tests give what the parts gain that it lacks, Wald tests what the others lose.

    Parameters
    ----------
    end : the optimum
    parts : parts and modes in its model
    choice : parts and modes of the other model
    """
    gains = sum(end.scores[name].gain for name in choice - parts if name in end.scores)
    losses = wald_losses([end.measured])
    return end.log_likelihood + gains - sum(losses.get(n, 0.0) for n in parts - choice)


Apart = list[tuple[Floats, Floats]]
"""Of each fit, some numbers (n,) and their inverse covariance (n, n)."""


def _apart(fits: Sequence[Measured], names: Collection[str]) -> Apart:
    """Return the numbers of parts and groups of modes in each fit that has all of them."""
    places = [(fit, _places(fit, names)) for fit in fits]
    most = max(at.size for _, at in places)
    return [
        (fit.values[at], np.asarray(np.linalg.inv(fit.covariance[np.ix_(at, at)]), float))
        for fit, at in places
        if at.size == most
    ]


def _mean(apart: Apart) -> tuple[Floats, Floats]:
    """Return common numbers (n,) and their inverse covariance (n, n)."""
    weight = np.sum([weight for _, weight in apart], axis=0)
    pulled = np.sum([weight @ values for values, weight in apart], axis=0)
    return np.linalg.solve(weight, pulled), weight


def _loss(values: Floats, weight: Floats) -> float:
    return 0.5 * float(values @ weight @ values)


def _gained_apart(fits: Sequence[Measured], names: Parts) -> float:
    """Return the log-likelihood that numbers gain by being each fit's own, where chance explains that they differ.

    If they differ by more, they do for a reason: only what as many numbers gain by chance is returned.
    """
    many = sum(map(numbers, names))
    if not many:
        return 0.0
    chance = chance_gain(many * len(fits)) - chance_gain(many)
    if any(_places(fit, names).size < many for fit in fits):
        return chance
    apart = _apart(fits, names)
    mean, _ = _mean(apart)
    return min(chance, sum(_loss(values - mean, weight) for values, weight in apart))


def idle(fits: Collection[Optimum], names: Parts) -> Parts:
    """Return those of some parts of fits that gain less than their cost and a share of what is not explained together."""
    losses = wald_losses(_measured(fits))
    least = _least_gain(fits)
    return Parts(one for one in names if losses.get(one, 0.0) < cost(Parts({one})) + least)


def unphysical(fits: Sequence[Measured]) -> Parts:
    """Return the parts whose numbers, common to all fits, are below 0 where only positive numbers are physical."""
    means = {
        name: _mean(_apart(fits, [name]))[0]
        for name in dict.fromkeys(chain.from_iterable(map(_present, fits)))
        if name in KNOWN and not KNOWN[name].per_channel and KNOWN[name].one_sided
    }
    return Parts(name for name, of in means.items() if not (of.max() > 0 and of.sum() > 0))


def extended(parts: Parts, name: str) -> Parts:
    """Return a choice with a further part, or with all groups of modes up to a last group."""
    if name not in MODE_GROUPS:
        return parts | {name}
    groups = list(MODE_GROUPS)
    return parts | set(groups[: groups.index(name) + 1])


def kind(name: str) -> str:
    """Return the kind of a part or a group of modes: parts of a kind explain the same departures."""
    if name in MODE_GROUPS:
        return "modes"
    return "blur" if name in ALIKE_BLURS else KNOWN[name].kind or name


def _explained(fits: Iterable[Optimum]) -> int:
    """Return the number of fits whose residuals are noise alone."""
    return sum(fit.verdict.accepted for fit in fits)


def _measured(fits: Iterable[Optimum]) -> list[Measured]:
    return [fit.measured for fit in fits]


def _unexplained(fits: Collection[Optimum]) -> float:
    """Return the log-likelihood that fits do not explain; 0 if most fits are explained."""
    unexplained = [fit.unexplained for fit in fits if not fit.verdict.accepted]
    return 0.0 if 2 * len(unexplained) < len(fits) else sum(unexplained)


def _least_gain(fits: Collection[Optimum]) -> float:
    """Return the least gain of a part: a share of the unexplained log-likelihood.

    A part with a smaller gain stands for something else that the model lacks.
    """
    return SETTINGS.few * _unexplained(fits)


def _net(tests: Mapping[str, ScoreTest], parts: Parts) -> dict[str, float]:
    """Return what further parts or groups of modes promise to gain, less their cost beside present parts."""
    return {
        name: test.gain - cost(extended(parts, name)) + cost(parts)
        for name, test in tests.items()
    }


def promised_gain(fits: Sequence[tuple[str, Optimum]], parts: Parts) -> float:
    """Return the most that a further part promises to gain, less its cost; 0 where none gains more than it costs.

    Parameters
    ----------
    fits : channel and optimum of each fit
    parts : parts and modes in their model
    """
    return max([0.0, *_net(summed_score_tests(fits), parts).values()])


def _far(name: str) -> bool:
    """Return whether only a fit determines the gain of a part, and no score test."""
    return name in KNOWN and KNOWN[name].far


@dataclass(frozen=True)
class Fitted:
    """Fits of some observations with a choice of parts, by observation."""

    parts: Parts
    ends: Mapping[int, Optimum]

    def gain(self, before: Fitted) -> float:
        """Return the log-likelihood gained over earlier fits of these observations by numbers common to all."""
        there = [before.ends[k] for k in self.ends]
        gained = sum(one.log_likelihood for one in self.ends.values())
        gained -= sum(one.log_likelihood for one in there)
        added = _gained_apart(_measured(self.ends.values()), self.parts - before.parts)
        return gained - added + _gained_apart(_measured(there), before.parts - self.parts)

    @cached_property
    def unphysical(self) -> Parts:
        """Parts with unphysical numbers."""
        return unphysical(_measured(self.ends.values())) & self.parts

    def net_gain(self, before: Fitted) -> float:
        """Return the gain less the cost of the added parts; unphysical parts leave at any loss."""
        if before.unphysical - self.parts:
            return np.inf
        return self.gain(before) - cost(self.parts) + cost(before.parts)

    def better(self, before: Fitted) -> bool:
        """Return whether parts gain more than they cost.

        Added parts must be physical, and explain a further fit or their share.
        """
        if self.unphysical - before.parts:
            return False
        gain = self.net_gain(before)
        if gain <= 0 or not self.parts - before.parts:
            return gain > 0
        fits = [before.ends[k] for k in self.ends]
        explains_more = _explained(self.ends.values()) > _explained(fits)
        return explains_more or gain > _least_gain(fits)


@dataclass
class CameraChoice:
    """The search for a session's camera parts.

    Attributes
    ----------
    refit : refits observations, each from its optimum, with a choice of parts
    wanted : parts that the plan requests to fit, which always stay
    channels : channel of each observation
    tried : parts tested for, with their gains
    missing : the significant part refused because it explains too little of the residuals, or is unphysical
    with_missing : fits with the missing part
    compared : models without a diaphragm at whose optima all numbers of blades were compared
    """

    refit: Refit
    wanted: Parts
    channels: Sequence[str]
    tried: list[PartTried] = field(default_factory=list)
    missing: tuple[str, ...] = ()
    with_missing: Mapping[int, Optimum] = field(default_factory=dict)
    compared: set[Parts] = field(default_factory=set)

    def chosen(self, ends: Mapping[int, Optimum], parts: Parts) -> Parts:
        """Find the parts that raise the penalised likelihood most, step by step.

        Parameters
        ----------
        ends : fits, by observation
        parts : parts in the fits' model in addition to the plan's
        """
        best, refused = Fitted(parts, ends), set[Parts]()
        while True:
            for trial in self._trials(best, refused):
                reached = self._reached(best, trial)
                if reached is not None:
                    best = reached
                    break
                refused.add(trial.parts)
            else:
                return best.parts

    def _trials(self, present: Fitted, refused: set[Parts]) -> Iterator[Fitted]:
        """Yield the most telling fits with parts that raise their penalised likelihood; add other choices to `refused`.

        A score is an approximation, which is poor for numbers far from 0, and many modes mimic a diaphragm of few numbers. So
        a choice that does not explain the fits, or that clearly calls for further parts, is compared with the next ones of
        other kinds. The best choice comes first, by its gain and the gain that a further part promises.
        """
        while True:
            trials = list[tuple[float, Fitted]]()
            kinds = set[str]()
            for choice in self._proposals(present):
                added = choice - present.parts
                if choice in refused or {kind(name) for name in added} & kinds:
                    continue
                telling = most_telling(present.ends, choice ^ present.parts)
                if choice < present.parts:  # no fit gains by fewer numbers: one may refuse
                    telling = telling[:1]
                trial = Fitted(choice, self.refit(telling, choice))
                gain = trial.net_gain(present)
                if gain <= 0:
                    refused.add(choice)
                    continue
                further = promised_gain(self._fits(trial), choice)
                trials.append((gain + further, trial))
                kinds |= {kind(name) for name in added}
                explained = _explained(trial.ends.values()) == len(trial.ends)
                complete = explained and further < SETTINGS.clear_gain
                if complete or not added or len(trials) == SETTINGS.tried:
                    break
            if not trials:
                return
            for _, trial in sorted(trials, key=lambda one: -one[0]):
                yield trial

    def _proposals(self, present: Fitted) -> Iterator[Parts]:
        """Propose other choices of parts, the most promising first."""
        fits, parts = list(present.ends.values()), present.parts
        tests = self._tests(present)
        self.tried = [one for one in self.tried if one.name not in tests]
        self.tried += [PartTried(name, test.gain, False) for name, test in tests.items()]
        losses = wald_losses(_measured(fits))
        for name in sorted(parts & losses.keys(), key=lambda one: losses[one]):
            worth = cost(parts) - cost(parts - {name})
            if losses[name] < worth or name in present.unphysical:
                yield parts - {name}
        for name in TESTED_IN_PLACE.keys() & parts:
            in_place = (parts - {name}) | {TESTED_IN_PLACE[name]}
            yield in_place
            yield from self._with_blades(present, in_place)
        # their likelihood is no parabola near zero: a fit without them decides in place of a Wald test
        yield from (parts - {name} for name in parts & set(TESTED_IN_PLACE.values()))
        for name in parts - self.wanted:
            # a cat's eye that the model lacks adds to the scores of wrong numbers
            if kind(name) == Blades.kind and parts - {name} not in self.compared:
                yield from self._with_blades(present, parts)
        least = _least_gain(fits)
        net = {
            name: gain
            for name, gain in _net(tests, parts).items()
            if (tests[name].gain > least or _far(name)) and name not in self.wanted
        }
        near = max((net[name] for name in net if not _far(name)), default=0.0)
        # modes that stand for a far part explain each fit, but little in common
        far_first = near < (1 - SETTINGS.few) * _unexplained(fits)
        for name in sorted(net, key=lambda one: (not (far_first and _far(one)), -net[one])):
            if net[name] > 0:
                yield extended(parts, name)
        for k, name in enumerate(ALIKE_BLURS):
            if name not in parts:
                continue
            more_common = [one for one in ALIKE_BLURS[:k] if one in tests]
            yield from ((parts - {name}) | {one} for one in more_common)
            instead = sum(map(numbers, more_common))
            if len(more_common) > 1 and instead <= numbers(name):
                yield (parts - {name}) | set(more_common)

    def _tests(self, present: Fitted) -> dict[str, ScoreTest]:
        """Return the summed score tests of some fits, by which all numbers of blades are compared."""
        if not any(kind(name) == Blades.kind for name in present.parts):
            self.compared.add(present.parts)
        return summed_score_tests(self._fits(present))

    def _fits(self, fitted: Fitted) -> list[tuple[str, Optimum]]:
        """Return channel and optimum of each fit."""
        return [(self.channels[k], one) for k, one in fitted.ends.items()]

    def _with_blades(self, present: Fitted, choice: Parts) -> Iterator[Parts]:
        """Propose a choice with another number of blades, by scores of fits with its other parts."""
        had = {name for name in choice - self.wanted if kind(name) == Blades.kind}
        rest = choice - had
        telling = most_telling(present.ends, rest ^ present.parts)
        tests = self._tests(Fitted(rest, self.refit(telling, rest)))
        gains = {name: tests[name].gain for name in tests if kind(name) == Blades.kind}
        best = max(gains, key=lambda name: gains[name], default=None)
        if best is not None and gains[best] > cost(Parts({best})):
            yield rest | {best}

    def _reached(self, present: Fitted, trial: Fitted) -> Fitted | None:
        """Return all fits with the parts of a trial, or None if the penalised likelihood does not rise."""
        parts = trial.parts
        rest = [k for k in present.ends if k not in trial.ends]
        whole = Fitted(parts, {**trial.ends, **self.refit(rest, parts)})
        added, gain = parts - present.parts, whole.gain(present)
        if whole.better(present):
            self.tried = [one for one in self.tried if one.name not in parts]
            self.tried += [PartTried(name, gain, True) for name in sorted(parts)]
            self.missing, self.with_missing = (), {}  # of the model before: asked again
            return Fitted(parts, {**present.ends, **whole.ends})
        far = all(map(_far, added))  # fitted whatever their scores promise
        least = _least_gain([present.ends[k] for k in whole.ends]) if far else 0.0
        if added and gain > max(cost(added), least):
            self.missing, self.with_missing = tuple(sorted(added)), whole.ends
        return None


def most_telling(ends: Mapping[int, Optimum], names: Parts) -> list[int]:
    """Return the observations with the most significant score tests, or estimates, of some parts."""
    leading = [name for name in names if name not in MODE_GROUPS]
    leading += [name for name in MODE_GROUPS if name in names][-1:]

    def shown(k: int) -> float:
        scores, losses = ends[k].scores, wald_losses([ends[k].measured])
        return sum(scores[n].gain if n in scores else losses.get(n, 0.0) for n in leading)

    return sorted(ends, key=lambda k: -shown(k))[: SETTINGS.tried]
