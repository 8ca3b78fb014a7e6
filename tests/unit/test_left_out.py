"""Modes that a session leaves out widen the errors of its lens by what they probably are. Searches are played."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.estimation.doubts import with_model_error
from labkit.estimation.estimate import Estimate
from labkit.estimation.left_out import (
    by_modes_left_out,
    standard_deviations,
    variance,
    weak_modes,
)
from labkit.estimation.local import Found, Optimum
from labkit.estimation.scores import ScoreTest
from tests.lens_samples import best_focus, measured
from tests.optimum_samples import FOCUS_MM, Play, optimum, played, range_of, true_values

GROUP = "modes_16_21"
STD = 1e-3
"""Waves of each of six modes, by one fit."""
MOVES = np.outer(np.ones(6), [0.3, 0.0, 0.0, 0.0])
"""Each mode moves defocus alone, by 0.3 of itself."""


def told(gain: float) -> ScoreTest:
    """Return a test by which six modes, all alike, gain so much in one fit."""
    waves = np.full(6, STD * np.sqrt(2 * gain / 6))
    information = np.eye(6) / STD**2
    return ScoreTest(information @ waves, information, one_sided=False, moves=MOVES)


def session(gain: float) -> Estimate:
    """Four ranges; each fit was tested for modes that would gain so much in it."""
    scores = {GROUP: told(gain)}
    return played(
        Play(lambda task: Found((optimum(task.optics, range_of(task), scores=scores),)))
    )


def moved(of: ScoreTest) -> np.ndarray:
    """Return the RMS of what each number may be."""
    return np.asarray(np.sqrt(np.sum(standard_deviations(of) ** 2, axis=0)))


@pytest.mark.parametrize("gain", [5.0, 12.0, 100.0])
def test_numbers_alike_shrink_as_stein_has_it(gain: float) -> None:
    """James and Stein's share for n numbers of one error is 1 - n / sum of their squares (Morris 1983, empirical Bayes)."""
    share = 1 - 6 / (2 * gain)
    squares = (share * STD * np.sqrt(2 * gain / 6)) ** 2 + share * STD**2
    np.testing.assert_allclose(moved(told(gain)), np.sqrt(squares), rtol=1e-3)


def test_numbers_that_chance_explains_are_none() -> None:
    assert standard_deviations(told(2.9)).shape == (0, 6)
    assert by_modes_left_out(session(0.5)) == ()


def test_the_likeliest_numbers_come_first() -> None:
    test = ScoreTest(np.array([4000.0, 100.0]), np.diag([1e6, 1e3]), one_sided=False)
    mean = standard_deviations(test)[0]
    assert 0 < mean[0] < 4000 / 1e6
    assert 0 < mean[1] < 100 / 1e3


def test_best_focus_allows_for_what_the_modes_move() -> None:
    plain = session(2.0)
    widened = with_model_error(plain).lens
    assert plain.lens is not None
    assert widened is not None
    four = ScoreTest(4 * told(2.0).slope, 4 * told(2.0).information, one_sided=False)
    by = [float(plain.lens.model.best_focus("G") @ one.theta) for one in widened.unknown]
    # defocus of all fits moves alike: best focus by that over the slope of defocus
    (near, *_), (far, *_) = true_values(FOCUS_MM - 1), true_values(FOCUS_MM + 1)
    mm = 0.3 * np.linalg.norm(standard_deviations(four).sum(axis=1)) / ((far - near) / 2)
    assert np.hypot.reduce(by) == pytest.approx(mm, rel=0.05)
    before, after = best_focus(plain.lens, "G"), best_focus(widened, "G")
    assert after.value == before.value
    assert after.std == pytest.approx(np.hypot(before.std, mm), rel=0.05)


def test_beyond_adopted_modes_the_next_ones_are_as_strong() -> None:
    """Modes of which the tests tell nothing keep the variance of the adopted ones; told ones have their own errors."""
    variance = (0.5 * STD) ** 2
    unseen = ScoreTest(np.zeros(2), np.diag([1e-3, 1e3]) / STD**2, one_sided=False)
    squares = [variance, variance / (1 + 1e3 * variance / STD**2)]
    root = np.sqrt(np.sum(standard_deviations(unseen, variance) ** 2, axis=0))
    np.testing.assert_allclose(root, np.sqrt(squares), rtol=1e-3)


def test_a_lens_whose_modes_are_all_told_is_as_sure_as_before() -> None:
    plain = session(0.5)
    assert with_model_error(plain) is plain


def adopted(gain: float, waves: float) -> Estimate:
    """Return a session that adopted modes 16 to 21, each of some waves, and was tested for the seven next ones."""
    plain, modes = session(0.5), dict.fromkeys(range(16, 22), waves)
    information = np.eye(7) / STD**2
    slope = information @ np.full(7, STD * np.sqrt(2 * gain / 7))
    scores = {"modes_22_28": ScoreTest(slope, information, one_sided=False)}

    def with_modes(one: Optimum) -> Optimum:
        of = measured(one.measured.values[[0, -2, -1]], {5: one.waves[1], **modes})
        optics = replace(one.optics, noll=of.noll)
        return replace(one, optics=optics, measured=of, scores=scores)

    fits = [replace(fit, optimum=with_modes(fit.optimum)) for fit in plain.fits]
    return replace(plain, fits=tuple(fits))


def test_modes_beyond_adopted_ones_are_weak() -> None:
    as_strong, stronger = weak_modes(adopted(0.5, 0.02)), weak_modes(adopted(100.0, 1e-4))
    assert [*as_strong] == [*stronger] == [*range(22, 29)]
    assert as_strong[22] == pytest.approx(0.02, rel=0.01)
    (test, *_) = (fit.optimum.scores["modes_22_28"] for fit in adopted(100.0, 0.0).fits)
    four = ScoreTest(4 * test.slope, 4 * test.information, one_sided=False)
    assert stronger[22] == pytest.approx(variance(four) ** 0.5)


def test_no_modes_are_weak_where_none_were_adopted_or_parts_are_missing() -> None:
    assert weak_modes(session(5.0)) == {}
    whole = adopted(5.0, 0.02)
    complete = tuple(fit.optimum for fit in whole.fits)
    assert weak_modes(replace(whole, with_missing=complete)) == {}


def test_weak_modes_of_the_lens_are_not_left_out() -> None:
    plain = session(5.0)
    assert plain.lens is not None
    assert by_modes_left_out(plain)
    model = replace(plain.lens.model, weak={16: STD})
    assert by_modes_left_out(replace(plain, lens=replace(plain.lens, model=model))) == ()
