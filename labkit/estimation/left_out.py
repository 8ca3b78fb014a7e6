"""Modes that a session has not adopted: what they probably are, and how far they move its lens.

A session adopts higher modes only where they gain more than absent modes do by chance. Weaker ones remain in the photographs,
and the modes fitted take up a share of them. Beyond modes adopted the next ones are not much weaker, so they
become weak modes of the lens. Elsewhere they are left out, and the score tests that decided about them tell their effect: the
likeliest numbers, under a normal prior whose variance has the largest marginal likelihood (C. N. Morris, J. Am. Stat. Assoc.
78, 47 (1983)), and what each of them moves in a fit. Modes that chance explains have no variance, and move nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
from scipy.optimize import minimize_scalar

from labkit.estimation.block_solve import Point
from labkit.estimation.candidate import Measured
from labkit.estimation.estimate import Estimate
from labkit.estimation.lens_fit import fit_lens
from labkit.estimation.scores import ScoreTest
from labkit.plan.mode_groups import MODE_GROUPS, USUAL_NOLL
from labkit.types import Floats

LOG_VARIANCES = -14.0, 14.0
"""Limits of ln of the prior's variance, in units of one number's mean error squared."""


def by_modes_left_out(session: Estimate) -> tuple[Point, ...]:
    """Return changes of a session's lens by the modes that it leaves out, each by one standard deviation of them.

    There are none where chance explains the tests. The lens is that of the members tested: their tests alone tell
    what the modes move.
    """
    lens, tests = session.lens, _tests(session)
    if lens is None or lens.model.weak or not tests:
        return ()
    measured = {k: session.fits[k].optimum.measured for k in tests}
    deviations = standard_deviations(_summed(tests), _strength([*measured.values()]))
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


def weak_modes(session: Estimate) -> dict[int, float]:
    """Return the modes beyond those that a session adopted, with the standard deviation of each, waves RMS.

    It is that of the highest adopted modes, or the likeliest by the tests if that is larger. There are none where no modes were
    adopted, where camera parts are missing, and in fields, whose tiles have different modes.
    """
    lens, tests = session.lens, _tests(session)
    if lens is None or lens.model.tiled or any(session.with_missing) or not tests:
        return {}
    fits = [session.fits[k].optimum.measured for k in tests]
    last = max(fits[0].noll)
    std = variance(_summed(tests), _strength(fits)) ** 0.5
    if last <= USUAL_NOLL[1] or not std:
        return {}
    return dict.fromkeys(range(last + 1, MODE_GROUPS[_tested(session)[-1]].last + 1), std)


def _tested(session: Estimate) -> list[str]:
    """Return the groups of modes for which members were tested, the lowest first."""
    every = [session.fits[k].optimum.scores for k in session.members]
    return [name for name in MODE_GROUPS if any(name in of for of in every)]


def _tests(session: Estimate) -> dict[int, ScoreTest]:
    """Return the test of all modes that members lack, by member, of those that were tested for them."""
    every = {k: session.fits[k].optimum.scores for k in session.members}
    return {
        k: of[name]
        for name in _tested(session)[-1:]
        for k, of in every.items()
        if name in of
    }


def _summed(tests: Mapping[int, ScoreTest]) -> ScoreTest:
    return reduce(ScoreTest.__add__, tests.values())


def _strength(fits: Sequence[Measured]) -> float:
    """Return the variance of a number of the highest modes adopted, waves squared; 0 where none were."""
    groups = [group for group in MODE_GROUPS.values() if group.last in fits[0].noll]
    if not groups:
        return 0.0
    at = np.flatnonzero(np.isin(fits[0].noll, groups[-1].noll))
    squares = [one.values[at] ** 2 - np.diag(one.covariance)[at] for one in fits]
    return max(float(np.mean(squares)), 0.0)


def standard_deviations(test: ScoreTest, least: float = 0.0) -> Floats:
    """Return m independent standard deviations (m, n) of a test's numbers from 0; the first is their mean.

    The numbers have a normal prior, see `variance`. If its variance is 0, m is 0.
    """
    prior = variance(test, least)
    if not prior:
        return np.empty((0, len(test.slope)))
    information, vectors = np.linalg.eigh(test.information)
    posterior = prior / (1 + prior * information)
    means = posterior * (vectors.T @ test.slope)
    return np.vstack([vectors @ means, (vectors * np.sqrt(posterior)).T])


def variance(test: ScoreTest, least: float = 0.0) -> float:
    """Return the variance of a test's numbers about 0 with the largest marginal likelihood, but no less than a least one."""
    information, vectors = np.linalg.eigh(test.information)
    slopes = vectors.T @ test.slope
    unit = float(np.mean(information))

    def deficit(log_variance: float) -> float:
        prior = np.exp(log_variance) / unit
        grown = 1 + prior * information
        return float(np.sum(np.log(grown) - prior * slopes**2 / grown))

    best = minimize_scalar(deficit, bounds=LOG_VARIANCES, method="bounded").x
    return max(least, float(np.exp(best)) / unit if deficit(best) < 0 else 0.0)
