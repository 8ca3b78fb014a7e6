"""Select camera parts and modes that a session shows and its plan does not state: forward selection by summed score tests.

A score test at every optimum gives the log-likelihood that each absent part would gain (C. R. Rao, Proc. Camb. Phil. Soc.
44, 50 (1948)). The sums over a session name the part to try. The most significant fits are refitted with it, and the
penalised likelihood decides. Parts with similar blur are tried in place of each other, the more common part first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from itertools import chain

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from labkit.estimation.candidate import Measured
from labkit.estimation.local import Optimum
from labkit.estimation.scores import ScoreTest
from labkit.estimation.settings import SETTINGS
from labkit.imaging.parts import KNOWN
from labkit.mode_groups import MODE_GROUPS
from labkit.results.model import PartTried

ALIKE_BLURS = ("low_pass_filter", "diffusion", "smear", "low_pass_filter_turned")
"""Parts with the same blur to first order, the most common first."""

TESTED_IN_PLACE = {"uneven_rim": "cats_eye"}
"""Parts that are looked for in place of others, whose likelihood is not regular where they are absent."""

Parts = frozenset[str]
Refit = Callable[[Sequence[int], Parts], Mapping[int, Optimum]]


def cost(parts: Parts) -> float:
    """Return the penalty of a choice of parts and modes, in log-likelihood.

    By chance n numbers gain more than their penalty once in `1 / SETTINGS.part_chance` sessions: twice the gain is
    distributed as chi-squared with n degrees of freedom. A rarer blur must gain clearly more than the commonest one.
    """
    rarer = parts & set(ALIKE_BLURS[1:])
    numbers = [len(KNOWN[name].labels) for name in parts - rarer if name in KNOWN]
    numbers += [len(KNOWN[ALIKE_BLURS[0]].labels)] * len(rarer)
    numbers += [len(MODE_GROUPS[name].noll) for name in parts if name in MODE_GROUPS]
    return sum(map(chance_gain, numbers)) + SETTINGS.clear_gain * len(rarer)


def chance_gain(numbers: int) -> float:
    """Return the log-likelihood that some absent numbers gain by chance once in `1 / SETTINGS.part_chance` sessions."""
    return 0.5 * float(chdtri(numbers, SETTINGS.part_chance))


def summed_score_tests(fits: Sequence[tuple[str, Optimum]]) -> dict[str, ScoreTest]:
    """Sum the score tests of a session, by name of the part or group of modes.

    Parameters
    ----------
    fits : channel and optimum of each fit. Parts of the light are tested for each channel and joined into one test. Modes and
        parts of the rim are summed over the fits that were tested for them, other parts only if all fits were.
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


def wald_losses(fits: Sequence[Measured]) -> dict[str, float]:
    """Return the log-likelihood that fits would lose without each part, and without the highest modes (Wald test)."""
    losses = dict[str, float]()
    for measured in fits:
        labels = [label.split(".")[0] for label in measured.parts]
        groups = [n for n in MODE_GROUPS if MODE_GROUPS[n].last in measured.noll]
        numbers = {
            name: len(measured.noll) + np.flatnonzero([one == name for one in labels])
            for name in dict.fromkeys(labels)
            if name in KNOWN
        }
        for name in groups[-1:]:
            numbers[name] = np.flatnonzero(np.isin(measured.noll, MODE_GROUPS[name].noll))
        for name, at in numbers.items():
            values, covariance = measured.values[at], measured.covariance[np.ix_(at, at)]
            losses[name] = losses.get(name, 0.0) + 0.5 * float(
                values @ np.linalg.solve(covariance, values)
            )
    return losses


def extended(parts: Parts, name: str) -> Parts:
    """Return a choice with a further part, or with all groups of modes up to one."""
    if name not in MODE_GROUPS:
        return parts | {name}
    groups = list(MODE_GROUPS)
    return parts | set(groups[: groups.index(name) + 1])


def kind(name: str) -> str:
    """Return what a part or a group of modes is an example of: parts of one kind explain the same."""
    if name in MODE_GROUPS:
        return "modes"
    return "blur" if name in ALIKE_BLURS else KNOWN[name].kind or name


def _explained(fits: Iterable[Optimum]) -> int:
    """Return the number of fits whose residuals are noise alone."""
    return sum(fit.verdict.accepted for fit in fits)


def _least_gain(fits: Sequence[Optimum]) -> float:
    """Return the least gain of a part: a share of what is unexplained, unless most fits are explained.

    A part with a smaller gain stands for something else that the model lacks.
    """
    unexplained = [fit.unexplained for fit in fits if not fit.verdict.accepted]
    if 2 * len(unexplained) < len(fits):
        return 0.0
    return SETTINGS.few * sum(unexplained)


def _far(name: str) -> bool:
    """Whether a fit tells what a part gains, not its score."""
    return name in KNOWN and KNOWN[name].far


@dataclass
class CameraChoice:
    """The search for a session's camera parts.

    Attributes
    ----------
    refit : refits observations, each from its optimum, with a choice of parts
    wanted : parts that the plan requests to fit, which always stay
    tried : parts that were tested for, with their gains
    missing : the significant part that was refused because it explains too little of the residuals
    with_missing : fits with the missing part
    """

    refit: Refit
    wanted: Parts
    tried: list[PartTried] = field(default_factory=list)
    missing: tuple[str, ...] = ()
    with_missing: dict[int, Optimum] = field(default_factory=dict)

    def chosen(self, fits: Mapping[int, tuple[str, Optimum]], parts: Parts) -> Parts:
        """Find the parts that raise the penalised likelihood most, step by step.

        Parameters
        ----------
        fits : channel and optimum of each fit
        parts : parts in the fits' model in addition to the plan's
        """
        best, ends, refused = parts, dict(fits), set[Parts]()
        while True:
            for choice, telling in self._trials(ends, best, refused):
                reached = self._reached(ends, best, choice, telling)
                if reached is not None:
                    best, ends = choice, reached
                    break
                refused.add(choice)
            else:
                return best

    def _trials(
        self, ends: Mapping[int, tuple[str, Optimum]], parts: Parts, refused: set[Parts]
    ) -> Iterator[tuple[Parts, dict[int, Optimum]]]:
        """Yield choices that raise the penalised likelihood of the most telling fits, with these fits; add others to `refused`.

        A score is an approximation, which is poor for numbers far from 0. So a choice that does not explain the fits is
        compared with the next ones of other kinds, and the best choice comes first.
        """
        while True:
            trials = list[tuple[float, Parts, dict[int, Optimum]]]()
            kinds = set[str]()
            for choice in self._proposals(ends, parts):
                added = choice - parts
                if choice in refused or {kind(name) for name in added} & kinds:
                    continue
                fits = dict(self.refit(self._telling(ends, choice ^ parts), choice))
                gain = self._gain(ends, fits) - cost(choice) + cost(parts)
                if gain <= 0:
                    refused.add(choice)
                    continue
                trials.append((gain, choice, fits))
                kinds |= {kind(name) for name in added}
                explained = _explained(fits.values()) == len(fits)
                if explained or not added or len(trials) == SETTINGS.tried:
                    break
            if not trials:
                return
            for _, choice, fits in sorted(trials, key=lambda trial: -trial[0]):
                yield choice, fits

    def _proposals(
        self, ends: Mapping[int, tuple[str, Optimum]], parts: Parts
    ) -> Iterator[Parts]:
        """Propose other choices of parts, the most promising first."""
        fits = list(ends.values())
        tests = summed_score_tests(fits)
        self.tried = [one for one in self.tried if one.name not in tests]
        self.tried += [PartTried(name, test.gain, False) for name, test in tests.items()]
        losses = wald_losses([optimum.measured for _, optimum in fits])
        for name in sorted(parts & losses.keys(), key=lambda one: losses[one]):
            if losses[name] < cost(parts) - cost(parts - {name}):
                yield parts - {name}
        for name in TESTED_IN_PLACE.keys() & parts:
            yield (parts - {name}) | {TESTED_IN_PLACE[name]}
        least = _least_gain([optimum for _, optimum in fits])
        net = {
            name: test.gain - cost(extended(parts, name)) + cost(parts)
            for name, test in tests.items()
            if (test.gain > least or _far(name)) and name not in self.wanted
        }
        for name in sorted(net, key=lambda one: (not (least and _far(one)), -net[one])):
            if net[name] > 0:
                yield extended(parts, name)
        for name in [one for one in ALIKE_BLURS if one in parts]:
            more_common = [
                one for one in ALIKE_BLURS[: ALIKE_BLURS.index(name)] if one in tests
            ]
            for one in more_common:
                yield (parts - {name}) | {one}
            if len(more_common) > 1 and sum(
                len(KNOWN[one].labels) for one in more_common
            ) <= len(KNOWN[name].labels):
                yield (parts - {name}) | set(more_common)

    def _reached(
        self,
        ends: Mapping[int, tuple[str, Optimum]],
        parts: Parts,
        choice: Parts,
        telling: Mapping[int, Optimum],
    ) -> dict[int, tuple[str, Optimum]] | None:
        """Return the fits with another choice of parts, or None if the penalised likelihood does not rise.

        Parameters
        ----------
        ends, parts : the present fits, and the parts in their model
        choice : the other parts
        telling : fits with the other parts that are made already
        """
        rest = [k for k in ends if k not in telling]
        fits = {**telling, **self.refit(rest, choice)}
        added = choice - parts
        if self._better(ends, fits, parts, choice):
            self.tried = [one for one in self.tried if one.name not in choice]
            self.tried += [
                PartTried(name, self._gain(ends, fits), True) for name in sorted(choice)
            ]
            self.missing = tuple(name for name in self.missing if name not in choice)
            return {k: (ends[k][0], fits.get(k, ends[k][1])) for k in ends}
        if added and self._gain(ends, fits) > cost(added):
            self.missing, self.with_missing = tuple(sorted(added)), fits
        return None

    def _telling(self, ends: Mapping[int, tuple[str, Optimum]], names: Parts) -> list[int]:
        """Return the fits with the most significant score tests, or estimates, of some parts."""

        leading = [name for name in names if name not in MODE_GROUPS]
        leading += [name for name in MODE_GROUPS if name in names][-1:]

        def shown(k: int) -> float:
            optimum = ends[k][1]
            losses = wald_losses([optimum.measured])
            return sum(
                optimum.scores[n].gain if n in optimum.scores else losses.get(n, 0.0)
                for n in leading
            )

        return sorted(ends, key=lambda k: -shown(k))[: SETTINGS.tried]

    @staticmethod
    def _gain(
        ends: Mapping[int, tuple[str, Optimum]], fits: Mapping[int, Optimum]
    ) -> float:
        return sum(
            fit.log_likelihood - ends[k][1].log_likelihood for k, fit in fits.items()
        )

    def _better(
        self,
        ends: Mapping[int, tuple[str, Optimum]],
        fits: Mapping[int, Optimum],
        parts: Parts,
        choice: Parts,
    ) -> bool:
        """Whether fits with other parts gain more than the parts' cost, and explain a further fit or their share."""
        gain = self._gain(ends, fits) - cost(choice) + cost(parts)
        if gain <= 0 or not choice - parts:
            return gain > 0
        before = [ends[k][1] for k in fits]
        explains_more = _explained(fits.values()) > _explained(before)
        return explains_more or gain > _least_gain(before)
