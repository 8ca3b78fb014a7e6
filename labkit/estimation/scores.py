"""Score tests for camera parts that a model lacks, at the optimum without them.

A part is parametrised so that the likelihood is regular where all its numbers are 0 (`labkit.imaging.parts`). The slope there
gives the log-likelihood that the part would gain, to second order, without a fit that includes the part: C. R. Rao, Proc.
Camb. Phil. Soc. 44, 50 (1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from labkit.estimation.expansion import Expansion
from labkit.estimation.identifiability import inverse
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN
from labkit.types import Floats


@dataclass(frozen=True)
class ScoreTest:
    """A Rao score test for one camera part with n numbers.

    Attributes
    ----------
    slope : (n,) derivative of the log-likelihood by the part's numbers, at 0
    information : (n, n) Fisher information, all other parameters refitted
    """

    slope: Floats
    information: Floats

    def __add__(self, other: ScoreTest) -> ScoreTest:
        """Add the tests of two fits that share the part."""
        return ScoreTest(self.slope + other.slope, self.information + other.information)

    @property
    def step(self) -> Floats:
        """(n,) likeliest numbers of the part, to second order."""
        return inverse(self.information) @ self.slope

    @property
    def gain(self) -> float:
        """Log-likelihood that the part would gain; 0 if its likeliest numbers are unphysical."""
        step = self.step
        return float(0.5 * step @ self.slope) if step.max() > 0 and step.sum() > 0 else 0.0


def score_tests(
    expansion: Expansion, names: Sequence[str], f_number_std: float
) -> dict[str, ScoreTest]:
    """Test for camera parts that a model lacks, by the likelihood about its optimum without them.

    Parameters
    ----------
    expansion : the likelihood about the optimum
    names : parts to test for
    f_number_std : relative standard error of the working f-number

    Returns
    -------
    one test for each name
    """
    if not names:
        return {}
    without = expansion.optics
    wider = expansion.with_parts(reduce(Optics.with_part, names, without))
    first, cone = wider.camera.start, wider.camera.stop - 1
    added = {name: first + places for name, places in _added(without, names).items()}
    kept = np.setdiff1d(np.arange(len(wider.gradient)), np.concatenate([*added.values()]))
    information, gradient = wider.information.copy(), wider.gradient
    information[cone, cone] += max(f_number_std, 1e-6) ** -2
    others = kept[
        (kept >= first) & (kept < cone)
    ]  # present parts keep the prior that they have in a climb
    information[others, others] += without.camera_stds[:-1] ** -2
    rest = inverse(information[np.ix_(kept, kept)])
    result = {}
    for name, at in added.items():
        pulled = information[np.ix_(at, kept)] @ rest
        slope = gradient[at] - pulled @ gradient[kept]
        result[name] = ScoreTest(
            slope, information[np.ix_(at, at)] - pulled @ information[np.ix_(kept, at)]
        )
    return result


def _added(without: Optics, names: Sequence[str]) -> dict[str, NDArray[np.intp]]:
    """Return the places of each added part's numbers among the camera parameters: behind the parts that are present."""
    at, places = (
        sum(len(part.labels) for part in without.parts),
        dict[str, NDArray[np.intp]](),
    )
    for name in names:
        many = len(KNOWN[name].labels)
        places[name] = np.arange(at, at + many)
        at += many
    return places
