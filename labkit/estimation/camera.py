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
from labkit.mode_groups import MODE_GROUPS
from labkit.results.model import PartTried
from labkit.types import Floats, Indices

ALIKE_BLURS = ("low_pass_filter", "diffusion", "smear", "low_pass_filter_turned")
"""Parts with the same blur to first order, the most common first."""

TESTED_IN_PLACE = {"uneven_rim": "cats_eye", "uneven_field": "vignetting"}
"""Parts that are looked for in place of others, whose likelihood is not regular where they are absent."""

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


def _places(measured: Measured) -> dict[str, Indices]:
    """Return the places of each part's numbers, and of the highest modes, among a fit's values."""
    labels = [label.split(".")[0] for label in measured.parts]
    places = {
        name: len(measured.noll) + np.flatnonzero([one == name for one in labels])
        for name in dict.fromkeys(labels)
        if name in KNOWN
    }
    groups = [n for n in MODE_GROUPS if MODE_GROUPS[n].last in measured.noll]
    for name in groups[-1:]:
        places[name] = np.flatnonzero(np.isin(measured.noll, MODE_GROUPS[name].noll))
    return places


def wald_losses(fits: Sequence[Measured]) -> dict[str, float]:
    """Return the log-likelihood lost without each part, and without the highest modes (Wald test).

    A part of all channels has one value for all fits: by chance each fit alone would add half a unit for each number, which is
    taken off where fits have values of their own.
    """
    losses = {name: _loss(*one) for name, one in _common(fits).items()}
    for measured in fits:
        for name, at in _places(measured).items():
            if name in MODE_GROUPS or KNOWN[name].per_channel:
                loss = _loss(measured.values[at], _weight(measured, at))
                before = losses.get(name)
                losses[name] = loss if before is None else before + loss - 0.5 * at.size
    return losses


def _weight(measured: Measured, at: Indices) -> Floats:
    """Return the inverse covariance of some of a fit's values."""
    return np.asarray(np.linalg.inv(measured.covariance[np.ix_(at, at)]), float)


def _loss(values: Floats, weight: Floats) -> float:
    return 0.5 * float(values @ weight @ values)


def idle(fits: Collection[Optimum], names: Parts) -> Parts:
    """Return those of some parts of fits that gain less than their cost and a share of what is not explained together."""
    losses = wald_losses([fit.measured for fit in fits])
    least = _least_gain(fits)
    return Parts(one for one in names if losses.get(one, 0.0) < cost(Parts({one})) + least)


def unphysical(fits: Sequence[Measured]) -> Parts:
    """Return the parts whose numbers, common to all fits, are below 0 where only positive numbers are physical."""
    return Parts(
        name
        for name, (values, _) in _common(fits).items()
        if KNOWN[name].one_sided and not (values.max() > 0 and values.sum() > 0)
    )


def _common(fits: Sequence[Measured]) -> dict[str, tuple[Floats, Floats]]:
    """Return the numbers of each part of all channels, common to all fits, and their inverse covariance."""
    weights, sums = dict[str, Floats](), dict[str, Floats]()
    for measured in fits:
        for name, at in _places(measured).items():
            if name in MODE_GROUPS or KNOWN[name].per_channel:
                continue
            weight = _weight(measured, at)
            weights[name] = weights.get(name, np.zeros_like(weight)) + weight
            sums[name] = sums.get(name, np.zeros(at.size)) + weight @ measured.values[at]
    return {
        name: (np.asarray(np.linalg.solve(weight, sums[name]), float), weight)
        for name, weight in weights.items()
    }


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


def _least_gain(fits: Collection[Optimum]) -> float:
    """Return the least gain of a part: a share of the unexplained log-likelihood, unless most fits are explained.

    A part with a smaller gain stands for something else that the model lacks.
    """
    unexplained = [fit.unexplained for fit in fits if not fit.verdict.accepted]
    if 2 * len(unexplained) < len(fits):
        return 0.0
    return SETTINGS.few * sum(unexplained)


def _net(tests: Mapping[str, ScoreTest], parts: Parts) -> dict[str, float]:
    """Return what further parts or groups of modes promise to gain, less their cost beside present parts."""
    return {
        name: test.gain - cost(extended(parts, name)) + cost(parts)
        for name, test in tests.items()
    }


def _far(name: str) -> bool:
    """Return whether only a fit determines the gain of a part, and no score test."""
    return name in KNOWN and KNOWN[name].far


@dataclass(frozen=True)
class Fitted:
    """Fits of some observations with a choice of parts, by observation."""

    parts: Parts
    ends: Mapping[int, Optimum]

    def gain(self, before: Fitted) -> float:
        """Return the log-likelihood gained over earlier fits of these observations by numbers common to all.

        Each fit has numbers of its own, which gain half a unit each by chance.
        """
        more = sum(map(numbers, self.parts)) - sum(map(numbers, before.parts))
        gained = sum(
            end.log_likelihood - before.ends[k].log_likelihood
            for k, end in self.ends.items()
        )
        return gained - 0.5 * more * (len(self.ends) - 1)

    @cached_property
    def unphysical(self) -> Parts:
        """Parts with unphysical numbers."""
        return unphysical([end.measured for end in self.ends.values()]) & self.parts

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
    missing : the significant part that was refused because it explains too little of the residuals, or is unphysical
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
                promised = max([0.0, *_net(self._summed(trial), choice).values()])
                trials.append((gain + promised, trial))
                kinds |= {kind(name) for name in added}
                explained = _explained(trial.ends.values()) == len(trial.ends)
                complete = explained and promised < SETTINGS.clear_gain
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
        losses = wald_losses([fit.measured for fit in fits])
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
        for name in sorted(net, key=lambda one: (not (least and _far(one)), -net[one])):
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
        return self._summed(present)

    def _summed(self, fitted: Fitted) -> dict[str, ScoreTest]:
        return summed_score_tests(
            [(self.channels[k], one) for k, one in fitted.ends.items()]
        )

    def _with_blades(self, present: Fitted, choice: Parts) -> Iterator[Parts]:
        """Propose a choice with another number of blades, by scores of fits with its other parts."""
        had = {name for name in choice - self.wanted if kind(name) == Blades.kind}
        rest = choice - had
        telling = most_telling(present.ends, rest ^ present.parts)
        tests = self._tests(Fitted(rest, self.refit(telling, rest)))
        gains = {name: tests[name].gain for name in tests if kind(name) == Blades.kind}
        best = max(gains, key=lambda name: gains[name], default=None)
        if best is not None and best not in had and gains[best] > cost(Parts({best})):
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
            self.missing = tuple(name for name in self.missing if name not in parts)
            return Fitted(parts, {**present.ends, **whole.ends})
        if added and gain > cost(added):
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
