"""Modes that a session leaves out: what they probably are, and how far they move its lens.

A session adopts higher modes only where they gain more than absent modes do by chance. Weaker ones remain in the photographs,
and the modes that are fitted take up a share of them. The score tests that decided about them tell both: the likeliest
numbers, under a normal prior whose variance has the largest marginal likelihood (C. N. Morris, J. Am. Stat. Assoc. 78, 47
(1983)), and what each of them moves in a fit. Beyond modes that were adopted the next ones are about as strong, whatever the
tests tell: behind a deep cat's eye they hardly tell higher modes from lower ones. Otherwise modes that chance explains have no
variance, and move nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
from scipy.optimize import minimize_scalar

from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Measured
from labkit.estimation.estimate import Estimate
from labkit.estimation.lens_fit import fit_lens
from labkit.estimation.scores import ScoreTest
from labkit.mode_groups import MODE_GROUPS
from labkit.types import Floats

LOG_VARIANCES = -14.0, 14.0
"""Limits of ln of the prior's variance, in units of one number's mean error squared."""


def by_modes_left_out(session: Estimate) -> tuple[Point, ...]:
    """Return changes of a session's lens by the modes that it leaves out, each by one standard deviation of them.

    There are none where chance explains the tests. The lens is that of the members that were tested: their tests alone tell
    what the modes move.
    """
    lens, tests = session.lens, _tests(session)
    if lens is None or not tests:
        return ()
    measured = {k: session.fits[k].optimum.measured for k in tests}
    every = reduce(ScoreTest.__add__, tests.values())
    deviations = standard_deviations(every, _strength([*measured.values()]))
    if not len(deviations):
        return ()
    rows = [session.row(k) for k in tests]
    used = np.isin(np.arange(len(lens.measured.used)), rows)
    tested = replace(lens.measured, used=used)
    solved = fit_lens(lens.model, tested, lens.solved.point).solved
    moved = np.zeros((len(deviations), *lens.measured.values.shape))
    for k, test in tests.items():
        assert test.moves is not None
        by_number = [
            replace(measured[k], values=change).labelled(lens.model.parts).values
            for change in test.moves
        ]
        moved[:, session.row(k)] = deviations @ np.array(by_number)
    return tuple(
        Point(*solved.normal.solve(*solved.pulls(solved.data.pulled(one)))) for one in moved
    )


def _tests(session: Estimate) -> dict[int, ScoreTest]:
    """Return the test of all modes that members lack, by member, of those that were tested for them."""
    every = {k: session.fits[k].optimum.scores for k in session.members}
    names = [name for name in MODE_GROUPS if any(name in of for of in every.values())]
    return {k: of[names[-1]] for k, of in every.items() if names and names[-1] in of}


def _strength(fits: Sequence[Measured]) -> float:
    """Return the variance of a number of the highest modes that were adopted, waves squared; 0 where none were."""
    groups = [group for group in MODE_GROUPS.values() if group.last in fits[0].noll]
    if not groups:
        return 0.0
    at = np.flatnonzero(np.isin(fits[0].noll, groups[-1].noll))
    squares = [one.values[at] ** 2 - np.diag(one.covariance)[at] for one in fits]
    return max(float(np.mean(squares)), 0.0)


def standard_deviations(test: ScoreTest, least: float = 0.0) -> Floats:
    """Return m independent standard deviations (m, n) of a test's numbers from 0; the first is their mean.

    The numbers have a normal prior, whose variance has the largest marginal likelihood above a least one. If that is 0, m is 0.
    """
    information, vectors = np.linalg.eigh(test.information)
    slopes = vectors.T @ test.slope
    unit = float(np.mean(information))

    def deficit(log_variance: float) -> float:
        variance = np.exp(log_variance) / unit
        grown = 1 + variance * information
        return float(np.sum(np.log(grown) - variance * slopes**2 / grown))

    best = minimize_scalar(deficit, bounds=LOG_VARIANCES, method="bounded").x
    variance = max(least, np.exp(best) / unit if deficit(best) < 0 else 0.0)
    if not variance:
        return np.empty((0, len(slopes)))
    posterior = variance / (1 + variance * information)
    means = posterior * slopes
    return np.vstack([vectors @ means, (vectors * np.sqrt(posterior)).T])
