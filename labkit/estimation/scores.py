"""Score tests for numbers absent from a model, at the optimum without them: parts of the camera, and groups of modes.

A part is parametrised so that the likelihood is regular where all its numbers are 0 (`labkit.imaging.parts`). The slope there
gives the part's gain in log-likelihood, to second order, without a fit of the part: C. R. Rao, Proc.
Camb. Phil. Soc. 44, 50 (1948).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labkit.estimation.expansion import Expansion
from labkit.estimation.identifiability import inverse
from labkit.estimation.settings import SETTINGS
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.optics.zernike import twin_signs
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.types import Floats


@dataclass(frozen=True)
class ScoreTest:
    """A Rao score test for a group of n numbers.

    Attributes
    ----------
    slope : (n,) derivative of the log-likelihood by the numbers, at 0
    information : (n, n) Fisher information, all other parameters refitted
    one_sided : whether numbers below 0 are unphysical
    moves : (n, values) change of the fit's measured values by each number, all other parameters refitted; None for a sum
    """

    slope: Floats
    information: Floats
    one_sided: bool = True
    moves: Floats | None = None

    def __add__(self, other: ScoreTest) -> ScoreTest:
        """Add the tests of two fits that share the numbers."""
        return replace(
            self,
            slope=self.slope + other.slope,
            information=self.information + other.information,
            moves=None,
        )

    @property
    def step(self) -> Floats:
        """(n,) likeliest numbers, to second order."""
        return inverse(self.information) @ self.slope

    @property
    def gain(self) -> float:
        """Gain of the numbers in log-likelihood; 0 if the likeliest numbers are unphysical."""
        step = self.step
        if self.one_sided and not (step.max() > 0 and step.sum() > 0):
            return 0.0
        return float(0.5 * step @ self.slope)


def twin_scores(scores: Mapping[str, ScoreTest], of_values: Floats) -> dict[str, ScoreTest]:
    """Return the tests at the twin of an optimum, where even modes have the other sign.

    of_values: (values,) signs of the measured values, see `Measured.signs`
    """
    return {
        name: replace(
            test,
            slope=test.slope * signs,
            information=test.information * np.outer(signs, signs),
            moves=None if test.moves is None else test.moves * np.outer(signs, of_values),
        )
        for name, test in scores.items()
        for signs in [_signs(name, test)]
    }


def _signs(name: str, test: ScoreTest) -> Floats:
    if name not in MODE_GROUPS:
        return np.array(KNOWN[name].twin_signs)
    modes = [
        j
        for group in MODE_GROUPS.values()
        for j in group.noll
        if j <= MODE_GROUPS[name].last
    ]
    return twin_signs(modes[-test.slope.size :])


def score_tests(
    expansion: Expansion, names: Sequence[str], f_number_std: float
) -> dict[str, ScoreTest]:
    """Test for parts and groups of modes that a model lacks, by the likelihood about its optimum without them.

    Parameters
    ----------
    expansion : the likelihood about the optimum
    names : parts and groups to test for
    f_number_std : relative standard error of the working f-number

    Returns
    -------
    a test for each name. The test of a group of modes includes all lower groups in `names`.
    """
    if not names:
        return {}
    without, wider = expansion.optics, expansion.with_parts(names)
    first, cone = wider.camera.start, wider.camera.stop - 1
    added = _added(without, names)
    new = np.unique(np.concatenate([*added.values()]))
    kept = np.setdiff1d(np.arange(len(wider.gradient)), new)
    information, gradient = wider.information.copy(), wider.gradient
    information[cone, cone] += max(f_number_std, SETTINGS.exact) ** -2
    others = kept[
        (kept >= first) & (kept < cone)
    ]  # present parts keep the prior that they have in a climb
    information[others, others] += without.camera_stds[:-1] ** -2
    rest = inverse(information[np.ix_(kept, kept)])
    values = np.append(np.setdiff1d(np.arange(cone + 1), new), -1)
    by_kept = wider.projection[np.ix_(values, kept)]
    result = {}
    parts = {part.name: part for part in wider.optics.parts}
    for name, at in added.items():
        pulled = information[np.ix_(at, kept)] @ rest
        slope = gradient[at] - pulled @ gradient[kept]
        result[name] = ScoreTest(
            slope,
            information[np.ix_(at, at)] - pulled @ information[np.ix_(kept, at)],
            one_sided=name in parts and parts[name].one_sided,
            moves=-pulled @ by_kept.T,
        )
    return result


def _added(without: Optics, names: Sequence[str]) -> dict[str, NDArray[np.intp]]:
    """Return the places of each added group's numbers among all parameters: modes behind modes, parts behind parts."""
    places = dict[str, NDArray[np.intp]]()
    begin = at = len(without.noll)
    for name in [name for name in MODE_GROUPS if name in names]:
        at += len(MODE_GROUPS[name].noll)
        places[name] = np.arange(begin, at)
    at += sum(len(part.labels) for part in without.parts)
    for name in [name for name in KNOWN if name in names]:
        many = len(KNOWN[name].labels)
        places[name] = np.arange(at, at + many)
        at += many
    return places
