"""Which parts of the camera a session shows that its plan does not state: forward selection by summed score tests.

Every optimum tells by its slopes what each absent part would gain (C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948)); the
sums over a session name the part to try. The fits that tell most are climbed again with it, and the penalised likelihood
decides. Parts that blur alike are tried in each other's place, the commoner one first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from scipy.linalg import block_diag

from labkit.estimation.candidate import Measured
from labkit.estimation.local import Optimum
from labkit.estimation.scores import ScoreTest
from labkit.estimation.settings import SETTINGS
from labkit.imaging.parts import KNOWN
from labkit.results.model import PartTried

BLURS = ("low_pass_filter", "diffusion", "smear", "low_pass_filter_turned")
"""Parts that blur alike to first order, the commonest first."""

Parts = frozenset[str]
Refit = Callable[[Sequence[int], Parts], Mapping[int, Optimum]]


def cost(parts: Parts) -> float:
    """Penalty of a choice of parts, in log-likelihood."""
    return sum(SETTINGS.part_cost + SETTINGS.clear_gain * (BLURS.index(name) if name in BLURS else 0) for name in parts)


def summed(fits: Sequence[tuple[str, Optimum]]) -> dict[str, ScoreTest]:
    """Score tests of a session, by name of the part. fits: channel and optimum; parts of the light are each channel's own."""
    names = [name for name in fits[0][1].scores if all(name in one.scores for _, one in fits)]
    whole = {name: reduce(ScoreTest.__add__, (one.scores[name] for _, one in fits)) for name in names}
    for name in [name for name in names if KNOWN[name].per_channel]:
        by_channel = dict[str, ScoreTest]()
        for channel, one in fits:
            test = one.scores[name]
            by_channel[channel] = by_channel[channel] + test if channel in by_channel else test
        tests = list(by_channel.values())
        whole[name] = ScoreTest(np.concatenate([c.slope for c in tests]), block_diag(*(c.information for c in tests)))
    return whole


def worth(fits: Sequence[Measured]) -> dict[str, float]:
    """By name of a fitted part, the log-likelihood that the fits would lose without it, to second order."""
    worths = dict[str, float]()
    for measured in fits:
        names = [label.split(".")[0] for label in measured.parts]
        for name in dict.fromkeys(name for name in names if name in KNOWN):
            at = len(measured.noll) + np.flatnonzero([one == name for one in names])
            values, covariance = measured.values[at], measured.covariance[np.ix_(at, at)]
            worths[name] = worths.get(name, 0.0) + 0.5 * float(values @ np.linalg.solve(covariance, values))
    return worths


def _lacking(fits: Sequence[Optimum]) -> float:
    """Log-likelihood that a part must gain where residuals of all fits are more than noise: else it stands for another lack."""
    if any(fit.verdict.accepted for fit in fits):
        return 0.0
    return SETTINGS.few * sum(fit.unexplained for fit in fits)


@dataclass
class CameraChoice:
    """The search for a session's camera parts.

    Attributes
    ----------
    refit : climbs fits again, from their ends, with a choice of parts
    wanted : parts that the plan wants fitted, which stay
    tried : what was asked about, with what it would gain
    refused : choices that did not raise the penalised likelihood
    missing : the part that the fits show, which was refused for explaining too little
    with_missing : fits with it
    """

    refit: Refit
    wanted: Parts
    tried: list[PartTried] = field(default_factory=list)
    refused: set[Parts] = field(default_factory=set)
    missing: tuple[str, ...] = ()
    with_missing: dict[int, Optimum] = field(default_factory=dict)

    def chosen(self, fits: Mapping[int, tuple[str, Optimum]], parts: Parts) -> Parts:
        """The parts that raise the penalised likelihood most, by steps.

        fits: channel and optimum of each fit, with `parts` in its model beside the plan's.
        """
        best, ends = parts, dict(fits)
        self.refused.clear()
        while True:
            for choice in self._proposals(ends, best):
                if choice in self.refused:
                    continue
                reached = self._reached(ends, best, choice)
                if reached is None:
                    self.refused.add(choice)
                    continue
                best, ends = choice, reached
                break
            else:
                return best

    def _proposals(self, ends: Mapping[int, tuple[str, Optimum]], parts: Parts) -> Iterator[Parts]:
        """Other choices, the most promising first."""
        tests = summed(list(ends.values()))
        gains = {name: test.gain - cost(Parts([name])) + SETTINGS.part_cost for name, test in tests.items()}
        self.tried = [one for one in self.tried if one.name not in gains]
        self.tried += [PartTried(name, test.gain, False) for name, test in tests.items()]
        worths = worth([optimum.measured for _, optimum in ends.values()])
        for name in sorted(parts, key=lambda one: worths.get(one, 0.0)):
            if worths.get(name, 0.0) < SETTINGS.part_cost:
                yield parts - {name}
        lacking = _lacking([optimum for _, optimum in ends.values()])
        for name in sorted(gains, key=lambda one: -gains[one]):
            if gains[name] > max(SETTINGS.part_cost, lacking) and name not in self.wanted:
                yield parts | {name}
        for name in [one for one in BLURS if one in parts]:
            commoner = [one for one in BLURS[: BLURS.index(name)] if one in tests]
            for one in commoner:
                yield (parts - {name}) | {one}
            if len(commoner) > 1 and sum(len(KNOWN[one].labels) for one in commoner) <= len(KNOWN[name].labels):
                yield (parts - {name}) | set(commoner)

    def _reached(
        self, ends: Mapping[int, tuple[str, Optimum]], parts: Parts, choice: Parts
    ) -> dict[int, tuple[str, Optimum]] | None:
        """Fits with another choice of parts, if that raises the penalised likelihood; else None."""
        telling = self._telling(ends, choice ^ parts)
        fits = dict(self.refit(telling, choice))
        if self._gain(ends, fits) <= cost(choice) - cost(parts):
            return None
        rest = [k for k in ends if k not in fits]
        fits |= self.refit(rest, choice)
        added = choice - parts
        if self._better(ends, fits, parts, choice):
            self.tried = [one for one in self.tried if one.name not in choice]
            self.tried += [PartTried(name, self._gain(ends, fits), True) for name in sorted(choice)]
            self.missing = tuple(name for name in self.missing if name not in choice)
            return {k: (ends[k][0], fits.get(k, ends[k][1])) for k in ends}
        if added and self._gain(ends, fits) > SETTINGS.part_cost:
            self.missing, self.with_missing = tuple(sorted(added)), fits
        return None

    def _telling(self, ends: Mapping[int, tuple[str, Optimum]], names: Parts) -> list[int]:
        """The fits that show most of some parts, by their score tests or their numbers."""

        def shown(k: int) -> float:
            optimum = ends[k][1]
            worths = worth([optimum.measured])
            return sum(optimum.scores[n].gain if n in optimum.scores else worths.get(n, 0.0) for n in names)

        return sorted(ends, key=lambda k: -shown(k))[: SETTINGS.tried]

    @staticmethod
    def _gain(ends: Mapping[int, tuple[str, Optimum]], fits: Mapping[int, Optimum]) -> float:
        return sum(fit.log_likelihood - ends[k][1].log_likelihood for k, fit in fits.items())

    def _better(
        self, ends: Mapping[int, tuple[str, Optimum]], fits: Mapping[int, Optimum], parts: Parts, choice: Parts
    ) -> bool:
        """Whether fits with other parts are likelier by the parts' cost, and by a share of what was unexplained."""
        gain = self._gain(ends, fits) - cost(choice) + cost(parts)
        if gain <= 0 or not choice - parts:
            return gain > 0
        explained = any(fit.verdict.accepted for fit in fits.values())
        return explained or gain > _lacking([ends[k][1] for k in fits])
